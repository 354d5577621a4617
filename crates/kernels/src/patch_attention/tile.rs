//! The register tile: `MR` rows times `NV` registers, summed over k in order.
//!
//! Unlike in [`crate::gemm`] the sums stay in registers for the caller to end with, they start from
//! a value per column, and the spread operand may lie either way round.

use crate::gemm::micro::Products;
use crate::simd::Vector;

/// Where the single elements are: element `(i, p)` is `base[i·row + p·step]`.
pub(super) struct Spread<E> {
    pub base: *const E,
    pub row: usize,
    pub step: usize,
}

/// Where the registers are: those of step `p` start at `base + p·stride`.
pub(super) struct Lanes<E> {
    pub base: *const E,
    pub stride: usize,
}

/// `start[v] + Σ_p a(i, p) · b(p)[v]` for every row `i` and register `v` of a tile.
///
/// # Safety
/// `a` must hold `MR × k` elements, `b` `k` times `NV` registers; the products' instruction set.
#[inline(always)]
pub(super) unsafe fn tile<P: Products, const MR: usize, const NV: usize>(
    start: [P::Sum; NV],
    a: &Spread<P::Element>,
    b: &Lanes<P::Element>,
    k: usize,
) -> [[P::Sum; NV]; MR] {
    let mut sums = [start; MR];
    let (mut ap, mut bp) = (a.base, b.base);
    for _ in 0..k {
        // SAFETY: the function's contract.
        unsafe {
            let bv: [P::Factor; NV] = std::array::from_fn(|v| P::load(bp.add(v * P::Sum::LANES)));
            for i in 0..MR {
                let av = P::splat(*ap.add(i * a.row));
                for v in 0..NV {
                    sums[i][v] = P::multiply_add(av, bv[v], sums[i][v]);
                }
            }
        }
        // The step behind the last row may leave the allocation; nothing is read there.
        ap = ap.wrapping_add(a.step);
        bp = bp.wrapping_add(b.stride);
    }
    sums
}

/// Runs `$body` with `$M` bound to the constant that equals `$rows`, which is in `1..=6`.
macro_rules! with_rows {
    ($rows:expr, $M:ident => $body:expr) => {
        match $rows {
            1 => {
                const $M: usize = 1;
                $body
            }
            2 => {
                const $M: usize = 2;
                $body
            }
            3 => {
                const $M: usize = 3;
                $body
            }
            4 => {
                const $M: usize = 4;
                $body
            }
            5 => {
                const $M: usize = 5;
                $body
            }
            _ => {
                const $M: usize = 6;
                $body
            }
        }
    };
}
pub(super) use with_rows;

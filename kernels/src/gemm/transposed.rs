//! `aᵀ · b`: the product behind weight gradients, summed over many rows.

use super::{K_BLOCK, PackedMatrix, RowPointers, RowPointersMut, multiply_rows, repack_with};
use crate::Precision;
use rayon::prelude::*;

/// Rows that one partial sum covers. Fixed, so that the order of summation is.
const SEGMENT: usize = 8192;
/// Columns of `a` that one task turns into rows of the result.
const OUT_BLOCK: usize = 192;

/// `out = Σ_r a[r]ᵀ · b[r]` over rows, optionally over pairs of gathered rows.
///
/// # Shapes
/// `a`: `[R, m]` · `b`: `[R', n]` · `out`: `[m, n]`; with `pairs = (a_rows, b_rows)` the sum runs
/// over the given pairs of row numbers, else over all rows (`R = R'`).
///
/// The sum is built from partial sums over fixed stretches of rows, added in order, so it does not
/// depend on the number of threads.
///
/// # Panics
/// If lengths do not fit the shapes (a bug of the caller).
pub fn gemm_tn(
    a: &[f32],
    m: usize,
    b: &[f32],
    n: usize,
    pairs: Option<(&[u32], &[u32])>,
    out: &mut [f32],
) {
    gemm_tn_with(Precision::F32, a, m, b, n, pairs, out);
}

/// [`gemm_tn`] in another precision.
///
/// # Panics
/// As [`gemm_tn`].
pub fn gemm_tn_with(
    precision: Precision,
    a: &[f32],
    m: usize,
    b: &[f32],
    n: usize,
    pairs: Option<(&[u32], &[u32])>,
    out: &mut [f32],
) {
    assert_eq!(out.len(), m * n, "gemm_tn: result length");
    out.fill(0.0);
    if m == 0 || n == 0 {
        return;
    }
    let rows = match pairs {
        Some((ra, rb)) => {
            assert_eq!(ra.len(), rb.len(), "gemm_tn: pair lists differ");
            ra.len()
        }
        None => {
            assert_eq!(a.len() / m, b.len() / n, "gemm_tn: row counts differ");
            a.len() / m
        }
    };
    let segments = rows.div_ceil(SEGMENT);
    if segments <= 1 {
        out.par_chunks_mut(OUT_BLOCK * n).enumerate().for_each(|(block, out)| {
            accumulate_segment(precision, a, m, b, n, pairs, 0..rows, block * OUT_BLOCK, out);
        });
        return;
    }
    // Tasks are (stretch of rows) × (block of output rows); a few stretches at a time bound memory.
    const AT_ONCE: usize = 8;
    let mut partial = vec![0f32; AT_ONCE.min(segments) * m * n];
    for first in (0..segments).step_by(AT_ONCE) {
        let count = AT_ONCE.min(segments - first);
        partial[..count * m * n].par_chunks_mut(m * n).enumerate().for_each(|(s, part)| {
            let start = (first + s) * SEGMENT;
            let range = start..(start + SEGMENT).min(rows);
            part.fill(0.0);
            part.par_chunks_mut(OUT_BLOCK * n).enumerate().for_each(|(block, part)| {
                let (range, first) = (range.clone(), block * OUT_BLOCK);
                accumulate_segment(precision, a, m, b, n, pairs, range, first, part);
            });
        });
        for part in partial[..count * m * n].chunks_exact(m * n) {
            for (o, p) in out.iter_mut().zip(part) {
                *o += p;
            }
        }
    }
}

/// `out += a[range][:, first..]ᵀ · b[range]`; `out` must start zeroed.
#[expect(clippy::too_many_arguments, reason = "one call site, plain numbers")]
fn accumulate_segment(
    precision: Precision,
    a: &[f32],
    m: usize,
    b: &[f32],
    n: usize,
    pairs: Option<(&[u32], &[u32])>,
    range: std::ops::Range<usize>,
    first: usize,
    out: &mut [f32],
) {
    let width = out.len() / n;
    let mut columns = vec![0f32; width * K_BLOCK];
    let mut packed = PackedMatrix::empty();
    let mut gathered = vec![0f32; if pairs.is_some() { K_BLOCK * n } else { 0 }];
    let mut start = range.start;
    while start < range.end {
        let len = K_BLOCK.min(range.end - start);
        for r in 0..len {
            let row = pairs.map_or(start + r, |(ra, _)| ra[start + r] as usize);
            let from = &a[row * m + first..row * m + first + width];
            for (i, v) in from.iter().enumerate() {
                columns[i * len + r] = *v;
            }
        }
        let source = match pairs {
            None => &b[start * n..(start + len) * n],
            Some((_, rb)) => {
                for (to, &row) in gathered.chunks_exact_mut(n).zip(&rb[start..start + len]) {
                    to.copy_from_slice(&b[row as usize * n..(row as usize + 1) * n]);
                }
                &gathered[..len * n]
            }
        };
        repack_with(&mut packed, precision, source, len, n, n, 1);
        // SAFETY: `columns` holds `width` rows of `len`, `out` `width` rows of `n`, both ours.
        unsafe {
            multiply_rows(
                width,
                RowPointers::Contiguous { base: columns.as_ptr(), stride: len },
                &packed,
                0..packed.padded_n(),
                RowPointersMut::Contiguous { base: out.as_mut_ptr(), stride: n },
                true,
            );
        }
        start += len;
    }
}

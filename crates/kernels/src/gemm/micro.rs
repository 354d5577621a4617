//! The register tile: `MR` rows times `16·NV` columns, summed over the steps in order.
//!
//! Each element is one chain of multiply–adds over the steps, whatever tile it falls into, so a row's
//! result never depends on how many rows there are or which thread works on it.

use crate::simd::Vector;
use std::marker::PhantomData;

/// What a step of the sum multiplies.
///
/// # Safety
/// Methods may only run on a CPU with the implementor's instruction set; pointers must be valid for
/// as many elements as `Sum` has lanes.
pub(crate) trait Products {
    /// An operand in memory.
    type Element: Copy;
    /// A register of operands.
    type Factor: Copy;
    /// A register of sums.
    type Sum: Vector;
    unsafe fn load(p: *const Self::Element) -> Self::Factor;
    unsafe fn splat(x: Self::Element) -> Self::Factor;
    /// `sum + a · b` per lane.
    unsafe fn multiply_add(a: Self::Factor, b: Self::Factor, sum: Self::Sum) -> Self::Sum;
}

/// One f32 a step, of the kind `K`: as it is, or rounded before.
pub(crate) struct Singles<V, K = ()>(PhantomData<(V, K)>);

impl<V: Vector, K> Products for Singles<V, K> {
    type Element = f32;
    type Factor = V;
    type Sum = V;
    #[inline(always)]
    unsafe fn load(p: *const f32) -> V {
        // SAFETY: the trait's contract.
        unsafe { V::load(p) }
    }
    #[inline(always)]
    unsafe fn splat(x: f32) -> V {
        // SAFETY: as above.
        unsafe { V::splat(x) }
    }
    #[inline(always)]
    unsafe fn multiply_add(a: V, b: V, sum: V) -> V {
        // SAFETY: as above.
        unsafe { a.fma(b, sum) }
    }
}

/// Two bf16 a step: AVX512-BF16.
#[cfg(target_arch = "x86_64")]
pub(crate) struct Bf16Pairs;

#[cfg(target_arch = "x86_64")]
impl Products for Bf16Pairs {
    type Element = u32;
    type Factor = std::arch::x86_64::__m512i;
    type Sum = std::arch::x86_64::__m512;
    #[inline(always)]
    unsafe fn load(p: *const u32) -> Self::Factor {
        // SAFETY: the trait's contract.
        unsafe { std::arch::x86_64::_mm512_loadu_si512(p.cast()) }
    }
    #[inline(always)]
    unsafe fn splat(x: u32) -> Self::Factor {
        // SAFETY: as above.
        unsafe { std::arch::x86_64::_mm512_set1_epi32(x.cast_signed()) }
    }
    #[inline(always)]
    unsafe fn multiply_add(a: Self::Factor, b: Self::Factor, sum: Self::Sum) -> Self::Sum {
        // SAFETY: as above; both types are 512 bits of any content.
        unsafe {
            use std::arch::x86_64::{__m512bh, __m512i, _mm512_dpbf16_ps};
            let [a, b] = [a, b].map(|x| std::mem::transmute::<__m512i, __m512bh>(x));
            _mm512_dpbf16_ps(sum, a, b)
        }
    }
}

/// What a tile multiplies, and what becomes of its sums: [`Products`] are results as they are, sums of
/// integers are brought to scale.
///
/// # Safety
/// As of [`Products`]; `columns` and `at` name columns of the packed panel.
pub(crate) trait TileProducts {
    /// An operand in memory.
    type Element: Copy;
    /// A register of operands.
    type Factor: Copy;
    /// A register of sums.
    type Sum: Copy;
    /// A register of results, one for each sum.
    type Value: Vector;
    /// What belongs to a row of the left-hand side.
    type Row: Copy + Default;
    /// What belongs to the columns of a panel.
    type Columns: Copy;
    /// What brings a register of sums to scale.
    type Scale: Copy;
    unsafe fn load(p: *const Self::Element) -> Self::Factor;
    unsafe fn splat(x: Self::Element) -> Self::Factor;
    unsafe fn multiply_add(a: Self::Factor, b: Self::Factor, sum: Self::Sum) -> Self::Sum;
    /// What belongs to a row whose sums take `steps` steps.
    unsafe fn row(row: *const Self::Element, steps: usize) -> Self::Row;
    /// What the sums of the columns from `at` on start with.
    unsafe fn start(columns: Self::Columns, at: usize) -> Self::Sum;
    /// The scales of the columns from `at` on.
    unsafe fn scale(columns: Self::Columns, at: usize) -> Self::Scale;
    /// The results of sums.
    unsafe fn finish(sum: Self::Sum, row: Self::Row, scale: Self::Scale) -> Self::Value;
}

impl<P: Products> TileProducts for P {
    type Element = P::Element;
    type Factor = P::Factor;
    type Sum = P::Sum;
    type Value = P::Sum;
    type Row = ();
    type Columns = ();
    type Scale = ();
    #[inline(always)]
    unsafe fn load(p: *const P::Element) -> P::Factor {
        // SAFETY: the trait's contract.
        unsafe { <P as Products>::load(p) }
    }
    #[inline(always)]
    unsafe fn splat(x: P::Element) -> P::Factor {
        // SAFETY: as above.
        unsafe { <P as Products>::splat(x) }
    }
    #[inline(always)]
    unsafe fn multiply_add(a: P::Factor, b: P::Factor, sum: P::Sum) -> P::Sum {
        // SAFETY: as above.
        unsafe { <P as Products>::multiply_add(a, b, sum) }
    }
    #[inline(always)]
    unsafe fn row(_: *const P::Element, _: usize) {}
    #[inline(always)]
    unsafe fn start((): (), _: usize) -> P::Sum {
        // SAFETY: as above.
        unsafe { P::Sum::zero() }
    }
    #[inline(always)]
    unsafe fn scale((): (), _: usize) {}
    #[inline(always)]
    unsafe fn finish(sum: P::Sum, (): (), (): ()) -> P::Sum {
        sum
    }
}

/// Rows of the largest register tile.
pub(crate) const TILE_ROWS: usize = 6;
/// Columns of a packed panel.
pub(crate) const PANEL: usize = 64;

/// What a tile computes of a panel.
#[derive(Clone, Copy)]
pub(crate) struct Extent {
    /// Columns of the packed panel, 16, 32, 48 or 64: from one step to the next.
    pub width: usize,
    /// Columns that exist in the result.
    pub columns: usize,
    /// Steps.
    pub k: usize,
    /// Whether the sums are added to what the result holds.
    pub accumulate: bool,
}

/// Rows of the left-hand side, and what belongs to them and to the columns.
pub(crate) struct Sides<P: TileProducts> {
    /// The rows' operands.
    pub a: [*const P::Element; TILE_ROWS],
    /// What belongs to each row.
    pub rows: [P::Row; TILE_ROWS],
    /// What belongs to the panel's columns.
    pub columns: P::Columns,
}

/// `c[i][0..columns] (+)= Σ_p a[i][p] · b[p·width ..]` for the rows given by pointers, where
/// `columns` is at most the tile's width and `at` the tile's first column in the panel.
///
/// # Safety
/// `sides.a[i]` must hold `k` values, `b` `k` rows of the tile's width at the panel's, `c[i]` `columns`
/// writable values; the rows of `c` must be distinct.
#[inline(always)]
unsafe fn tile<P: TileProducts, const MR: usize, const NV: usize>(
    sides: &Sides<P>,
    at: usize,
    b: *const P::Element,
    c: &[*mut f32; TILE_ROWS],
    Extent { width, columns, k, accumulate }: Extent,
) {
    // SAFETY: the function's contract.
    unsafe {
        let lanes = P::Value::LANES;
        let (a, columns_of) = (&sides.a, sides.columns);
        let first: [P::Sum; NV] = std::array::from_fn(|j| P::start(columns_of, at + j * lanes));
        let mut acc = [first; MR];
        let mut bp = b;
        for p in 0..k {
            let bv: [P::Factor; NV] = std::array::from_fn(|j| P::load(bp.add(j * lanes)));
            for i in 0..MR {
                let av = P::splat(*a[i].add(p));
                for j in 0..NV {
                    acc[i][j] = P::multiply_add(av, bv[j], acc[i][j]);
                }
            }
            bp = bp.add(width);
        }
        // A loop of its own, and short: the compiler unrolls it, or it would keep the sums in memory.
        let mut values = [[P::Value::zero(); NV]; MR];
        let scales: [P::Scale; NV] = std::array::from_fn(|j| P::scale(columns_of, at + j * lanes));
        for i in 0..MR {
            for j in 0..NV {
                values[i][j] = P::finish(acc[i][j], sides.rows[i], scales[j]);
            }
        }
        if columns >= NV * lanes {
            for i in 0..MR {
                for j in 0..NV {
                    let (out, sum) = (c[i].add(j * lanes), values[i][j]);
                    let value = if accumulate { P::Value::load(out).add(sum) } else { sum };
                    value.store(out);
                }
            }
            return;
        }
        for j in 0..NV {
            let there = columns.saturating_sub(j * lanes).min(lanes);
            for i in 0..MR {
                let (out, sum) = (c[i].wrapping_add(j * lanes), values[i][j]);
                let value =
                    if accumulate { P::Value::load_first(out, there).add(sum) } else { sum };
                value.store_first(out, there);
            }
        }
    }
}

#[inline(always)]
unsafe fn tile_rows<P: TileProducts, const NV: usize>(
    rows: usize,
    sides: &Sides<P>,
    at: usize,
    b: *const P::Element,
    c: &[*mut f32; TILE_ROWS],
    extent: Extent,
) {
    // SAFETY: the caller's promise, passed on.
    unsafe {
        match rows {
            6 => tile::<P, 6, NV>(sides, at, b, c, extent),
            5 => tile::<P, 5, NV>(sides, at, b, c, extent),
            4 => tile::<P, 4, NV>(sides, at, b, c, extent),
            3 => tile::<P, 3, NV>(sides, at, b, c, extent),
            2 => tile::<P, 2, NV>(sides, at, b, c, extent),
            _ => tile::<P, 1, NV>(sides, at, b, c, extent),
        }
    }
}

/// Multiplies up to [`TILE_ROWS`] rows by one panel, of whose columns more than `width − 16` exist in
/// the result.
///
/// # Safety
/// As [`tile`]; `rows` is in `1..=TILE_ROWS`, and only the first `rows` pointers are used.
#[inline(always)]
pub(crate) unsafe fn panel<P: TileProducts>(
    rows: usize,
    sides: &Sides<P>,
    b: *const P::Element,
    c: &[*mut f32; TILE_ROWS],
    extent: Extent,
) {
    // Registers hold 6 × 4 sums with 32 of them, 6 × 2 with 16.
    let quads = if P::Value::LANES == 8 { 1 } else { 4 };
    // SAFETY: the caller's promise, passed on; columns stay below `width`.
    unsafe {
        let mut done = 0;
        if P::Value::LANES == 4 {
            // Two registers are half of 16 columns, of which the second half need not exist.
            while done < extent.columns.min(extent.width) {
                let mut cs = *c;
                for p in cs.iter_mut().take(rows) {
                    *p = p.add(done);
                }
                let extent = Extent { columns: extent.columns - done, ..extent };
                tile_rows::<P, 2>(rows, sides, done, b.add(done), &cs, extent);
                done += 8;
            }
            return;
        }
        while done < extent.width {
            let quad = quads.min((extent.width - done) / 16);
            let mut cs = *c;
            for p in cs.iter_mut().take(rows) {
                *p = p.add(done);
            }
            let bp = b.add(done);
            let extent = Extent { columns: extent.columns - done, ..extent };
            if P::Value::LANES == 8 {
                tile_rows::<P, 2>(rows, sides, done, bp, &cs, extent);
            } else {
                match quad {
                    4 => tile_rows::<P, 4>(rows, sides, done, bp, &cs, extent),
                    3 => tile_rows::<P, 3>(rows, sides, done, bp, &cs, extent),
                    2 => tile_rows::<P, 2>(rows, sides, done, bp, &cs, extent),
                    _ => tile_rows::<P, 1>(rows, sides, done, bp, &cs, extent),
                }
            }
            done += quad * 16;
        }
    }
}

//! `aᵀ · b`: the product behind weight gradients, summed over many rows.

use super::{K_BLOCK, PackedMatrix, Product, RowPointers, multiply_rows, repack_with};
use crate::Precision;
use crate::shape::elements;
use crate::simd::{Vector, dispatch};
use rayon::prelude::*;
use std::ops::Range;

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

/// [`gemm_tn`] in another precision; [`Precision::Int8`], which has no gradient, counts as f32.
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
    let precision = precision.of_gradients();
    assert_eq!(out.len(), elements([m, n]), "gemm_tn: result length");
    out.fill(0.0);
    if m == 0 || n == 0 {
        return;
    }
    let rows = match pairs {
        Some((ra, rb)) => {
            assert_eq!(ra.len(), rb.len(), "gemm_tn: pair lists differ");
            let inside = |ids: &[u32], rows: usize| ids.iter().all(|&r| (r as usize) < rows);
            assert!(inside(ra, a.len() / m) && inside(rb, b.len() / n), "gemm_tn: row numbers");
            ra.len()
        }
        None => {
            assert_eq!(a.len() / m, b.len() / n, "gemm_tn: row counts differ");
            a.len() / m
        }
    };
    let sides = Sides { a, m, b, n, pairs };
    let segments = rows.div_ceil(SEGMENT);
    if segments <= 1 {
        out.par_chunks_mut(OUT_BLOCK * n).enumerate().for_each(|(block, out)| {
            sides.accumulate(precision, 0..rows, block * OUT_BLOCK, out);
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
                sides.accumulate(precision, range.clone(), block * OUT_BLOCK, part);
            });
        });
        for part in partial[..count * m * n].chunks_exact(m * n) {
            for (o, p) in out.iter_mut().zip(part) {
                *o += p;
            }
        }
    }
}

/// Both sides of a product, as [`gemm_tn`] has them.
#[derive(Clone, Copy)]
struct Sides<'a> {
    a: &'a [f32],
    m: usize,
    b: &'a [f32],
    n: usize,
    pairs: Option<(&'a [u32], &'a [u32])>,
}

/// `out[i][j] += Σ_p a[p][first + i] · b[p][j]` in f32 over a range of rows or pairs of rows.
///
/// # Safety
/// Row numbers must lie inside `a` (`[rows, m]`) and `b` (`[rows, n]`), `n` is a multiple of 16,
/// `out` holds whole rows of `n` values, one for each channel of `a` from `first` on.
pub(crate) unsafe fn add_outer_products(
    (a, m): (&[f32], usize),
    (b, n): (&[f32], usize),
    pairs: Option<(&[u32], &[u32])>,
    range: Range<usize>,
    first: usize,
    out: &mut [f32],
) {
    let rows = |base: &[f32], stride: usize, ids: Option<&[u32]>| {
        (base.as_ptr(), stride, ids.map_or(std::ptr::null(), <[u32]>::as_ptr))
    };
    let (a, b) = (rows(a, m, pairs.map(|p| p.0)), rows(b, n, pairs.map(|p| p.1)));
    // SAFETY: passed on.
    dispatch!((a: Rows, b: Rows, range: Range<usize>, first: usize, n: usize, out: &mut [f32]),
        V => outer_products::<V>(a, b, range, first, n, out));
}

/// Base, values of a row, and the row numbers (null: all rows in order).
type Rows = (*const f32, usize, *const u32);

/// Bytes of rows that should stay in the second-level cache while the result is swept.
const CACHED_ROWS_BYTES: usize = 512 * 1024;
/// Channels of `a` that make the rows of a register tile.
const TILE: usize = 6;

/// Sums of outer products, straight from the rows: nothing is turned or packed.
///
/// # Safety
/// Rows of both sides must be inside their allocations, `out` holds whole rows of `n`, `n` is a
/// multiple of 16, and the instruction set is that of `V`.
#[inline(always)]
unsafe fn outer_products<V: Vector>(
    a: Rows,
    b: Rows,
    range: Range<usize>,
    first: usize,
    n: usize,
    out: &mut [f32],
) {
    let channels = out.len() / n;
    // Depends on the shape alone, so the order of the sum does.
    let block = (CACHED_ROWS_BYTES / (4 * (a.1 + n))).clamp(64, 2048);
    let mut start = range.start;
    while start < range.end {
        let end = (start + block).min(range.end);
        let mut o = 0;
        while o < channels {
            let height = TILE.min(channels - o);
            let mut column = 0;
            while column < n {
                // SAFETY: the function's contract; the tile lies inside `out`.
                unsafe {
                    let c = out.as_mut_ptr().add(o * n + column);
                    let (a_at, b_at) = (first + o, column);
                    let left = (n - column) / 16;
                    let wide = if V::LANES < 16 { 1 } else { left.min(4) };
                    macro_rules! tile {
                        ($nv:literal) => {
                            match height {
                                6 => outer_tile::<V, 6, $nv>(a, b, a_at, b_at, start..end, c, n),
                                5 => outer_tile::<V, 5, $nv>(a, b, a_at, b_at, start..end, c, n),
                                4 => outer_tile::<V, 4, $nv>(a, b, a_at, b_at, start..end, c, n),
                                3 => outer_tile::<V, 3, $nv>(a, b, a_at, b_at, start..end, c, n),
                                2 => outer_tile::<V, 2, $nv>(a, b, a_at, b_at, start..end, c, n),
                                _ => outer_tile::<V, 1, $nv>(a, b, a_at, b_at, start..end, c, n),
                            }
                        };
                    }
                    match wide {
                        _ if V::LANES == 4 => tile!(4),
                        _ if V::LANES == 8 => tile!(2),
                        4 => tile!(4),
                        3 => tile!(3),
                        2 => tile!(2),
                        _ => tile!(1),
                    }
                    column += wide * 16;
                }
            }
            o += height;
        }
        start = end;
    }
}

/// `c[i][j] += Σ_p a[p][a_at + i] · b[p][b_at + j]` in registers.
///
/// # Safety
/// As [`outer_products`].
#[inline(always)]
unsafe fn outer_tile<V: Vector, const MR: usize, const NV: usize>(
    a: Rows,
    b: Rows,
    a_at: usize,
    b_at: usize,
    range: Range<usize>,
    c: *mut f32,
    c_stride: usize,
) {
    // SAFETY: the function's contract.
    unsafe {
        let row = |rows: Rows, p: usize| {
            let id = if rows.2.is_null() { p } else { *rows.2.add(p) as usize };
            rows.0.add(id * rows.1)
        };
        let mut sums = [[V::zero(); NV]; MR];
        for p in range {
            let (left, right) = (row(a, p).add(a_at), row(b, p).add(b_at));
            let factors: [V; NV] = std::array::from_fn(|j| V::load(right.add(j * V::LANES)));
            for i in 0..MR {
                let factor = V::splat(*left.add(i));
                for j in 0..NV {
                    sums[i][j] = factor.fma(factors[j], sums[i][j]);
                }
            }
        }
        for i in 0..MR {
            for j in 0..NV {
                let at = c.add(i * c_stride + j * V::LANES);
                V::load(at).add(sums[i][j]).store(at);
            }
        }
    }
}

impl Sides<'_> {
    /// `out += a[range][:, first..]ᵀ · b[range]`; `out` must start zeroed.
    fn accumulate(&self, precision: Precision, range: Range<usize>, first: usize, out: &mut [f32]) {
        let &Self { a, m, b, n, pairs } = self;
        if precision == Precision::F32 && n.is_multiple_of(16) {
            // SAFETY: row numbers and `range` were checked against `a` and `b` by the caller; `out` has
            // rows of `n` values, one for each channel from `first` on.
            unsafe { add_outer_products((a, m), (b, n), pairs, range, first, out) }
        } else {
            self.accumulate_packed(precision, range, first, out);
        }
    }

    /// The same in any precision and shape: `a` is turned, `b` packed, block by block.
    fn accumulate_packed(
        &self,
        precision: Precision,
        range: Range<usize>,
        first: usize,
        out: &mut [f32],
    ) {
        let &Self { a, m, b, n, pairs } = self;
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
            let c = RowPointers { base: out.as_mut_ptr(), stride: n, ids: None };
            let (b, all) = (&packed, 0..packed.padded_n());
            let product = Product { rows: width, b, columns: all, c, accumulate: true };
            // SAFETY: `columns` holds `width` rows of `len`, `out` `width` rows of `n`, both ours.
            unsafe { multiply_rows(RowPointers::of(&columns, len, None), product) };
            start += len;
        }
    }
}

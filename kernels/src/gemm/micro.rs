//! The register tile: `MR` rows times `16·NV` columns, summed over k in order.
//!
//! Each element is one chain of multiply–adds over k, whatever tile it falls into, so a row's
//! result never depends on how many rows there are or which thread works on it.

use crate::simd::Vector;

/// Rows of the largest register tile.
pub(crate) const TILE_ROWS: usize = 6;
/// Columns of a packed panel.
pub(crate) const PANEL: usize = 64;

/// `c[i][0..16·NQ] (+)= Σ_p a[i][p] · b[p·b_stride ..]` for the rows given by pointers.
///
/// # Safety
/// `a[i]` must hold `k` values, `b` `k` rows of `16·NQ` values at `b_stride`, `c[i]` `16·NQ`
/// writable values; the rows of `c` must be distinct.
#[inline(always)]
unsafe fn tile<V: Vector, const MR: usize, const NV: usize>(
    a: &[*const f32; TILE_ROWS],
    b: *const f32,
    b_stride: usize,
    c: &[*mut f32; TILE_ROWS],
    k: usize,
    accumulate: bool,
) {
    // SAFETY: the function's contract.
    unsafe {
        let mut acc = [[V::zero(); NV]; MR];
        let mut bp = b;
        for p in 0..k {
            let mut bv = [V::zero(); NV];
            for j in 0..NV {
                bv[j] = V::load(bp.add(j * V::LANES));
            }
            for i in 0..MR {
                let av = V::splat(*a[i].add(p));
                for j in 0..NV {
                    acc[i][j] = av.fma(bv[j], acc[i][j]);
                }
            }
            bp = bp.add(b_stride);
        }
        for i in 0..MR {
            for j in 0..NV {
                let out = c[i].add(j * V::LANES);
                let value = if accumulate { V::load(out).add(acc[i][j]) } else { acc[i][j] };
                value.store(out);
            }
        }
    }
}

#[inline(always)]
unsafe fn tile_rows<V: Vector, const NV: usize>(
    rows: usize,
    a: &[*const f32; TILE_ROWS],
    b: *const f32,
    b_stride: usize,
    c: &[*mut f32; TILE_ROWS],
    k: usize,
    accumulate: bool,
) {
    // SAFETY: the caller's promise, passed on.
    unsafe {
        match rows {
            6 => tile::<V, 6, NV>(a, b, b_stride, c, k, accumulate),
            5 => tile::<V, 5, NV>(a, b, b_stride, c, k, accumulate),
            4 => tile::<V, 4, NV>(a, b, b_stride, c, k, accumulate),
            3 => tile::<V, 3, NV>(a, b, b_stride, c, k, accumulate),
            2 => tile::<V, 2, NV>(a, b, b_stride, c, k, accumulate),
            _ => tile::<V, 1, NV>(a, b, b_stride, c, k, accumulate),
        }
    }
}

/// Multiplies up to [`TILE_ROWS`] rows by one panel of `width` (16, 32, 48 or 64) columns.
///
/// # Safety
/// As [`tile`]; `rows` is in `1..=TILE_ROWS`, and only the first `rows` pointers are used.
#[inline(always)]
pub(crate) unsafe fn panel<V: Vector>(
    rows: usize,
    a: &[*const f32; TILE_ROWS],
    b: *const f32,
    width: usize,
    c: &[*mut f32; TILE_ROWS],
    k: usize,
    accumulate: bool,
) {
    // Registers hold 6 × 4 sums with 32 of them, 6 × 2 with 16.
    let quads = if V::LANES == 8 { 1 } else { 4 };
    // SAFETY: the caller's promise, passed on; columns stay below `width`.
    unsafe {
        let mut done = 0;
        while done < width {
            let quad = quads.min((width - done) / 16);
            let mut cs = *c;
            for p in cs.iter_mut().take(rows) {
                *p = p.add(done);
            }
            let bp = b.add(done);
            if V::LANES == 8 {
                tile_rows::<V, 2>(rows, a, bp, width, &cs, k, accumulate);
            } else {
                match quad {
                    4 => tile_rows::<V, 4>(rows, a, bp, width, &cs, k, accumulate),
                    3 => tile_rows::<V, 3>(rows, a, bp, width, &cs, k, accumulate),
                    2 => tile_rows::<V, 2>(rows, a, bp, width, &cs, k, accumulate),
                    _ => tile_rows::<V, 1>(rows, a, bp, width, &cs, k, accumulate),
                }
            }
            done += quad * 16;
        }
    }
}

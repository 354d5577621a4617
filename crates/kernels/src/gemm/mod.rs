//! Matrix products of f32 matrices, in the [`Precision`](crate::Precision) asked for.
//!
//! The right-hand side (weights) is packed once into panels, in the form that the product reads:
//! f32, pairs of bf16, three times the pairs for the two parts of each f32, or 8-bit integers. The left-hand side
//! and the result are rows of f32 found through pointers, so gathering input rows and scattering
//! output rows costs nothing extra and no gathered copy is written to memory; where the product
//! reads bf16 or integers, rows are rounded block by block into a buffer that fits into the cache.
//!
//! Sums are f32, with fused multiply–adds where the CPU has them. Every output element is summed in
//! one fixed order that depends only on `k`: results are bit-identical for any number of threads
//! and for a row alone or among others, on CPUs with the same instruction sets.

#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
pub(crate) mod amx;
pub(crate) mod bf16;
pub(crate) mod int8;
pub(crate) mod micro;
mod packed;
mod rows;
mod transposed;

pub use packed::PackedMatrix;
pub(crate) use packed::repack_with;
pub(crate) use rows::{PreparedRows, Product, RowPointers, multiply_rows};
pub(crate) use transposed::add_outer_products;
pub use transposed::{gemm_tn, gemm_tn_with};

use crate::shape::elements;
use micro::PANEL;
use rayon::prelude::*;

/// Steps of a sum that are added up in registers before they go to memory.
pub(crate) const K_BLOCK: usize = 384;
/// Rows that one task works on; a multiple of the tile height.
pub(crate) const ROW_BLOCK: usize = 192;

/// What happens to a finished row of a product before it leaves the cache.
#[derive(Debug, Clone, Copy, Default)]
pub struct Epilogue<'a> {
    /// Added to every row. `[n]`
    pub bias: Option<&'a [f32]>,
    /// Applies the exact GELU after the bias.
    pub gelu: bool,
    /// Added last, same layout as the result. `[m, n]`
    pub residual: Option<&'a [f32]>,
}

/// `out = epilogue(a · b)`.
///
/// # Shapes
/// `a`: `[m, k]` row-major · `b`: packed `[k, n]` · `out`: `[m, n]` row-major
///
/// # Panics
/// If lengths do not fit the shapes (a bug of the caller).
pub fn gemm(a: &[f32], b: &PackedMatrix, epilogue: Epilogue<'_>, out: &mut [f32]) {
    let (k, n) = (b.k(), b.n());
    if n == 0 || out.is_empty() {
        return;
    }
    let m = checked_rows(a, b, epilogue, out);
    if k == 0 {
        out.fill(0.0);
        finish(out, n, Epilogue { ..epilogue });
        return;
    }
    let row_blocks = m.div_ceil(ROW_BLOCK);
    let groups = column_groups(b.padded_n(), row_blocks);
    let target = SharedMut(out.as_mut_ptr());
    (0..row_blocks * groups.len()).into_par_iter().for_each(|task| {
        let first = task / groups.len() * ROW_BLOCK;
        let rows = ROW_BLOCK.min(m - first);
        let columns = groups[task % groups.len()].clone();
        let from = &a[first * k..(first + rows) * k];
        // SAFETY: the tasks' rectangles of `out` are disjoint and inside it.
        unsafe {
            let to = target.at(first * n);
            let c = RowPointers { base: to, stride: n, ids: None };
            let product = Product { rows, b, columns: columns.clone(), c, accumulate: false };
            multiply_rows(RowPointers::of(from, k, None), product);
            let columns = columns.start..columns.end.min(n);
            if columns == (0..n) {
                let residual = epilogue.residual.map(|r| &r[first * n..(first + rows) * n]);
                let out = std::slice::from_raw_parts_mut(to, rows * n);
                finish(out, n, Epilogue { residual, ..epilogue });
            } else {
                for row in 0..rows {
                    let start = (first + row) * n + columns.start;
                    let out = std::slice::from_raw_parts_mut(target.at(start), columns.len());
                    let bias = epilogue.bias.map(|b| &b[columns.clone()]);
                    let residual = epilogue.residual.map(|r| &r[start..start + columns.len()]);
                    finish(out, columns.len(), Epilogue { bias, residual, ..epilogue });
                }
            }
        }
    });
}

/// Rows of a product whose lengths fit.
fn checked_rows(a: &[f32], b: &PackedMatrix, epilogue: Epilogue<'_>, out: &[f32]) -> usize {
    let (k, n) = (b.k(), b.n());
    let m = out.len() / n;
    assert!(
        a.len() == elements([m, k]) && out.len() == m * n,
        "gemm: lengths do not fit [{m}, {k}]·[{k}, {n}]"
    );
    check_epilogue(epilogue, n, out.len());
    m
}

fn check_epilogue(epilogue: Epilogue<'_>, n: usize, len: usize) {
    assert!(epilogue.bias.is_none_or(|b| b.len() == n), "gemm: bias length");
    assert!(epilogue.residual.is_none_or(|r| r.len() == len), "gemm: residual length");
}

/// Cuts the columns into groups of whole panels when there are too few row blocks to share out.
///
/// Columns are independent of each other, so the cut never changes a result.
pub(crate) fn column_groups(padded_n: usize, row_blocks: usize) -> Vec<std::ops::Range<usize>> {
    let panels = padded_n.div_ceil(PANEL);
    let wanted = 4 * rayon::current_num_threads();
    let groups = wanted.div_ceil(row_blocks.max(1)).min(panels).max(1);
    let each = panels.div_ceil(groups) * PANEL;
    (0..padded_n).step_by(each).map(|s| s..(s + each).min(padded_n)).collect()
}

/// A pointer that tasks share; each writes its own part.
#[derive(Clone, Copy)]
pub(crate) struct SharedMut(pub(crate) *mut f32);

// SAFETY: users write disjoint parts only.
unsafe impl Send for SharedMut {}
// SAFETY: as above.
unsafe impl Sync for SharedMut {}

impl SharedMut {
    /// The element `offset` further on.
    ///
    /// # Safety
    /// It must be inside the allocation.
    pub(crate) unsafe fn at(self, offset: usize) -> *mut f32 {
        // SAFETY: passed on.
        unsafe { self.0.add(offset) }
    }
}

/// `out = gelu(a · b1 + bias1) · b2 + bias2 + residual`, without a full-size hidden matrix.
///
/// # Shapes
/// `a`: `[m, k]` · `b1`: `[k, h]` · `b2`: `[h, n]` · `out`: `[m, n]`
///
/// # Panics
/// If lengths do not fit the shapes (a bug of the caller).
pub fn mlp(
    a: &[f32],
    (b1, bias1): (&PackedMatrix, &[f32]),
    b2: &PackedMatrix,
    epilogue: Epilogue<'_>,
    out: &mut [f32],
) {
    let (k, h, n) = (b1.k(), b1.n(), b2.n());
    if n == 0 || out.is_empty() {
        return;
    }
    assert!(h > 0, "mlp: no hidden channel");
    let m = out.len() / n;
    let shapes = b2.k() == h && bias1.len() == h && out.len() == m * n;
    assert!(shapes && a.len() == elements([m, k]), "mlp: shapes");
    check_epilogue(epilogue, n, out.len());
    // A smaller block than in `gemm`: the hidden rows are four times as wide and must stay cached.
    const ROWS: usize = ROW_BLOCK / 2;
    out.par_chunks_mut(ROWS * n).enumerate().for_each_init(
        || vec![0f32; ROWS * h],
        |hidden, (block, out)| {
            let first = block * ROWS;
            let rows = out.len() / n;
            let hidden = &mut hidden[..rows * h];
            gemm_block(&a[first * k..(first + rows) * k], b1, hidden);
            finish(hidden, h, Epilogue { bias: Some(bias1), gelu: true, residual: None });
            gemm_block(hidden, b2, out);
            let residual = epilogue.residual.map(|r| &r[first * n..(first + rows) * n]);
            finish(out, n, Epilogue { residual, ..epilogue });
        },
    );
}

/// `out = (a · b + bias)`, each row then divided by its norm as
/// [`normalize_rows`](crate::normalize::normalize_rows) does, before it leaves the cache.
///
/// # Shapes
/// As [`gemm`].
///
/// # Panics
/// As [`gemm`].
pub fn gemm_unit_rows(a: &[f32], b: &PackedMatrix, bias: Option<&[f32]>, out: &mut [f32]) {
    let (k, n) = (b.k(), b.n());
    if n == 0 || out.is_empty() {
        return;
    }
    let epilogue = Epilogue { bias, ..Epilogue::default() };
    checked_rows(a, b, epilogue, out);
    // Whole rows, few enough for the second-level cache where they are wide.
    const ROWS: usize = ROW_BLOCK / 2;
    out.par_chunks_mut(ROWS * n).enumerate().for_each(|(block, out)| {
        let (first, rows) = (block * ROWS, out.len() / n);
        gemm_block(&a[first * k..(first + rows) * k], b, out);
        finish(out, n, epilogue);
        crate::normalize::normalize_block(out, n);
    });
}

fn finish(out: &mut [f32], n: usize, epilogue: Epilogue<'_>) {
    if let Some(bias) = epilogue.bias {
        for row in out.chunks_exact_mut(n) {
            for (o, b) in row.iter_mut().zip(bias) {
                *o += b;
            }
        }
    }
    if epilogue.gelu {
        crate::activation::gelu_in_place(out);
    }
    if let Some(residual) = epilogue.residual {
        for (o, r) in out.iter_mut().zip(residual) {
            *o += r;
        }
    }
}

/// One thread's share: contiguous rows.
fn gemm_block(a: &[f32], b: &PackedMatrix, out: &mut [f32]) {
    let rows = out.len() / b.n();
    if b.k() == 0 {
        out.fill(0.0);
        return;
    }
    let c = RowPointers { base: out.as_mut_ptr(), stride: b.n(), ids: None };
    let product = Product { rows, b, columns: 0..b.padded_n(), c, accumulate: false };
    // SAFETY: `a` has `rows · k` and `out` `rows · n` values; `out` is borrowed mutably.
    unsafe { multiply_rows(RowPointers::of(a, b.k(), None), product) }
}

#[cfg(test)]
mod tests;

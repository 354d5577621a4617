//! Matrix products in f32.
//!
//! The right-hand side (weights) is packed once into panels; the left-hand side and the result are
//! rows found through pointers, so gathering input rows and scattering output rows costs nothing
//! extra and no gathered copy is written to memory.
//!
//! Accumulation is f32 with fused multiply–adds where the CPU has them. Every output element is
//! summed in one fixed order that depends only on `k`: results are bit-identical for any number of
//! threads and for a row alone or among others.

#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
#[allow(dead_code)]
mod amx;
pub(crate) mod micro;
mod transposed;

pub use transposed::gemm_tn;

use crate::simd::{Vector, dispatch};
use micro::{PANEL, TILE_ROWS};
use rayon::prelude::*;

/// Summands that are added up in registers before they go to memory.
pub(crate) const K_BLOCK: usize = 384;
/// Bytes of packed weights that should stay in the second-level cache.
const CACHED_PANEL_BYTES: usize = 512 * 1024;
/// Rows that one task works on; a multiple of the tile height.
pub(crate) const ROW_BLOCK: usize = 192;

/// A `[k, n]` matrix packed for the right-hand side of a product.
#[derive(Debug, Clone)]
pub struct PackedMatrix {
    values: Vec<f32>,
    k: usize,
    n: usize,
    padded_n: usize,
}

impl PackedMatrix {
    /// Packs a matrix given by strides: element `(p, j)` is `values[p·k_stride + j·n_stride]`.
    ///
    /// A weight stored `[out, in]` for `y = x·Wᵀ` is packed with `k = in`, `n = out`,
    /// `k_stride = 1`, `n_stride = in`.
    pub fn from_strided(
        values: &[f32],
        k: usize,
        n: usize,
        k_stride: usize,
        n_stride: usize,
    ) -> Self {
        let padded_n = n.next_multiple_of(16);
        let mut packed = vec![0.0; k * padded_n];
        pack_into(&mut packed, values, k, n, k_stride, n_stride);
        Self { values: packed, k, n, padded_n }
    }

    /// A buffer for [`repack`].
    pub(crate) fn empty() -> Self {
        Self { values: Vec::new(), k: 0, n: 0, padded_n: 0 }
    }

    /// Length of the sums.
    pub fn k(&self) -> usize {
        self.k
    }

    /// Number of columns.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.values.len() * size_of::<f32>()
    }
}

/// Packs another matrix into the same buffer; arguments as [`PackedMatrix::from_strided`].
pub(crate) fn repack(
    into: &mut PackedMatrix,
    values: &[f32],
    k: usize,
    n: usize,
    k_stride: usize,
    n_stride: usize,
) {
    into.k = k;
    into.n = n;
    into.padded_n = n.next_multiple_of(16);
    into.values.clear();
    into.values.resize(k * into.padded_n, 0.0);
    pack_into(&mut into.values, values, k, n, k_stride, n_stride);
}

/// Packs into panels of [`PANEL`] columns (the last one of the next multiple of 16), row by row.
fn pack_into(
    packed: &mut [f32],
    values: &[f32],
    k: usize,
    n: usize,
    k_stride: usize,
    n_stride: usize,
) {
    let padded_n = n.next_multiple_of(16);
    let mut start = 0;
    while start < padded_n {
        let width = PANEL.min(padded_n - start);
        let panel = &mut packed[start * k..(start + width) * k];
        let filled = width.min(n - start);
        if n_stride == 1 {
            for p in 0..k {
                let from = p * k_stride + start;
                panel[p * width..p * width + filled].copy_from_slice(&values[from..from + filled]);
            }
        } else {
            // Blocks of 16 rows of the panel: reads run along k, writes stay in 16 cache lines.
            for first in (0..k).step_by(16) {
                let last = (first + 16).min(k);
                for j in 0..filled {
                    let from = (start + j) * n_stride;
                    for p in first..last {
                        panel[p * width + j] = values[from + p * k_stride];
                    }
                }
            }
        }
        start += width;
    }
}

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
    let (k, n) = (b.k, b.n);
    if n == 0 || out.is_empty() {
        return;
    }
    let m = out.len() / n;
    assert!(
        a.len() == m * k && out.len() == m * n,
        "gemm: lengths do not fit [{m}, {k}]·[{k}, {n}]"
    );
    assert!(epilogue.residual.is_none_or(|r| r.len() == out.len()), "gemm: residual length");
    if k == 0 {
        out.fill(0.0);
        finish(out, n, Epilogue { ..epilogue });
        return;
    }
    let row_blocks = m.div_ceil(ROW_BLOCK);
    let groups = column_groups(b.padded_n, row_blocks);
    let target = SharedMut(out.as_mut_ptr());
    (0..row_blocks * groups.len()).into_par_iter().for_each(|task| {
        let first = task / groups.len() * ROW_BLOCK;
        let rows = ROW_BLOCK.min(m - first);
        let columns = groups[task % groups.len()].clone();
        let from = &a[first * k..(first + rows) * k];
        // SAFETY: the tasks' rectangles of `out` are disjoint and inside it.
        unsafe {
            let to = target.at(first * n);
            multiply_rows(
                rows,
                RowPointers::Contiguous { base: from.as_ptr(), stride: k },
                b,
                columns.clone(),
                RowPointersMut::Contiguous { base: to, stride: n },
                false,
            );
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
    let (k, h, n) = (b1.k, b1.n, b2.n);
    if n == 0 || out.is_empty() {
        return;
    }
    assert!(h > 0, "mlp: no hidden channel");
    assert!(b2.k == h && bias1.len() == h && out.len() / n.max(1) * k == a.len(), "mlp: shapes");
    // A smaller block than in `gemm`: the hidden rows are four times as wide and must stay cached.
    const ROWS: usize = ROW_BLOCK / 2;
    out.par_chunks_mut(ROWS * n.max(1)).enumerate().for_each_init(
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
    let rows = out.len() / b.n;
    let a_rows = RowPointers::Contiguous { base: a.as_ptr(), stride: b.k };
    let out_rows = RowPointersMut::Contiguous { base: out.as_mut_ptr(), stride: b.n };
    if b.k == 0 {
        out.fill(0.0);
        return;
    }
    // SAFETY: `a` has `rows · k` and `out` `rows · n` values; `out` is borrowed mutably.
    unsafe { multiply_rows(rows, a_rows, b, 0..b.padded_n, out_rows, false) }
}

/// Where the left-hand rows are.
#[derive(Clone, Copy)]
pub(crate) enum RowPointers<'a> {
    /// Row `i` starts at `base + i·stride`.
    Contiguous { base: *const f32, stride: usize },
    /// Row `i` starts at `base + ids[i]·stride`.
    Gathered { base: *const f32, stride: usize, ids: &'a [u32] },
}

/// Where the result rows go.
#[derive(Clone, Copy)]
pub(crate) enum RowPointersMut<'a> {
    /// Row `i` starts at `base + i·stride`.
    Contiguous { base: *mut f32, stride: usize },
    /// Row `i` starts at `base + ids[i]·stride`; the ids are distinct.
    Scattered { base: *mut f32, stride: usize, ids: &'a [u32] },
}

impl RowPointers<'_> {
    #[inline(always)]
    unsafe fn row(&self, i: usize) -> *const f32 {
        // SAFETY: the creator promises that every row is inside the allocation.
        unsafe {
            match *self {
                Self::Contiguous { base, stride } => base.add(i * stride),
                Self::Gathered { base, stride, ids } => base.add(ids[i] as usize * stride),
            }
        }
    }
}

impl RowPointersMut<'_> {
    #[inline(always)]
    unsafe fn row(&self, i: usize) -> *mut f32 {
        // SAFETY: the creator promises that every row is inside the allocation.
        unsafe {
            match *self {
                Self::Contiguous { base, stride } => base.add(i * stride),
                Self::Scattered { base, stride, ids } => base.add(ids[i] as usize * stride),
            }
        }
    }
}

/// `c[rows] (+)= a[rows] · b` on the calling thread, for a range of columns of whole panels.
///
/// # Safety
/// `columns` starts at a multiple of [`PANEL`] and ends at one or at the padded width.
/// All rows of `a` (`b.k` values) and `c` (`b.n` values) must be inside their allocations, and no
/// other thread may touch the rows of `c` meanwhile.
pub(crate) unsafe fn multiply_rows(
    rows: usize,
    a: RowPointers<'_>,
    b: &PackedMatrix,
    columns: std::ops::Range<usize>,
    c: RowPointersMut<'_>,
    accumulate: bool,
) {
    // SAFETY: passed on.
    dispatch!((rows: usize, a: RowPointers<'_>, b: &PackedMatrix,
        columns: std::ops::Range<usize>, c: RowPointersMut<'_>, accumulate: bool),
        V => multiply_rows_with::<V>(rows, a, b, columns, c, accumulate));
}

#[inline(always)]
unsafe fn multiply_rows_with<V: Vector>(
    rows: usize,
    a: RowPointers<'_>,
    b: &PackedMatrix,
    columns: std::ops::Range<usize>,
    c: RowPointersMut<'_>,
    accumulate: bool,
) {
    let (k, n, padded_n) = (b.k, b.n, columns.end);
    let k_step = K_BLOCK.min(k);
    let panels_cached = (CACHED_PANEL_BYTES / (k_step * PANEL * 4)).max(1) * PANEL;
    let mut tail = [[0f32; PANEL]; TILE_ROWS];
    let tail_rows: [*mut f32; TILE_ROWS] = std::array::from_fn(|i| tail[i].as_mut_ptr());
    let mut k0 = 0;
    while k0 < k {
        let k_len = k_step.min(k - k0);
        let add = accumulate || k0 > 0;
        let mut group = columns.start;
        while group < padded_n {
            let group_end = (group + panels_cached).min(padded_n);
            let mut row = 0;
            while row < rows {
                let height = TILE_ROWS.min(rows - row);
                let mut a_rows = [std::ptr::null(); TILE_ROWS];
                let mut c_rows = [std::ptr::null_mut(); TILE_ROWS];
                for i in 0..height {
                    // SAFETY: the caller's promise.
                    unsafe {
                        a_rows[i] = a.row(row + i).add(k0);
                        c_rows[i] = c.row(row + i);
                    }
                }
                let mut start = group;
                while start < group_end {
                    let width = PANEL.min(padded_n - start);
                    // SAFETY: panels are contiguous; the columns written stay below `n`, the
                    // padded ones go to `tail`.
                    unsafe {
                        let panel = b.values.as_ptr().add(start * k + k0 * width);
                        if start + width <= n {
                            let at: [*mut f32; TILE_ROWS] = std::array::from_fn(|i| {
                                if i < height { c_rows[i].add(start) } else { c_rows[i] }
                            });
                            micro::panel::<V>(height, &a_rows, panel, width, &at, k_len, add);
                        } else {
                            micro::panel::<V>(
                                height, &a_rows, panel, width, &tail_rows, k_len, false,
                            );
                            for i in 0..height {
                                for j in 0..n - start {
                                    let out = c_rows[i].add(start + j);
                                    let value = *tail_rows[i].add(j);
                                    *out = if add { *out + value } else { value };
                                }
                            }
                        }
                    }
                    start += width;
                }
                row += height;
            }
            group = group_end;
        }
        k0 += k_len;
    }
}

#[cfg(test)]
mod tests;

//! Products of rows found through pointers, on the calling thread.

use super::bf16;
use super::int8::{self, Dots, Quads};
use super::micro::{self, Extent, PANEL, Sides, Singles, TILE_ROWS, TileProducts};
use super::packed::{PackedMatrix, Unit, Values};
use super::{K_BLOCK, ROW_BLOCK};
use crate::simd::dispatch;
use std::cell::RefCell;
use std::ops::Range;

/// Bytes of packed weights that should stay in the second-level cache.
const CACHED_PANEL_BYTES: usize = 512 * 1024;

/// Where rows are: row `i` starts at `base + i·stride`, or at `base + ids[i]·stride`.
///
/// Left-hand rows are read only. The ids of result rows are distinct.
#[derive(Clone, Copy)]
pub(crate) struct RowPointers<'a, T = f32> {
    pub(crate) base: *mut T,
    pub(crate) stride: usize,
    pub(crate) ids: Option<&'a [u32]>,
}

impl<'a, T> RowPointers<'a, T> {
    /// Left-hand rows.
    pub(crate) fn of(values: &'a [T], stride: usize, ids: Option<&'a [u32]>) -> Self {
        Self { base: values.as_ptr().cast_mut(), stride, ids }
    }

    #[inline(always)]
    pub(crate) unsafe fn row(&self, i: usize) -> *mut T {
        let row = self.ids.map_or(i, |ids| ids[i] as usize);
        // SAFETY: the creator promises that every row is inside the allocation.
        unsafe { self.base.add(row * self.stride) }
    }
}

/// `c[rows] (+)= a[rows] · b` for a range of columns of whole panels.
///
/// `columns` starts at a multiple of [`PANEL`] and ends at one or at the padded width. All rows of `a` (`b.k`
/// values) and `c` (`b.n` values) must be inside their allocations, and no other thread may touch the rows of
/// `c` meanwhile.
#[derive(Clone)]
pub(crate) struct Product<'a> {
    pub(crate) rows: usize,
    pub(crate) b: &'a PackedMatrix,
    pub(crate) columns: Range<usize>,
    pub(crate) c: RowPointers<'a>,
    pub(crate) accumulate: bool,
}

/// Left-hand rows in the form that a packed matrix multiplies.
#[derive(Clone, Copy)]
enum LeftRows<'a> {
    /// f32, rounded already where the unit needs that.
    Single(RowPointers<'a, f32>),
    /// Pairs of bf16 or four integers each, [`PackedMatrix::steps`] of them, and what follows them.
    Words(RowPointers<'a, u32>),
}

/// Rows of a matrix brought into that form once, for products that read them many times.
pub(crate) enum PreparedRows {
    /// As they are.
    Unchanged,
    Rounded(Vec<f32>),
    Words {
        values: Vec<u32>,
        /// Words of a row.
        stride: usize,
    },
}

impl PreparedRows {
    /// Prepares `x` (`[rows, b.k()]`) on all threads.
    pub(crate) fn new(x: &[f32], b: &PackedMatrix) -> Self {
        use rayon::prelude::*;
        match b.unit {
            // Tiles need rows side by side, so they are rounded when they are gathered.
            Unit::Vector | Unit::Tiles | Unit::SplitTiles | Unit::QuadTiles => Self::Unchanged,
            Unit::RoundedVector => {
                let mut rounded = vec![0.0; x.len()];
                let block = 1 << 14;
                let parts = rounded.par_chunks_mut(block).zip(x.par_chunks(block));
                parts.for_each(|(to, from)| bf16::round_values(from, to));
                Self::Rounded(rounded)
            }
            Unit::Pairs | Unit::SplitPairs | Unit::Quads => {
                let (k, stride) = (b.k(), b.row_words());
                let mut values = vec![0; x.len() / k * stride];
                let rows = values.par_chunks_mut(stride).zip(x.par_chunks(k)).with_min_len(64);
                rows.for_each(|(to, from)| b.unit.prepare_words(from, to));
                Self::Words { values, stride }
            }
        }
    }

    /// Multiplies the rows `ids` of `x` (`[rows, k]`), which these were made of.
    ///
    /// # Safety
    /// As [`multiply_rows`].
    pub(crate) unsafe fn multiply(
        &self,
        (x, k): (&[f32], usize),
        ids: &[u32],
        product: Product<'_>,
    ) {
        let ids = Some(ids);
        // SAFETY: passed on.
        unsafe {
            let left = match self {
                Self::Unchanged => return multiply_rows(RowPointers::of(x, k, ids), product),
                Self::Rounded(x) => LeftRows::Single(RowPointers::of(x, k, ids)),
                Self::Words { values, stride } => {
                    LeftRows::Words(RowPointers::of(values, *stride, ids))
                }
            };
            multiply_prepared(left, product);
        }
    }
}

thread_local! {
    /// Left-hand rows of one block, rounded.
    static ROUNDED: RefCell<(Vec<f32>, Vec<u32>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// Computes a product on the calling thread.
///
/// # Safety
/// As [`Product`] says.
pub(crate) unsafe fn multiply_rows(a: RowPointers<'_>, product: Product<'_>) {
    let (b, rows) = (product.b, product.rows);
    if b.unit == Unit::Vector {
        // SAFETY: passed on.
        return unsafe { multiply_prepared(LeftRows::Single(a), product) };
    }
    ROUNDED.with_borrow_mut(|(values, words)| {
        let (k, stride) = (b.k(), b.row_words());
        for first in (0..rows).step_by(ROW_BLOCK) {
            let count = ROW_BLOCK.min(rows - first);
            // SAFETY: the caller's promise for each row.
            let row = |i: usize| unsafe { std::slice::from_raw_parts(a.row(first + i), k) };
            let left = if b.unit == Unit::RoundedVector {
                values.resize(values.len().max(count * k), 0.0);
                for i in 0..count {
                    bf16::round_values(row(i), &mut values[i * k..(i + 1) * k]);
                }
                LeftRows::Single(RowPointers::of(values, k, None))
            } else {
                // Tiles read sixteen rows at a time.
                let padded = count.next_multiple_of(16) * stride;
                words.resize(words.len().max(padded), 0);
                for i in 0..count {
                    b.unit.prepare_words(row(i), &mut words[i * stride..(i + 1) * stride]);
                }
                LeftRows::Words(RowPointers::of(words, stride, None))
            };
            let RowPointers { base, stride, ids } = product.c;
            // SAFETY: rows of `c` as promised, from `first` on.
            unsafe {
                let c = match ids {
                    None => RowPointers { base: base.add(first * stride), stride, ids },
                    Some(ids) => {
                        RowPointers { base, stride, ids: Some(&ids[first..first + count]) }
                    }
                };
                multiply_prepared(left, Product { rows: count, c, ..product.clone() });
            }
        }
    });
}

/// [`multiply_rows`] of rows that have the form of `b` already.
///
/// # Safety
/// As [`multiply_rows`]; the form is that of `b`, rows have `b.row_words()` values.
unsafe fn multiply_prepared(a: LeftRows<'_>, product: Product<'_>) {
    let b = product.b;
    match (a, &b.values) {
        (LeftRows::Single(a), Values::Single(values)) => {
            // SAFETY: passed on.
            dispatch!((a: RowPointers<'_>, values: &[f32], product: Product<'_>),
                V => multiply_with::<Singles<V>>(a, values, product, |_, _| ()));
        }
        #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
        (LeftRows::Words(RowPointers { base, ids: None, .. }), Values::Pairs(values))
            if matches!(b.unit, Unit::Tiles | Unit::SplitTiles) =>
        {
            // SAFETY: passed on; pairs are packed for tiles only where there are some.
            unsafe { multiply_tiles(base, values, product) }
        }
        #[cfg(target_arch = "x86_64")]
        (LeftRows::Words(a), Values::Pairs(values)) => {
            // SAFETY: passed on; pairs are packed only where the instruction set was detected.
            unsafe { multiply_pairs(a, values, product) }
        }
        #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
        (LeftRows::Words(RowPointers { base, ids: None, .. }), Values::Quads(quads))
            if b.unit == Unit::QuadTiles =>
        {
            // SAFETY: passed on; integers are packed for tiles only where there are some.
            unsafe { multiply_quad_tiles(base, quads, product) }
        }
        (LeftRows::Words(a), Values::Quads(quads)) => {
            // SAFETY: passed on; the version is one that the CPU has.
            unsafe { multiply_quads(Dots::current(), a, quads, product) }
        }
        // A bug of this crate; a result left as it was would pass for one.
        _ => unreachable!("left-hand rows in another form than the matrix"),
    }
}

/// Pairs that one call of the tile loop sums up: with them, rows and columns stay where the tiles
/// are fed fast enough.
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
const TILE_PAIRS: usize = 192;

/// Products on tiles; `a` points to rows side by side, up to the next multiple of 16 readable.
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
unsafe fn multiply_tiles(a: *const u32, values: &[u32], product: Product<'_>) {
    use super::amx::{self, Operands::Pairs};
    let Product { rows, b, columns, c, accumulate } = product;
    assert!(rows <= ROW_BLOCK, "more rows than a block has");
    let (steps, n) = (b.steps(), b.n());
    // SAFETY: pairs are packed for tiles only where there are some.
    unsafe { amx::configure() };
    let mut tail = Vec::new();
    for k0 in (0..steps).step_by(TILE_PAIRS) {
        let k_len = TILE_PAIRS.min(steps - k0);
        let add = accumulate || k0 > 0;
        for start in columns.clone().step_by(PANEL) {
            let width = PANEL.min(columns.end - start);
            let whole = start + width <= n;
            if !whole {
                tail.resize(rows * width, 0.0);
            }
            let tail_base = tail.as_mut_ptr();
            let targets: [*mut f32; ROW_BLOCK] = std::array::from_fn(|i| {
                if i >= rows {
                    return std::ptr::null_mut();
                }
                // SAFETY: row `i` of the result, from column `start` on, or of the buffer.
                unsafe { if whole { c.row(i).add(start) } else { tail_base.add(i * width) } }
            });
            // SAFETY: the panel has `steps` rows of `width` pairs from `start · steps` on; rows of
            // `a` as promised; targets are distinct rows of at least `width` values.
            unsafe {
                let panel = values.as_ptr().add(start * steps + k0 * width);
                let (from, add) = (a.add(k0), add && whole);
                amx::panel(Pairs, rows, from, steps, panel, width, &targets[..rows], k_len, add);
            }
            if !whole {
                for (i, from) in tail.chunks_exact(width).enumerate() {
                    // SAFETY: the columns of the row that exist.
                    let to =
                        unsafe { std::slice::from_raw_parts_mut(c.row(i).add(start), n - start) };
                    for (to, from) in to.iter_mut().zip(from) {
                        *to = if add { *to + from } else { *from };
                    }
                }
            }
        }
    }
}

/// Products of integers on tiles; `a` as for [`multiply_tiles`].
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
#[target_feature(enable = "avx512f,avx2,fma")]
unsafe fn multiply_quad_tiles(a: *const u32, quads: &Quads, product: Product<'_>) {
    use super::amx::{self, Operands::Bytes};
    let Product { rows, b, columns, c, accumulate } = product;
    assert!(rows <= ROW_BLOCK, "more rows than a block has");
    let (steps, stride, n) = (b.steps(), b.row_words(), b.n());
    // SAFETY: integers are packed for tiles only where there are some.
    unsafe { amx::configure() };
    let mut sums = vec![0i32; rows * PANEL];
    for k0 in (0..steps).step_by(K_BLOCK) {
        let end = (k0 + K_BLOCK).min(steps);
        let add = accumulate || k0 > 0;
        for start in columns.clone().step_by(PANEL) {
            let width = PANEL.min(columns.end - start);
            let base = sums.as_mut_ptr().cast::<f32>();
            let targets: [*mut f32; ROW_BLOCK] =
                std::array::from_fn(|i| base.wrapping_add(i.min(rows - 1) * width));
            for from in (k0..end).step_by(TILE_PAIRS) {
                let len = TILE_PAIRS.min(end - from);
                // SAFETY: as of the bf16 tiles; sums have `rows` rows of `width` values.
                unsafe {
                    let panel = quads.words.as_ptr().add(start * steps + from * width);
                    let to = &targets[..rows];
                    amx::panel(Bytes, rows, a.add(from), stride, panel, width, to, len, from > k0);
                }
            }
            let there = width.min(n - start);
            let starts = &quads.starts[k0 / K_BLOCK * b.padded_n() + start..][..there];
            let scales = &quads.scales[start..start + there];
            for (i, sums) in sums.chunks_exact(width).take(rows).enumerate() {
                // SAFETY: the scale behind a row's words; the columns of the row that exist.
                let (scale, to) = unsafe {
                    let to = std::slice::from_raw_parts_mut(c.row(i).add(start), there);
                    (f32::from_bits(a.add(i * stride + steps).read()), to)
                };
                for (((to, sum), start), column) in to.iter_mut().zip(sums).zip(starts).zip(scales)
                {
                    let value = sum.wrapping_add(*start) as f32 * column * scale;
                    *to = if add { *to + value } else { value };
                }
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bf16,avx2,fma")]
unsafe fn multiply_pairs(a: RowPointers<'_, u32>, values: &[u32], product: Product<'_>) {
    // SAFETY: passed on.
    unsafe { multiply_with::<micro::Bf16Pairs>(a, values, product, |_, _| ()) }
}

/// Products of integers, in one of the versions.
///
/// # Safety
/// As [`multiply_prepared`]; the version is there.
pub(super) unsafe fn multiply_quads(
    dots: Dots,
    a: RowPointers<'_, u32>,
    quads: &Quads,
    product: Product<'_>,
) {
    /// The product with the instructions of one version.
    macro_rules! version {
        ($name:ident, $dots:ty $(, $features:literal)?) => {
            $(#[target_feature(enable = $features)])?
            unsafe fn $name(a: RowPointers<'_, u32>, quads: &Quads, product: Product<'_>) {
                // SAFETY: passed on; steps and columns are those of the matrix.
                unsafe {
                    let scales = |step, column| quads.columns(step, column);
                    multiply_with::<$dots>(a, &quads.words, product, scales);
                }
            }
        };
    }
    version!(plain, int8::Plain);
    #[cfg(target_arch = "x86_64")]
    version!(avx2, int8::Avx2, "avx2,fma");
    #[cfg(target_arch = "x86_64")]
    version!(avx_vnni, int8::AvxVnni, "avx2,fma,avxvnni");
    #[cfg(target_arch = "x86_64")]
    version!(avx512_vnni, int8::Avx512Vnni, "avx512f,avx512vnni,avx2,fma");
    // SAFETY: passed on; the caller vouches for the instructions.
    unsafe {
        match dots {
            #[cfg(target_arch = "x86_64")]
            Dots::Avx512Vnni => avx512_vnni(a, quads, product),
            #[cfg(target_arch = "x86_64")]
            Dots::AvxVnni => avx_vnni(a, quads, product),
            #[cfg(target_arch = "x86_64")]
            Dots::Avx2 => avx2(a, quads, product),
            _ => plain(a, quads, product),
        }
    }
}

/// Asks for the beginning of a row of `len` values; the rest of a long one is guessed by the CPU.
#[inline(always)]
unsafe fn prefetch<T>(row: *const T, len: usize) {
    const LINE: usize = 64;
    const LINES: usize = 8;
    #[cfg(target_arch = "x86_64")]
    for line in 0..(len * size_of::<T>()).div_ceil(LINE).min(LINES) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch of any address is harmless, and this one is inside the row.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(row.cast::<i8>().add(line * LINE)) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (row, len, LINE, LINES);
}

/// Asks for the tile that begins `rows`, where rows are found by number: those come from anywhere, where no prefetcher
/// of the CPU expects them. They arrive while the tile before is computed. `k`: the first value, and how many.
#[inline(always)]
unsafe fn prefetch_tile<T>(
    a: &RowPointers<'_, T>,
    c: &RowPointers<'_>,
    rows: Range<usize>,
    k: (usize, usize),
    n: usize,
) {
    if a.ids.is_some() {
        for i in rows.take(TILE_ROWS) {
            // SAFETY: the caller's promise: rows of the operands.
            unsafe {
                prefetch(a.row(i).add(k.0), k.1);
                prefetch(c.row(i), n);
            }
        }
    }
}

/// `of_columns` gives what belongs to the columns from one on, for the steps from one on.
#[inline(always)]
unsafe fn multiply_with<P: TileProducts>(
    a: RowPointers<'_, P::Element>,
    values: &[P::Element],
    product: Product<'_>,
    of_columns: impl Fn(usize, usize) -> P::Columns,
) {
    let Product { rows, b, columns, c, accumulate } = product;
    let (k, n, padded_n) = (b.steps(), b.n(), columns.end);
    let k_step = K_BLOCK.min(k);
    let panels_cached = (CACHED_PANEL_BYTES / (k_step * PANEL * 4)).max(1) * PANEL;
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
                let mut of_rows = [P::Row::default(); TILE_ROWS];
                for i in 0..height {
                    // SAFETY: the caller's promise.
                    unsafe {
                        let from = a.row(row + i);
                        of_rows[i] = P::row(from, k);
                        a_rows[i] = from.add(k0).cast_const();
                        c_rows[i] = c.row(row + i);
                    }
                }
                // SAFETY: rows of the operands, as promised.
                unsafe { prefetch_tile(&a, &c, row + height..rows, (k0, k_len), n) };
                let mut start = group;
                while start < group_end {
                    let width = PANEL.min(padded_n - start);
                    // SAFETY: panels are contiguous; the columns written stay below `n`.
                    unsafe {
                        let panel = values.as_ptr().add(start * k + k0 * width);
                        let at: [*mut f32; TILE_ROWS] = std::array::from_fn(|i| {
                            if i < height { c_rows[i].add(start) } else { c_rows[i] }
                        });
                        let columns = width.min(n - start);
                        let extent = Extent { width, columns, k: k_len, accumulate: add };
                        let sides =
                            Sides::<P> { a: a_rows, rows: of_rows, columns: of_columns(k0, start) };
                        micro::panel(height, &sides, panel, &at, extent);
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

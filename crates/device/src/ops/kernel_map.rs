//! Which voxel feeds which in a submanifold convolution.

use super::{kernels, radix_sort, rows, scan};
use crate::launch::{Items::PerThread, Launcher, Scalar::U32};

kernels! { "kernel_map":
    /// Rows into hash tables.
    TABLE_INSERT = table_insert, 256, PerThread;
    /// Rows that are not the first of their cell.
    TABLE_REPEATS = table_repeats, 256, PerThread;
    /// Input rows of each output row.
    TABLE_NEIGHBORS = table_neighbors, 256, PerThread;
    /// Pairs without gaps.
    LIST_PAIRS = list_pairs, 256, PerThread;
    /// First pair of each tap.
    PAIR_STARTS = pair_starts, 256, PerThread;
    /// By what pairs are sorted to be exchanged.
    PAIR_KEYS = pair_keys, 256, PerThread;
}

/// The pairs of a convolution, on the device.
#[derive(Debug)]
pub struct KernelMap<B> {
    /// Taps along one axis.
    pub kernel_size: u32,
    /// Voxels, N.
    pub rows: u32,
    /// Pairs over all taps, P.
    pub pairs: u32,
    /// Whether two rows share a voxel.
    pub duplicates: bool,
    /// Input row of each output row and tap, `u32::MAX` where there is none. `[taps, N]` of `u32`
    pub neighbors: B,
    /// First pair of each tap, closed by their number. `[taps + 1]` of `u32`
    pub starts: B,
    /// Input rows, tap after tap. `[P]` of `u32`
    pub input: B,
    /// Output rows, ascending inside a tap. `[P]` of `u32`
    pub output: B,
}

impl<B> KernelMap<B> {
    /// Number of taps.
    pub fn taps(&self) -> u32 {
        self.kernel_size.pow(3)
    }
}

/// Slots of the table of a scene of this many rows: a power of two, at most half full.
fn table_slots(rows: u32) -> u64 {
    (u64::from(rows) * 2).next_power_of_two().max(2)
}

/// Finds all pairs. Tap `(kx·k + ky)·k + kz` of output voxel p is input voxel `p + (kx, ky, kz) − k/2` of the
/// same scene. Where two rows share a voxel the first stands for it, and every row is its own center.
///
/// # Shapes
/// `cells`: `[N, 3]` of `i32`, 0..2²¹ · `offsets`: `[scenes + 1]` on the host, from 0 to N
///
/// # Errors
/// Those of the launcher.
///
/// # Panics
/// If the kernel size is not 1, 3, 5 or 7, offsets fall, or there are 2³² pairs (the caller checked).
pub fn build<L: Launcher>(
    l: &L,
    cells: &L::Buffer,
    offsets: &[u32],
    kernel_size: u32,
) -> Result<KernelMap<L::Buffer>, L::Error> {
    assert!(matches!(kernel_size, 1 | 3 | 5 | 7), "kernel size {kernel_size}");
    assert!(offsets.first() == Some(&0) && offsets.is_sorted(), "offsets of scenes {offsets:?}");
    let n = offsets.last().copied().unwrap_or(0);
    let scenes = offsets.len() as u32 - 1;
    let taps = kernel_size.pow(3);
    l.expect::<[i32; 3]>("cells", cells, n.into());
    let places = u64::from(n) * u64::from(taps);
    assert!(places <= u64::from(u32::MAX), "{n} rows and {taps} taps are too many pairs");

    let cells = Cells::new(l, cells, offsets)?;
    let duplicates = cells.duplicates(l)?;
    let mut neighbors = l.alloc_values::<u32>(places as usize)?;
    let mut found = l.alloc_values::<u32>(places as usize)?;
    let Cells { cells, offsets, tables, table_cells, table_rows, .. } = &cells;
    l.run(
        &TABLE_NEIGHBORS,
        places,
        &[cells, offsets, tables, table_cells, table_rows],
        &mut [&mut neighbors, &mut found],
        &[U32(n), U32(scenes), U32(kernel_size)],
    )?;
    let sums = scan::running_sums(l, &found, places)?;
    let pairs = l.download_values::<u32>(&sums.total, 1)?[0];
    let mut input = l.alloc_values::<u32>(pairs as usize)?;
    let mut output = l.alloc_values::<u32>(pairs as usize)?;
    let (inputs, numbers) = ([&neighbors, &sums.before], [U32(n), U32(taps)]);
    l.run(&LIST_PAIRS, places, &inputs, &mut [&mut input, &mut output], &numbers)?;
    let mut starts = l.upload_values(&vec![0u32; taps as usize + 1])?;
    if n > 0 {
        let (items, inputs) = (u64::from(taps) + 1, [&sums.before, &sums.total]);
        l.run(&PAIR_STARTS, items, &inputs, &mut [&mut starts], &numbers)?;
    }
    Ok(KernelMap { kernel_size, rows: n, pairs, duplicates, neighbors, starts, input, output })
}

/// Cells of scenes, with a hash table of each scene.
struct Cells<'a, B> {
    cells: &'a B,
    offsets: B,
    /// First slot of each scene.
    tables: B,
    table_cells: B,
    table_rows: B,
    slot_of_row: B,
    rows: u32,
    scenes: u32,
}

impl<'a, B> Cells<'a, B> {
    fn new<L: Launcher<Buffer = B>>(
        l: &L,
        cells: &'a B,
        offsets: &[u32],
    ) -> Result<Self, L::Error> {
        let (rows, scenes) = (offsets[offsets.len() - 1], offsets.len() as u32 - 1);
        let mut tables = vec![0u64];
        for scene in offsets.windows(2) {
            tables.push(tables[tables.len() - 1] + table_slots(scene[1] - scene[0]));
        }
        let slots = tables[scenes as usize] as usize;
        let (offsets, tables) = (l.upload_values(offsets)?, l.upload_values(&tables)?);
        let mut table_cells = l.alloc_values::<u64>(slots)?;
        l.fill(&mut table_cells, 0xff)?;
        let mut table_rows = l.alloc_values::<u32>(slots)?;
        l.fill(&mut table_rows, 0xff)?;
        let mut slot_of_row = l.alloc_values::<u32>(rows as usize)?;
        l.run(
            &TABLE_INSERT,
            rows.into(),
            &[cells, &offsets, &tables],
            &mut [&mut table_cells, &mut table_rows, &mut slot_of_row],
            &[U32(rows), U32(scenes)],
        )?;
        Ok(Self { cells, offsets, tables, table_cells, table_rows, slot_of_row, rows, scenes })
    }

    /// Whether two rows share a voxel.
    fn duplicates<L: Launcher<Buffer = B>>(&self, l: &L) -> Result<bool, L::Error> {
        let (n, mut repeats) = (self.rows, l.alloc_values::<u32>(self.rows as usize)?);
        let inputs = [&self.offsets, &self.tables, &self.table_rows, &self.slot_of_row];
        let numbers = [U32(n), U32(self.scenes)];
        l.run(&TABLE_REPEATS, n.into(), &inputs, &mut [&mut repeats], &numbers)?;
        let repeats = scan::running_sums(l, &repeats, n.into())?.total;
        Ok(l.download_values::<u32>(&repeats, 1)?[0] > 0)
    }
}

/// Pairs with input and output exchanged, taps unchanged, for gradients where rows share voxels.
#[derive(Debug)]
pub struct Exchanged<B> {
    /// Tap and row of each pair's input, ascending: `tap · 2³² + row`. `[P]` of `u64`
    pub keys: B,
    /// Its output row. `[P]` of `u32`
    pub output: B,
}

/// Sorts the pairs of a map by tap and input row; those of one input row stay in the order of output rows.
///
/// # Errors
/// Those of the launcher.
pub fn exchanged<L: Launcher>(
    l: &L,
    map: &KernelMap<L::Buffer>,
) -> Result<Exchanged<L::Buffer>, L::Error> {
    let mut keys = l.alloc_values::<u64>(map.pairs as usize)?;
    l.run(
        &PAIR_KEYS,
        map.pairs.into(),
        &[&map.starts, &map.input],
        &mut [&mut keys],
        &[U32(map.pairs), U32(map.taps())],
    )?;
    // Taps are in order already; sorting by them last keeps them so.
    let sorted = radix_sort::sort(l, keys, map.pairs, u32::BITS)?;
    let sorted = radix_sort::sort_further(l, sorted, map.pairs, u32::BITS, 16)?;
    let mut output = l.alloc_values::<u32>(map.pairs as usize)?;
    rows::gather_rows(l, &map.output, rows::Width::Four, 1, &sorted.rows, map.pairs, &mut output)?;
    Ok(Exchanged { keys: sorted.codes, output })
}

//! Which voxel feeds which in a submanifold convolution.
//!
//! Built once per scale and shared by every convolution there. Voxels are looked up in blocks of
//! 4×4×4 cells: rows are walked in Morton order, so a block's 27 neighbours are found once and the
//! rest are direct array reads.
//!
//! Two rows may share a voxel of one scene (mixed scenes in training). The original leaves the
//! outcome to chance; here the first such row stands for the voxel, and every row keeps itself as
//! its own centre.

use crate::error::{KernelError, check_offsets};
use crate::serialization::{argsort, morton_code};
use rayon::prelude::*;

/// Output rows of one chunk of pairs.
pub(crate) const CHUNK: usize = 1024;
/// No row here.
const NONE: u32 = u32::MAX;
/// Added to every coordinate so that neighbours stay non-negative; a multiple of the block side.
const MARGIN: i32 = 4;

/// The input–output pairs of a convolution, grouped by chunk of output rows and by tap.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KernelMap {
    kernel_size: usize,
    rows: usize,
    duplicates: bool,
    /// Pairs of chunk `c`, tap `t`: `starts[c·taps + t]..starts[c·taps + t + 1]`.
    starts: Vec<usize>,
    input: Vec<u32>,
    output: Vec<u32>,
}

impl KernelMap {
    /// Finds all pairs.
    ///
    /// Tap `(kx·k + ky)·k + kz` of output voxel p is input voxel `p + (kx, ky, kz) − k/2` of the
    /// same scene; there is no pair where that voxel is empty.
    ///
    /// # Shapes
    /// `grid_coord`: `[N, 3]`, 0..2²¹ · `offsets`: `[B + 1]`
    ///
    /// # Errors
    /// If offsets or coordinates are out of range, or the kernel size is not 1, 3, 5 or 7.
    pub fn build(
        grid_coord: &[[i32; 3]],
        offsets: &[usize],
        kernel_size: usize,
    ) -> Result<Self, KernelError> {
        if !matches!(kernel_size, 1 | 3 | 5 | 7) {
            return Err(KernelError::KernelSize(kernel_size));
        }
        check_offsets(offsets, grid_coord.len())?;
        crate::serialization::depth_of(grid_coord)?;
        let rows = grid_coord.len();
        let taps = kernel_size.pow(3);
        let mut blocks = Blocks::default();
        let mut block_of = vec![0u32; rows];
        for scene in offsets.windows(2) {
            blocks.add_scene(grid_coord, scene[0]..scene[1], &mut block_of);
        }
        let steps = steps(kernel_size);
        let chunks: Vec<Chunk> = (0..rows.div_ceil(CHUNK))
            .into_par_iter()
            .map(|c| {
                let range = c * CHUNK..((c + 1) * CHUNK).min(rows);
                blocks.pairs(grid_coord, &block_of, range, &steps, taps)
            })
            .collect();
        let total = chunks.iter().map(|c| c.input.len()).sum();
        let mut map = Self {
            kernel_size,
            rows,
            duplicates: blocks.duplicates,
            starts: Vec::with_capacity(chunks.len() * taps + 1),
            input: Vec::with_capacity(total),
            output: Vec::with_capacity(total),
        };
        map.starts.push(0);
        for chunk in chunks {
            let base = map.input.len();
            map.starts.extend(chunk.ends.iter().map(|e| base + e));
            map.input.extend(chunk.input);
            map.output.extend(chunk.output);
        }
        Ok(map)
    }

    /// Taps along one axis.
    pub fn kernel_size(&self) -> usize {
        self.kernel_size
    }

    /// Number of taps, `k³`.
    pub fn taps(&self) -> usize {
        self.kernel_size.pow(3)
    }

    /// Number of voxels.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of pairs over all taps.
    pub fn num_pairs(&self) -> usize {
        self.input.len()
    }

    /// Whether two rows share a voxel.
    pub fn has_duplicates(&self) -> bool {
        self.duplicates
    }

    pub(crate) fn num_chunks(&self) -> usize {
        self.rows.div_ceil(CHUNK)
    }

    /// Input and output rows of one chunk and tap; output rows ascend.
    pub(crate) fn pairs(&self, chunk: usize, tap: usize) -> (&[u32], &[u32]) {
        let at = chunk * self.taps() + tap;
        let range = self.starts[at]..self.starts[at + 1];
        (&self.input[range.clone()], &self.output[range])
    }

    /// Input and output rows of one tap over all chunks.
    pub fn tap_pairs(&self, tap: usize) -> (Vec<u32>, Vec<u32>) {
        let mut all = (Vec::new(), Vec::new());
        for chunk in 0..self.num_chunks() {
            let (input, output) = self.pairs(chunk, tap);
            all.0.extend_from_slice(input);
            all.1.extend_from_slice(output);
        }
        all
    }

    /// The map with input and output exchanged, taps unchanged.
    pub(crate) fn transposed(&self) -> Self {
        let taps = self.taps();
        let mut counts = vec![0usize; self.num_chunks() * taps + 1];
        let slot = |tap: usize, row: u32| row as usize / CHUNK * taps + tap;
        for chunk in 0..self.num_chunks() {
            for tap in 0..taps {
                for &row in self.pairs(chunk, tap).0 {
                    counts[slot(tap, row) + 1] += 1;
                }
            }
        }
        for i in 1..counts.len() {
            counts[i] += counts[i - 1];
        }
        let starts = counts.clone();
        let mut input = vec![0; self.input.len()];
        let mut output = vec![0; self.input.len()];
        for chunk in 0..self.num_chunks() {
            for tap in 0..taps {
                let (from, to) = self.pairs(chunk, tap);
                for (&from, &to) in from.iter().zip(to) {
                    let at = &mut counts[slot(tap, from)];
                    input[*at] = to;
                    output[*at] = from;
                    *at += 1;
                }
            }
        }
        Self { starts, input, output, ..*self }
    }
}

struct Chunk {
    ends: Vec<usize>,
    input: Vec<u32>,
    output: Vec<u32>,
}

/// For each of the 64 cells of a block and each tap: which of the 27 blocks around, which cell.
fn steps(kernel_size: usize) -> Vec<(u8, u8)> {
    let half = kernel_size as i32 / 2;
    let mut out = Vec::with_capacity(64 * kernel_size.pow(3));
    for cell in 0..64 {
        let at = [cell >> 4, cell >> 2 & 3, cell & 3];
        for tap in 0..kernel_size.pow(3) as i32 {
            let k = kernel_size as i32;
            let d = [tap / (k * k) - half, tap / k % k - half, tap % k - half];
            let to: [i32; 3] = std::array::from_fn(|a| at[a] + d[a]);
            let block = to.iter().fold(0, |b, v| b * 3 + v.div_euclid(4) + 1);
            let inner = to.iter().fold(0, |c, v| c * 4 + v.rem_euclid(4));
            out.push((block as u8, inner as u8));
        }
    }
    out
}

/// Occupied blocks of 4×4×4 cells, scene after scene.
#[derive(Default)]
struct Blocks {
    /// Row in each cell, x-major inside the block.
    cells: Vec<[u32; 64]>,
    /// Scene of each block.
    scene: Vec<u32>,
    /// Block coordinates.
    at: Vec<[u32; 3]>,
    tables: Vec<Table>,
    duplicates: bool,
}

/// Open-addressing table from block code to block number.
struct Table {
    slots: Vec<(u64, u32)>,
}

impl Table {
    fn new(blocks: usize) -> Self {
        Self { slots: vec![(u64::MAX, NONE); (blocks * 2).next_power_of_two().max(2)] }
    }

    fn slot(&self, key: u64) -> usize {
        // Multiplicative hashing; the odd constant is 2⁶⁴ divided by the golden ratio.
        (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & (self.slots.len() - 1)
    }

    fn insert(&mut self, key: u64, value: u32) {
        let mut slot = self.slot(key);
        while self.slots[slot].1 != NONE {
            slot = (slot + 1) & (self.slots.len() - 1);
        }
        self.slots[slot] = (key, value);
    }

    fn get(&self, key: u64) -> u32 {
        let mut slot = self.slot(key);
        loop {
            let (k, v) = self.slots[slot];
            if v == NONE || k == key {
                return v;
            }
            slot = (slot + 1) & (self.slots.len() - 1);
        }
    }
}

fn shifted(c: [i32; 3]) -> [u32; 3] {
    c.map(|v| (v + MARGIN) as u32)
}

/// Code of a block; 22-bit coordinates (21 bits and the margin) shifted by two fit easily.
fn block_code(block: [u32; 3]) -> u64 {
    morton_code(block, 21)
}

fn inner_cell(c: [u32; 3]) -> usize {
    ((c[0] & 3) << 4 | (c[1] & 3) << 2 | (c[2] & 3)) as usize
}

impl Blocks {
    fn add_scene(
        &mut self,
        grid_coord: &[[i32; 3]],
        range: std::ops::Range<usize>,
        block_of: &mut [u32],
    ) {
        let scene = self.tables.len() as u32;
        let code = |row: usize| block_code(shifted(grid_coord[row]).map(|v| v >> 2));
        let codes: Vec<u64> = range.clone().into_par_iter().map(code).collect();
        let sorted = codes.is_sorted();
        let order: Vec<u32> =
            if sorted { (0..codes.len() as u32).collect() } else { argsort(&codes) };
        let first = self.cells.len();
        let mut last = u64::MAX;
        for &o in &order {
            let row = range.start + o as usize;
            if self.cells.len() == first || codes[o as usize] != last {
                last = codes[o as usize];
                self.cells.push([NONE; 64]);
                self.scene.push(scene);
                self.at.push(shifted(grid_coord[row]).map(|v| v >> 2));
            }
            let block = self.cells.len() - 1;
            block_of[row] = block as u32;
            let cell = &mut self.cells[block][inner_cell(shifted(grid_coord[row]))];
            if *cell == NONE {
                *cell = row as u32;
            } else {
                // The order is stable, so the row already there comes first.
                self.duplicates = true;
            }
        }
        let mut table = Table::new(self.cells.len() - first);
        for block in first..self.cells.len() {
            table.insert(block_code(self.at[block]), block as u32);
        }
        self.tables.push(table);
    }

    fn around(&self, block: u32) -> [u32; 27] {
        let block = block as usize;
        let at = self.at[block];
        let table = &self.tables[self.scene[block] as usize];
        let mut out = [NONE; 27];
        for (i, o) in out.iter_mut().enumerate() {
            let d = [i / 9, i / 3 % 3, i % 3];
            // The margin keeps every block coordinate at 1 or more.
            let to: [u32; 3] = std::array::from_fn(|a| at[a] + d[a] as u32 - 1);
            *o = if i == 13 { block as u32 } else { table.get(block_code(to)) };
        }
        out
    }

    fn pairs(
        &self,
        grid_coord: &[[i32; 3]],
        block_of: &[u32],
        range: std::ops::Range<usize>,
        steps: &[(u8, u8)],
        taps: usize,
    ) -> Chunk {
        let centre = taps / 2;
        let mut found = vec![NONE; range.len() * taps];
        let mut counts = vec![0usize; taps];
        let mut current = NONE;
        let mut around = [NONE; 27];
        for (row, found) in range.clone().zip(found.chunks_exact_mut(taps)) {
            if block_of[row] != current {
                current = block_of[row];
                around = self.around(current);
            }
            let cell = inner_cell(shifted(grid_coord[row]));
            let steps = &steps[cell * taps..(cell + 1) * taps];
            for (tap, &(block, inner)) in steps.iter().enumerate() {
                let block = around[block as usize];
                if block == NONE {
                    continue;
                }
                let neighbour = if tap == centre {
                    row as u32
                } else {
                    self.cells[block as usize][inner as usize]
                };
                if neighbour != NONE {
                    found[tap] = neighbour;
                    counts[tap] += 1;
                }
            }
        }
        let mut ends = Vec::with_capacity(taps);
        let mut sum = 0;
        for count in &counts {
            sum += count;
            ends.push(sum);
        }
        let mut at: Vec<usize> = ends.iter().zip(&counts).map(|(e, c)| e - c).collect();
        let mut input = vec![0; sum];
        let mut output = vec![0; sum];
        for (row, found) in range.zip(found.chunks_exact(taps)) {
            for (tap, &neighbour) in found.iter().enumerate() {
                if neighbour != NONE {
                    input[at[tap]] = neighbour;
                    output[at[tap]] = row as u32;
                    at[tap] += 1;
                }
            }
        }
        Chunk { ends, input, output }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use rand::{Rng, SeedableRng};

    fn all(map: &KernelMap) -> Vec<(usize, u32, u32)> {
        let mut out: Vec<_> = (0..map.taps())
            .flat_map(|t| {
                let (i, o) = map.tap_pairs(t);
                i.into_iter().zip(o).map(move |(i, o)| (t, i, o)).collect::<Vec<_>>()
            })
            .collect();
        out.sort_unstable();
        out
    }

    #[test]
    fn finds_the_same_pairs_as_comparing_all() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut cells = std::collections::BTreeSet::new();
        while cells.len() < 1300 {
            cells.insert(std::array::from_fn::<i32, 3, _>(|_| rng.random_range(0..14)));
        }
        let top = (1 << 21) - 1;
        let mut grid: Vec<[i32; 3]> = cells.into_iter().collect();
        grid.extend([[top; 3], [top, top - 1, top], [0, 0, top], [0, 1, 0], [top - 2, top, top]]);
        // Unsorted rows and two scenes that overlap in space.
        for i in (1..grid.len()).rev() {
            grid.swap(i, rng.random_range(0..=i));
        }
        let offsets = [0, 500, 500, grid.len()];
        for k in [1, 3, 5, 7] {
            let map = KernelMap::build(&grid, &offsets, k).unwrap();
            assert!(!map.has_duplicates());
            assert_eq!(all(&map), reference::kernel_pairs(&grid, &offsets, k as i32));
            let back = map.transposed().transposed();
            assert_eq!(all(&back), all(&map));
        }
    }

    #[test]
    fn no_voxel_one_voxel_and_duplicates() {
        let empty = KernelMap::build(&[], &[0], 3).unwrap();
        assert_eq!(empty.num_pairs(), 0);
        let one = KernelMap::build(&[[5, 5, 5]], &[0, 1], 5).unwrap();
        assert_eq!(all(&one), [(62, 0, 0)]);
        let twice = KernelMap::build(&[[1, 1, 1], [1, 1, 1], [1, 1, 2]], &[0, 3], 3).unwrap();
        assert!(twice.has_duplicates());
        assert_eq!(
            all(&twice),
            [(12, 0, 2), (13, 0, 0), (13, 1, 1), (13, 2, 2), (14, 2, 0), (14, 2, 1)],
            "the first row stands for the voxel, each row is its own centre"
        );
    }

    #[test]
    fn refuses_bad_input() {
        let grid = [[0, 0, 0]];
        assert_eq!(KernelMap::build(&grid, &[0, 1], 4), Err(KernelError::KernelSize(4)));
        assert!(KernelMap::build(&grid, &[0, 2], 3).is_err());
        assert!(KernelMap::build(&grid, &[], 3).is_err());
        assert!(KernelMap::build(&[[-1, 0, 0]], &[0, 1], 3).is_err());
    }
}

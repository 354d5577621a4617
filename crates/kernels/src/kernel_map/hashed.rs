//! The same map by a hash table of blocks, for the tests: another way to find neighbours.

use super::{CHUNK, KernelMap};
use crate::serialization::{argsort, morton_code};
use rayon::prelude::*;

/// No row here.
const NONE: u32 = u32::MAX;
/// Added to every coordinate so that neighbours stay non-negative; a multiple of the block side.
const MARGIN: i32 = 4;

/// As [`KernelMap::build`]; the arguments have been checked.
pub(super) fn build(grid_coord: &[[i32; 3]], offsets: &[usize], kernel_size: usize) -> KernelMap {
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
    let mut map = KernelMap {
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
    map
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

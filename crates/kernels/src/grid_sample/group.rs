//! Rows into voxels.

use super::bounds::cell_bounds;
use super::hash_order::voxels_by_hash;
use super::keys::{morton_cell, morton_key};
use super::parts::{pieces, running_sum};
use super::{CHUNK, GridSampleError, KeyOrder, VoxelGroups, check_row_count, is_grid_size};
use crate::serialization::{Sorted, shared};
use crate::simd::{Vector, dispatch};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Groups rows by voxel.
///
/// The cell of a coordinate is `floor(coord / grid_size)`, divided in f64, minus the smallest cell
/// of its axis. Rows of one cell form one voxel. No rows give no voxels.
///
/// # Shapes
/// - `coord`: `[N, 3]` meters, finite
///
/// # Errors
/// If [`is_grid_size`] is not true of `grid_size`, a coordinate is not finite, an axis spans more than
/// [`MAX_CELL`](super::MAX_CELL) + 1 cells, or the rows outnumber `u32`. Row and axis are named.
///
/// # Source
/// `GridSample` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1, with the division of
/// NumPy 2. Differs: the sort is stable, so rows inside a voxel are ascending; groups are formed by
/// cell, not by key, so two cells whose hashes collide stay two voxels (listed by `x, y, z`).
pub fn voxel_groups(
    coord: &[[f32; 3]],
    grid_size: f64,
    key_order: KeyOrder,
) -> Result<VoxelGroups, GridSampleError> {
    check_row_count(coord.len())?;
    if !is_grid_size(grid_size) {
        return Err(GridSampleError::GridSize { grid_size });
    }
    let (min_cell, max_index) = cell_bounds(coord, grid_size)?;
    let grid = Grid { grid_size, min_cell, max_index, morton: key_order == KeyOrder::Morton };
    let codes = grid.codes(coord);
    let sorted = Sorted::of(&codes);
    let spans = Spans::of(&sorted, &codes, &grid);
    let mut order = vec![0; coord.len()];
    let mut inverse = vec![0; coord.len()];
    if key_order == KeyOrder::Fnv {
        let (offsets, grid_coord) = spans.by_hash(&sorted, &grid, &mut order, shared(&mut inverse));
        return Ok(VoxelGroups { order, offsets, inverse, grid_coord, min_cell, grid_size });
    }
    spans.list_rows(&sorted, &mut order, shared(&mut inverse));
    let Spans { offsets, cells, .. } = spans;
    Ok(VoxelGroups { order, offsets, inverse, grid_coord: cells, min_cell, grid_size })
}

/// How coordinates become cells, and cells codes.
#[derive(Clone, Copy)]
struct Grid {
    grid_size: f64,
    min_cell: [f64; 3],
    max_index: [u32; 3],
    /// Codes follow a z-order curve; else they ascend by x, y, z.
    morton: bool,
}

impl Grid {
    /// One code per row, one-to-one with the cell and as narrow as the extent allows: the narrower,
    /// the faster sorted. A hash would take all 64 bits, so voxels are hashed after they are found.
    fn codes(&self, coord: &[[f32; 3]]) -> Vec<u64> {
        let grid = self;
        let mut codes = vec![0; coord.len()];
        codes.par_chunks_mut(CHUNK).zip(coord.par_chunks(CHUNK)).for_each(|(out, rows)| {
            dispatch!((grid: &Grid, rows: &[[f32; 3]], out: &mut [u64]),
                V => code_rows::<V>(grid, rows, out));
        });
        codes
    }

    /// Bits of `y` and `z` in a code that is not along a curve.
    #[inline(always)]
    fn bits(&self) -> [u32; 2] {
        [1, 2].map(|axis| u32::BITS - self.max_index[axis].leading_zeros())
    }

    #[inline(always)]
    fn cell_of(&self, code: u64) -> [u32; 3] {
        if self.morton {
            return morton_cell(code);
        }
        let [y, z] = self.bits();
        let low = |bits: u32| (1u64 << bits) - 1;
        [code >> (y + z), code >> z & low(y), code & low(z)].map(|c| c as u32)
    }
}

/// Plain code that the compiler fits to the registers of each instruction set; divisions in f64 are
/// most of it.
#[inline(always)]
unsafe fn code_rows<V: Vector>(grid: &Grid, rows: &[[f32; 3]], out: &mut [u64]) {
    let Grid { grid_size, min_cell, morton, .. } = *grid;
    let [y_bits, z_bits] = grid.bits();
    let cell = |row: &[f32; 3], axis: usize| {
        // Between 0 and the largest index, which the bounds have been checked for.
        ((f64::from(row[axis]) / grid_size).floor() - min_cell[axis]) as i32 as u32
    };
    if morton {
        for (o, row) in out.iter_mut().zip(rows) {
            *o = morton_key([cell(row, 0), cell(row, 1), cell(row, 2)]);
        }
    } else {
        for (o, row) in out.iter_mut().zip(rows) {
            let [x, y, z] = [cell(row, 0), cell(row, 1), cell(row, 2)].map(u64::from);
            *o = (x << y_bits | y) << z_bits | z;
        }
    }
}

/// Voxels in the order of their codes.
struct Spans {
    /// Voxel `v` owns the sorted entries `offsets[v]..offsets[v + 1]`.
    offsets: Vec<u32>,
    cells: Vec<[i32; 3]>,
    /// Voxels that start before each stretch of [`CHUNK`] entries.
    before: Vec<usize>,
}

impl Spans {
    fn of(sorted: &Sorted, codes: &[u64], grid: &Grid) -> Self {
        let entries = &sorted.entries;
        let stretches = entries.len().div_ceil(CHUNK);
        // A stretch together with the entry before it.
        let starts = |stretch: usize| {
            let first = stretch * CHUNK;
            let last = (first + CHUNK).min(entries.len());
            let starts = |&i: &usize| i == 0 || sorted.differ(codes, entries[i - 1], entries[i]);
            (first..last).filter(starts)
        };
        let counts: Vec<usize> =
            (0..stretches).into_par_iter().map(|stretch| starts(stretch).count()).collect();
        let before = running_sum(&counts);
        let voxels = before[stretches];
        let mut offsets = vec![0; voxels + 1];
        let mut cells = vec![[0; 3]; voxels];
        offsets[voxels] = entries.len() as u32;
        pieces(&mut offsets[..voxels], &before)
            .into_par_iter()
            .zip(pieces(&mut cells, &before))
            .enumerate()
            .for_each(|(stretch, (offsets, cells))| {
                for ((offset, cell), i) in offsets.iter_mut().zip(cells).zip(starts(stretch)) {
                    *offset = i as u32;
                    *cell = grid.cell_of(sorted.code(codes, entries[i])).map(|c| c as i32);
                }
            });
        Self { offsets, cells, before }
    }

    /// Rows voxel by voxel, and the voxel of each row.
    fn list_rows(&self, sorted: &Sorted, order: &mut [u32], inverse: &[AtomicU32]) {
        let mask = sorted.row_mask;
        let entries = sorted.entries.par_chunks(CHUNK);
        order.par_chunks_mut(CHUNK).zip(entries).enumerate().for_each(
            |(stretch, (order, entries))| {
                let mut next = self.before[stretch];
                for (i, (o, entry)) in order.iter_mut().zip(entries).enumerate() {
                    next += usize::from(self.offsets[next] as usize == stretch * CHUNK + i);
                    let row = (entry & mask) as u32;
                    *o = row;
                    inverse[row as usize].store(next as u32 - 1, Ordering::Relaxed);
                }
            },
        );
    }

    /// As [`Spans::list_rows`], with the voxels rearranged by their hash; returns their offsets and
    /// cells. Cells of one hash stay in the order of `x, y, z`.
    fn by_hash(
        &self,
        sorted: &Sorted,
        grid: &Grid,
        order: &mut [u32],
        inverse: &[AtomicU32],
    ) -> (Vec<u32>, Vec<[i32; 3]>) {
        let voxels = voxels_by_hash(&self.cells, grid.bits()[1]);
        let span = |voxel: u32| {
            self.offsets[voxel as usize] as usize..self.offsets[voxel as usize + 1] as usize
        };
        let counts: Vec<usize> = voxels
            .par_chunks(CHUNK)
            .map(|voxels| voxels.iter().map(|&v| span(v).len()).sum())
            .collect();
        let before = running_sum(&counts);
        let mut offsets = vec![0; voxels.len() + 1];
        let mut cells = vec![[0; 3]; voxels.len()];
        let mask = sorted.row_mask;
        pieces(order, &before)
            .into_par_iter()
            .zip(voxels.par_chunks(CHUNK))
            .zip(offsets[1..].par_chunks_mut(CHUNK))
            .zip(cells.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(part, (((order, voxels), offsets), cells))| {
                let mut at = 0;
                for (i, &voxel) in voxels.iter().enumerate() {
                    for row in &sorted.entries[span(voxel)] {
                        let row = (row & mask) as u32;
                        order[at] = row;
                        inverse[row as usize].store((part * CHUNK + i) as u32, Ordering::Relaxed);
                        at += 1;
                    }
                    offsets[i] = (before[part] + at) as u32;
                    cells[i] = self.cells[voxel as usize];
                }
            });
        (offsets, cells)
    }
}

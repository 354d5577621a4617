//! Which voxel feeds which in a submanifold convolution.

use super::scenes::Scenes;
use super::{groups_of_256, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

const SLOTS: &str = concat!(
    include_str!("../../wgsl/cell_slots.wgsl"),
    include_str!("../../wgsl/cell_hash.wgsl"),
    include_str!("../../wgsl/scene_of.wgsl")
);
const TEXT: &str = concat!(
    include_str!("../../wgsl/kernel_map.wgsl"),
    include_str!("../../wgsl/cell_hash.wgsl"),
    include_str!("../../wgsl/scene_of.wgsl")
);

/// Cells of scenes, to be found by their coordinates.
#[derive(Debug, Clone)]
pub struct CellTable {
    cells: Array<[i32; 3]>,
    scenes: Scenes,
    /// A hash table; which row is found does not depend on which slot it got.
    slots: Array<u32>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    scenes: u32,
    last: u32,
    first: u32,
}

impl CellTable {
    /// Cells to find. Where two rows of a scene share a cell, the first stands for it. `cells`: `[N, 3]`
    ///
    /// # Errors
    /// If the scenes have another number of rows, or the device has no room.
    pub fn new(commands: &mut Commands, cells: &Array<[i32; 3]>, scenes: &Scenes) -> Result<Self> {
        let rows = cells.len();
        if scenes.rows() != rows {
            return shape(format!("kernel map: {rows} cells, scenes of {} rows", scenes.rows()));
        }
        // At most half of the slots are taken.
        let slots = commands.array("slots of cells", (2 * rows).next_power_of_two())?;
        commands.clear(&slots);
        let table = Self { cells: cells.clone(), scenes: scenes.clone(), slots };
        let kernel = commands.gpu().kernel("cell_slots", SLOTS, &[], &[]);
        let params = table.params(0..rows)?;
        let arrays: [(u32, &dyn Bound); 3] =
            [(1, scenes.on_device()), (2, cells), (3, &table.slots)];
        commands.run(&kernel, &params, &arrays, groups_of_256(rows))?;
        Ok(table)
    }

    fn params(&self, range: Range<usize>) -> Result<Params> {
        Ok(Params {
            rows: number(range.len())?,
            scenes: number(self.scenes.len())?,
            last: number(self.slots.len() - 1)?,
            first: number(range.start)?,
        })
    }

    /// Source row of each tap and row of the range, or [`NONE`](super::product::NONE), as
    /// [`product`](super::product::product) takes it.
    ///
    /// Tap `(kx·k + ky)·k + kz` of the row with cell p is the row with cell `p + (kx, ky, kz) − k/2` of the same scene. Every
    /// row is its own center. `→ [k³, range]`
    ///
    /// # Errors
    /// If the kernel size is not 1, 3, 5 or 7, the range is not one of rows, there are 2³² entries, or the device has
    /// no room.
    pub fn sources(
        &self,
        commands: &mut Commands,
        kernel_size: usize,
        range: Range<usize>,
    ) -> Result<Array<u32>> {
        if !matches!(kernel_size, 1 | 3 | 5 | 7) {
            return shape(format!("kernel size {kernel_size}: must be 1, 3, 5 or 7"));
        }
        if range.start > range.end || range.end > self.cells.len() {
            return shape(format!("kernel map: rows {range:?} of {}", self.cells.len()));
        }
        let len = kernel_size.pow(3).saturating_mul(range.len());
        number(len)?;
        let sources = commands.array("a kernel map", len)?;
        let constants = [("SIZE", number(kernel_size)?)];
        let kernel = commands.gpu().kernel("kernel_map", TEXT, &[], &constants);
        let params = self.params(range)?;
        let arrays: [(u32, &dyn Bound); 4] =
            [(1, self.scenes.on_device()), (2, &self.cells), (3, &self.slots), (4, &sources)];
        commands.run(&kernel, &params, &arrays, groups_of_256(len))?;
        Ok(sources)
    }
}

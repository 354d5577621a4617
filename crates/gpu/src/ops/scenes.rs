//! Which rows belong to which scene.

use super::{groups_of_256, number};
use crate::error::{Result, shape};
use crate::gpu::{Array, Bound, Commands, Gpu};
use bytemuck::{Pod, Zeroable};
use scenesplat_kernels::check_offsets;

const TEXT: &str =
    concat!(include_str!("../../wgsl/scenes.wgsl"), include_str!("../../wgsl/scene_of.wgsl"));
/// Rows of a workgroup that looks for the largest coordinate.
const BLOCK: usize = 2048;

/// Rows of scenes: scene `i` has the rows `offsets[i]..offsets[i + 1]`. On the host and on the device.
#[derive(Debug, Clone)]
pub struct Scenes {
    offsets: Vec<usize>,
    device: Array<u32>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    rows: u32,
    scenes: u32,
    pad: [u32; 2],
}

impl Scenes {
    /// Scenes of so many rows. `offsets`: `[B + 1]`
    ///
    /// # Errors
    /// If the offsets do not start at 0, fall, or do not end at `rows`; if there are rows but no scene.
    pub fn upload(gpu: &Gpu, offsets: Vec<usize>, rows: usize) -> Result<Self> {
        if let Err(error) = check_offsets(&offsets, rows) {
            return shape(error.to_string());
        }
        // Below 2³², as was checked.
        let words: Vec<u32> = offsets.iter().map(|offset| *offset as u32).collect();
        let device = gpu.upload("offsets", &words)?;
        Ok(Self { offsets, device })
    }

    /// First row of each scene, closed by the number of rows. `[B + 1]`
    pub fn offsets(&self) -> &[usize] {
        &self.offsets
    }

    /// The same on the device. `[B + 1]`
    pub fn on_device(&self) -> &Array<u32> {
        &self.device
    }

    /// Number of scenes.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets[self.offsets.len() - 1]
    }

    /// Number of scenes that have rows.
    pub(crate) fn occupied(&self) -> usize {
        self.offsets.windows(2).filter(|scene| scene[0] < scene[1]).count()
    }

    /// Scene of each row of a list. `[N] → [N]`
    ///
    /// # Errors
    /// If the device has no room.
    pub fn of_rows(&self, commands: &mut Commands, list: &Array<u32>) -> Result<Array<u32>> {
        let out = commands.array("scenes", list.len())?;
        let kernel = commands.gpu().kernel("scenes", TEXT, &[], &[]);
        let params = self.params(list.len())?;
        let arrays: [(u32, &dyn Bound); 3] = [(1, &self.device), (2, list), (3, &out)];
        commands.run(&kernel, &params, &arrays, groups_of_256(list.len()))?;
        Ok(out)
    }

    /// The largest coordinate of each scene, 0 where it has no rows; 2³¹ or more if one is negative. Runs all commands
    /// so far. `cells`: `[N, 3]` → `[B]`
    pub(crate) fn largest(
        &self,
        commands: &mut Commands,
        cells: &Array<[i32; 3]>,
    ) -> Result<Vec<u32>> {
        let largest = commands.array("largest coordinates", self.len())?;
        commands.clear(&largest);
        let kernel = commands.gpu().kernel("scenes", TEXT, &["LARGEST"], &[]);
        let params = self.params(cells.len())?;
        let arrays: [(u32, &dyn Bound); 3] = [(1, &self.device), (2, cells), (3, &largest)];
        commands.run(&kernel, &params, &arrays, cells.len().div_ceil(BLOCK) as u64)?;
        commands.read(&largest)
    }

    fn params(&self, rows: usize) -> Result<Params> {
        Ok(Params { rows: number(rows)?, scenes: number(self.len())?, pad: [0; 2] })
    }
}

//! One scale of a batch: its voxels, and what its layers derive from them once.

use scenesplat_kernels::KernelError;
use scenesplat_kernels::point_rope::Rotations;
use scenesplat_kernels::segment::Groups;
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use std::sync::{Arc, Mutex, PoisonError};

/// Voxels in Morton order scene by scene, curve orders where there is attention, and the angles of
/// the voxels.
#[derive(Debug)]
pub struct Scale {
    cloud: SerializedCloud,
    /// By head width and base; blocks of a scale share one.
    #[expect(clippy::type_complexity, reason = "a list that nothing else sees")]
    rotations: Mutex<Vec<((usize, u64), Arc<Rotations>)>>,
}

impl Scale {
    /// A scale with these curves; none where no block attends.
    ///
    /// # Shapes
    /// `grid_coord`: `[N, 3]`, each scene's in Morton order · `offsets`: `[B + 1]`
    ///
    /// # Errors
    /// If offsets or coordinates are out of range.
    pub fn new(
        grid_coord: Vec<[i32; 3]>,
        offsets: Vec<usize>,
        curves: &[Curve],
    ) -> Result<Self, KernelError> {
        let cloud = SerializedCloud::new(grid_coord, offsets, curves, CurveDepth::PerSceneExtent)?;
        Ok(Self { cloud, rotations: Mutex::default() })
    }

    /// Voxels, orders, kernel maps and patches.
    pub fn cloud(&self) -> &SerializedCloud {
        &self.cloud
    }

    /// To permute the orders before the scale is used.
    pub(super) fn cloud_mut(&mut self) -> &mut SerializedCloud {
        &mut self.cloud
    }

    /// Angles of heads of this width, computed at first use.
    pub fn rotations(&self, dim: usize, base: f64) -> Arc<Rotations> {
        let key = (dim, base.to_bits());
        let mut all = self.rotations.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = all.iter().find(|(k, _)| *k == key) {
            return found.clone();
        }
        let made = Arc::new(Rotations::new(self.cloud.grid_coord(), dim, base));
        all.push((key, made.clone()));
        made
    }

    /// Voxels and offsets of the next coarser scale, and which row falls into which of its voxels:
    /// those whose coordinates agree without their last `shift` bits. In Morton order they follow
    /// each other.
    ///
    /// # Errors
    /// Never for rows in Morton order.
    pub(super) fn coarser(&self, shift: u32) -> Result<Coarser, KernelError> {
        let cells = self.cloud.grid_coord();
        let (mut starts, mut grid_coord, mut offsets) = (Vec::new(), Vec::new(), vec![0]);
        for scene in self.cloud.offsets().windows(2) {
            let mut last = None;
            for row in scene[0]..scene[1] {
                let cell = cells[row].map(|v| v >> shift);
                if last != Some(cell) {
                    last = Some(cell);
                    starts.push(row as u32);
                    grid_coord.push(cell);
                }
            }
            offsets.push(grid_coord.len());
        }
        starts.push(cells.len() as u32);
        let groups = Arc::new(Groups::new((0..cells.len() as u32).collect(), starts)?);
        Ok(Coarser { grid_coord, offsets, groups })
    }
}

/// What [`Scale::coarser`] finds.
pub(super) struct Coarser {
    pub grid_coord: Vec<[i32; 3]>,
    pub offsets: Vec<usize>,
    pub groups: Arc<Groups>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voxels_of_a_cell_become_one_and_scenes_stay_apart() {
        let cells = vec![[0, 0, 0], [1, 1, 1], [0, 0, 2], [5, 5, 5], [5, 5, 5], [1, 0, 0]];
        let scale = Scale::new(cells, vec![0, 5, 5, 6], &[]).unwrap();
        let Coarser { grid_coord, offsets, groups } = scale.coarser(1).unwrap();
        assert_eq!(grid_coord, [[0, 0, 0], [0, 0, 1], [2, 2, 2], [0, 0, 0]]);
        assert_eq!(offsets, [0, 3, 3, 4]);
        assert_eq!(groups.inverse(), [0, 0, 1, 2, 2, 3]);
        // Blocks ask for the same angles again and again.
        let (first, again) = (scale.rotations(18, 100.0), scale.rotations(18, 100.0));
        assert!(Arc::ptr_eq(&first, &again));
        assert!(!Arc::ptr_eq(&first, &scale.rotations(18, 10.0)));
        assert_eq!(scale.rotations(6, 100.0).dim(), 6);
    }
}

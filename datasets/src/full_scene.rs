//! The whole scene behind a sample of voxels.

use crate::TeacherRows;
use scenesplat_scene::LabelledPoints;

/// All Gaussians of a scene, of which a sample holds one a voxel: what an evaluation scores, because
/// a network's answer for a voxel is its answer for every Gaussian in it.
///
/// Positions are those before the sampling; points and Gaussians share a frame, which need not be
/// that of the sample.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FullScene {
    /// Centers, meters. `[N, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Row of the sample that each Gaussian is in a voxel with. `[N]`
    pub voxel: Vec<u32>,
    /// Class index, -1 = ignored. `[N]`
    pub segment: Option<Vec<i32>>,
    /// Whether the Gaussian has a language feature, so that it may vote. `[N]`
    pub valid_feat: Option<Vec<bool>>,
    /// Labeled points to score instead of the Gaussians, all of them; independent row count.
    pub points: Option<LabelledPoints>,
    /// What a teacher says of each Gaussian, if there is one. `[N]`
    pub teacher: Option<TeacherRows>,
    /// As [`Sample::origin_row`](crate::Sample::origin_row), until the teacher has answered. `[N]`
    pub origin_row: Option<Vec<u32>>,
}

impl FullScene {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.coord.len()
    }

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.coord.is_empty()
    }

    /// What each Gaussian receives of what its voxel has.
    ///
    /// # Panics
    /// If `of_voxels` is shorter than the sample (a bug of the caller).
    pub fn spread<T: Copy>(&self, of_voxels: &[T]) -> Vec<T> {
        self.voxel.iter().map(|&voxel| of_voxels[voxel as usize]).collect()
    }

    /// Positions and classes of the labeled points, if they have classes: what is scored then.
    pub fn scored_points(&self) -> Option<(&[[f32; 3]], &[i32])> {
        let points = self.points.as_ref()?;
        Some((&points.coord, points.segment.as_deref()?))
    }
}

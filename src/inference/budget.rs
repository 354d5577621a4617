//! What a pass over a scene needs of memory: the one sum, for the encoder's tiles and for estimates.

use crate::inspect::PROCESS_BYTES;
use scenesplat_scene::GaussianScene;

/// What takes memory, by part.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MemoryNeed {
    /// Gaussians.
    pub(crate) rows: usize,
    /// Arrays of the scene and of its copy, bytes.
    pub(crate) scene: u64,
    /// Voxels of a pass.
    pub(crate) voxels: usize,
    /// Width of the network's input.
    pub(crate) channels: usize,
    /// Rows of features.
    pub(crate) slots: usize,
    /// Width of the features.
    pub(crate) width: usize,
    /// Packed weights, bytes.
    pub(crate) weights: u64,
    /// What the network needs for each voxel that it computes at once, bytes.
    pub(crate) per_voxel: u64,
}

impl MemoryNeed {
    /// What is needed before the first voxel is computed: scene, tables of the plan, weights, process.
    pub(crate) fn fixed(&self) -> u64 {
        self.scene
            + (self.voxels * (12 + 4 * self.channels + 8) + self.rows * 8) as u64
            + self.weights
            + PROCESS_BYTES
    }

    /// All features, in memory.
    pub(crate) fn features(&self) -> u64 {
        (self.slots * self.width * size_of::<f32>()) as u64
    }

    /// All of it, without tiles.
    pub(crate) fn whole(&self) -> u64 {
        self.fixed() + self.features() + self.voxels as u64 * self.per_voxel
    }
}

/// Bytes of the arrays of a scene.
pub(crate) fn scene_bytes(scene: &GaussianScene) -> u64 {
    let labels = usize::from(scene.segment.is_some())
        + usize::from(scene.instance.is_some())
        + usize::from(scene.segment_score.is_some());
    let normal = usize::from(scene.normal.is_some()) * 12;
    let codes = scene.lang_code.as_ref().map_or(0, |c| c.values.len() * 2);
    let language = scene.lang_feat.as_ref().map_or(0, |f| f.values.len() * 2) + codes;
    let rest = scene.sh_rest.len() * 4;
    (scene.len() * (14 * 4 + labels * 4 + normal) + rest + language) as u64
}

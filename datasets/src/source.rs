//! Where scenes come from.

use crate::DataError;
use scenesplat_scene::{GaussianScene, RepairReport};

/// A scene as a source gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceScene {
    /// The usable Gaussians.
    pub scene: GaussianScene,
    /// What was repaired or left out on reading.
    pub report: RepairReport,
}

/// A set of scenes: which there are, and how one is read.
///
/// What happens to a scene afterwards (voxels, augmentation, batches) never depends on the source.
pub trait DataSource: Send + Sync {
    /// Names of the scenes, in a fixed order.
    fn scene_ids(&self) -> &[String];

    /// Reads one scene.
    ///
    /// # Errors
    /// If the source has no such scene or it cannot be read; the error names it.
    fn load(&self, id: &str) -> Result<SourceScene, DataError>;
}

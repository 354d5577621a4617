//! Small experiments as `scenesplat train` reads them.

use std::fmt::{self, Display, Formatter};

/// The `[model]` table of a network of two stages that trains in milliseconds.
///
/// Its `Display` is the table's lines, for `format!("[model]\n{}", Network::default())`.
#[derive(Clone, Debug)]
pub struct Network {
    /// Edge of a voxel in meters.
    pub grid_size: f64,
    /// Voxels in a patch of attention.
    pub patch: usize,
    /// Channels of the decoder's rows.
    pub width: usize,
    /// Last lines, such as `num_classes = 41` or `projection = 64`.
    pub head: &'static str,
}

impl Default for Network {
    fn default() -> Self {
        Self { grid_size: 0.3, patch: 64, width: 16, head: "num_classes = 41" }
    }
}

impl Display for Network {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { grid_size, patch, width, head } = self;
        let heads = width / 8;
        write!(
            f,
            "grid_size = {grid_size}\nstride = [2]\n\
             enc_depths = [1, 1]\nenc_channels = [8, 16]\nenc_num_head = [1, 2]\n\
             enc_patch_size = [{patch}, {patch}]\n\
             dec_depths = [1]\ndec_channels = [{width}]\ndec_num_head = [{heads}]\n\
             dec_patch_size = [{patch}]\n{head}\n"
        )
    }
}

/// A training on two synthetic rooms for two epochs.
pub const SMALL_SEGMENTATION: &str = r#"
task = "semantic_segmentation"
[model]
grid_size = 0.3
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [64, 64]
dec_depths = [1]
dec_channels = [16]
dec_num_head = [2]
dec_patch_size = [64]
num_classes = 41
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 400 } }
transforms = "semantic_segmentation"
[loader]
workers = 1
batch_size = 1
[[losses]]
type = "cross_entropy"
[[losses]]
type = "lovasz_softmax"
[trainer]
epochs = 2
"#;

//! A batch of voxelized scenes.

use candle_core::{Result, Tensor, bail};
use std::sync::Arc;

/// A batch of voxelized scenes with their input features.
///
/// The voxels stay on the host: tables are built from them there.
#[derive(Debug, Clone)]
pub struct PointCloud {
    /// Voxel of each row, 0..2²¹, one row per voxel. `[N, 3]`
    pub grid_coord: Arc<[[i32; 3]]>,
    /// Input features, on the CPU or where the network is, which brings them there. `[N, C]` f32
    pub feat: Tensor,
    /// Rows of scene `i` are `offsets[i]..offsets[i + 1]`. `[B + 1]`
    pub offsets: Arc<[usize]>,
}

impl PointCloud {
    /// Joins voxels and features, checking that the row counts agree.
    ///
    /// # Errors
    /// If features are not `[N, C]` f32 or the offsets do not end at N.
    pub fn new(
        grid_coord: impl Into<Arc<[[i32; 3]]>>,
        feat: Tensor,
        offsets: impl Into<Arc<[usize]>>,
    ) -> Result<Self> {
        let (grid_coord, offsets) = (grid_coord.into(), offsets.into());
        let (rows, _) = feat.dims2()?;
        if rows != grid_coord.len() || offsets.last() != Some(&rows) {
            bail!(
                "feat: expected [{}, C] with offsets ending there, got {:?} and offsets {:?}",
                grid_coord.len(),
                feat.shape(),
                offsets
            );
        }
        if feat.dtype() != candle_core::DType::F32 {
            bail!("feat: expected f32, got {:?}; cast with to_dtype first", feat.dtype());
        }
        Ok(Self { grid_coord, feat, offsets })
    }

    /// One scene.
    ///
    /// # Errors
    /// As [`PointCloud::new`].
    pub fn single(grid_coord: impl Into<Arc<[[i32; 3]]>>, feat: Tensor) -> Result<Self> {
        let grid_coord = grid_coord.into();
        let offsets = vec![0, grid_coord.len()];
        Self::new(grid_coord, feat, offsets)
    }

    /// Checks the width of the features, and that there are rows.
    pub(crate) fn check_width(&self, channels: usize) -> Result<()> {
        let (n, width) = self.feat.dims2()?;
        if width != channels {
            bail!("feat: expected [N, {channels}], got [{n}, {width}]");
        }
        if n == 0 {
            bail!("feat: a batch without any voxel has no features");
        }
        Ok(())
    }
}

//! From input features to the first channels.

use crate::layers::{BatchNorm, SparseConv};
use crate::{Compute, Forward};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::serialized_cloud::SerializedCloud;

/// Convolution over 5³ voxels without bias, batch norm, GELU.
#[derive(Debug)]
pub struct Embedding {
    conv: SparseConv,
    norm: BatchNorm,
}

impl Embedding {
    /// Parameters `stem.conv` and `stem.norm`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        in_channels: usize,
        channels: usize,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            conv: SparseConv::new(compute, in_channels, channels, 5, false, vb.pp("stem.conv"))?,
            norm: BatchNorm::new(channels, vb.pp("stem.norm"))?,
        })
    }

    /// `[N, in] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor, cloud: &SerializedCloud, cx: &Forward<'_>) -> Result<Tensor> {
        let size = self.conv.kernel_size();
        let map = cloud.kernel_map(size).map_err(candle_core::Error::wrap)?;
        // No later layer has this kernel size, and the table is large.
        cloud.forget_kernel_map(size);
        self.norm.forward_gelu(&self.conv.forward(x, map)?, self.norm.mode(cx))
    }
}

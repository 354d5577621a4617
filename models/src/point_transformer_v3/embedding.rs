//! From input features to the first channels.

use crate::layers::{BatchNorm, LinearNorm, NormKind, SparseConv};
use crate::{Compute, Forward};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::serialized_cloud::SerializedCloud;

/// The first layer, its norm, GELU.
#[derive(Debug)]
pub struct Embedding(Stem);

#[derive(Debug)]
enum Stem {
    /// Over 5³ voxels without bias, batch norm.
    Convolution { conv: SparseConv, norm: BatchNorm },
    /// Of each voxel by itself, layer norm.
    Linear(LinearNorm),
}

impl Embedding {
    /// A convolution over 5³ voxels: parameters `stem.conv` and `stem.norm`, that of a batch norm.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn convolution(
        in_channels: usize,
        channels: usize,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self(Stem::Convolution {
            conv: SparseConv::new(compute, in_channels, channels, 5, false, vb.pp("stem.conv"))?,
            norm: BatchNorm::new(channels, vb.pp("stem.norm"))?,
        }))
    }

    /// A linear layer: parameters `stem.linear` and `stem.norm`, that of a layer norm.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn linear(
        in_channels: usize,
        channels: usize,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (linear, norm) = (vb.pp("stem.linear"), vb.pp("stem.norm"));
        let kind = NormKind::Layer;
        Ok(Self(Stem::Linear(LinearNorm::new(compute, kind, in_channels, channels, linear, norm)?)))
    }

    /// `[N, in] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor, cloud: &SerializedCloud, cx: &Forward<'_>) -> Result<Tensor> {
        match &self.0 {
            Stem::Convolution { conv, norm } => {
                let size = conv.kernel_size();
                let map = cloud.kernel_map(size).map_err(candle_core::Error::wrap)?;
                // No later layer has this kernel size, and the table is large.
                cloud.forget_kernel_map(size);
                norm.forward_gelu(&conv.forward(x, map)?, norm.mode(cx))
            }
            Stem::Linear(layer) => layer.forward(x, layer.mode(cx)),
        }
    }
}

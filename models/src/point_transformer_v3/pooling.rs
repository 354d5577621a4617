//! From one scale to the next coarser one.

use crate::Forward;
use crate::layers::{BatchNorm, Linear};
use crate::{Compute, ops};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::{Groups, Reduce};
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use std::sync::Arc;

/// Linear, reduction of the voxels that fall together, batch norm, GELU.
#[derive(Debug)]
pub struct SerializedPooling {
    proj: Linear,
    norm: BatchNorm,
    shift: u32,
    reduce: Reduce,
}

impl SerializedPooling {
    /// Parameters `proj` and `norm.0`; `stride` is a power of two.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        in_channels: usize,
        channels: usize,
        stride: usize,
        reduce: Reduce,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            proj: Linear::with(compute, in_channels, channels, true, vb.pp("proj"))?,
            norm: BatchNorm::new(channels, vb.pp("norm.0"))?,
            shift: stride.trailing_zeros(),
            reduce,
        })
    }

    /// `[N, in] → [M, C]` with the coarser cloud (orders not shuffled) and which row went where.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(
        &self,
        x: &Tensor,
        cloud: &SerializedCloud,
        cx: &Forward<'_>,
    ) -> Result<(Tensor, SerializedCloud, Arc<Groups>)> {
        let (coarse, groups) = cloud.pool(self.shift);
        let groups = Arc::new(groups);
        let pooled = ops::segment_reduce(&self.proj.forward(x)?, groups.clone(), self.reduce)?;
        Ok((self.norm.forward_gelu(&pooled, self.norm.mode(cx))?, coarse, groups))
    }
}

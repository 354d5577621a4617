//! From one scale back to the next finer one.

use crate::Forward;
use crate::layers::{BatchNorm, Linear};
use crate::ops;
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::Groups;
use std::sync::Arc;

/// The sum of the projected fine rows and of the projected coarse row of their voxel.
#[derive(Debug)]
pub struct SerializedUnpooling {
    proj: Linear,
    proj_norm: BatchNorm,
    skip: Linear,
    skip_norm: BatchNorm,
}

/// Result of [`SerializedUnpooling::forward`].
#[derive(Debug)]
pub struct Unpooled {
    /// Skip branch plus upsampled branch. `[N, C]`
    pub sum: Tensor,
    /// The skip branch alone: what the first convolution of the stage reads. `[N, C]`
    pub skip: Tensor,
}

impl SerializedUnpooling {
    /// Parameters `proj.{0,1}` and `proj_skip.{0,1}`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        in_channels: usize,
        skip_channels: usize,
        channels: usize,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            proj: Linear::new(in_channels, channels, true, vb.pp("proj.0"))?,
            proj_norm: BatchNorm::new(channels, vb.pp("proj.1"))?,
            skip: Linear::new(skip_channels, channels, true, vb.pp("proj_skip.0"))?,
            skip_norm: BatchNorm::new(channels, vb.pp("proj_skip.1"))?,
        })
    }

    /// `coarse`: `[M, in]`, `fine`: `[N, skip]` → `[N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(
        &self,
        coarse: &Tensor,
        fine: &Tensor,
        groups: Arc<Groups>,
        cx: &Forward<'_>,
    ) -> Result<Unpooled> {
        let up = self.proj_norm.forward_gelu(&self.proj.forward(coarse)?, cx.mode)?;
        let skip = self.skip_norm.forward_gelu(&self.skip.forward(fine)?, cx.mode)?;
        let sum = (&skip + ops::expand_groups(&up, groups)?)?;
        Ok(Unpooled { sum, skip })
    }
}

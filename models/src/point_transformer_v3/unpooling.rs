//! From one scale back to the next finer one.

use crate::layers::{LinearNorm, NormKind};
use crate::ops;
use crate::{Compute, Forward};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::Groups;
use std::sync::Arc;

/// The sum of the projected fine rows and of the projected coarse row of their voxel.
#[derive(Debug)]
pub struct SerializedUnpooling {
    proj: LinearNorm,
    skip: LinearNorm,
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
        norm: NormKind,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (proj, skip) = (vb.pp("proj"), vb.pp("proj_skip"));
        let layer = |inputs, vb: VarBuilder<'_>| {
            LinearNorm::new(compute, norm, inputs, channels, vb.pp("0"), vb.pp("1"))
        };
        Ok(Self { proj: layer(in_channels, proj)?, skip: layer(skip_channels, skip)? })
    }

    /// The sum alone, of [`forward`](Self::forward).
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_sum(
        &self,
        coarse: &Tensor,
        fine: &Tensor,
        groups: Arc<Groups>,
        cx: &Forward<'_>,
    ) -> Result<Tensor> {
        let up = ops::expand_groups(&self.proj.forward(coarse, self.proj.mode(cx))?, groups)?;
        self.skip.forward_residual(fine, &up, self.skip.mode(cx))
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
        let [up, skip] = self.branches(coarse, fine, cx)?;
        let sum = (&skip + ops::expand_groups(&up, groups)?)?;
        Ok(Unpooled { sum, skip })
    }

    /// The upsampled branch before it is given to the fine voxels, `[M, C]`, and the skip branch,
    /// `[N, C]`.
    pub(super) fn branches(
        &self,
        coarse: &Tensor,
        fine: &Tensor,
        cx: &Forward<'_>,
    ) -> Result<[Tensor; 2]> {
        let up = self.proj.forward(coarse, self.proj.mode(cx))?;
        Ok([up, self.skip.forward(fine, self.skip.mode(cx))?])
    }
}

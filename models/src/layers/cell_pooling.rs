//! From one scale to the next coarser one.

use super::{Linear, Norm, NormKind};
use crate::{Compute, Forward, ops};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::{Groups, Reduce};
use std::sync::Arc;

/// Linear, reduction of the voxels of a cell, norm, GELU.
#[derive(Debug)]
pub(crate) struct CellPooling {
    proj: Linear,
    norm: Norm,
    reduce: Reduce,
}

impl CellPooling {
    /// Parameters `proj` and `norm.0`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        in_channels: usize,
        channels: usize,
        reduce: Reduce,
        norm: NormKind,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let proj = Linear::with(compute, in_channels, channels, true, vb.pp("proj"))?;
        Ok(Self { proj, norm: Norm::new(norm, channels, vb.pp("norm.0"))?, reduce })
    }

    /// `[N, in] → [M, C]`, a row for each group.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor, groups: Arc<Groups>, cx: &Forward<'_>) -> Result<Tensor> {
        let pooled = ops::segment_reduce(&self.proj.forward(x)?, groups, self.reduce)?;
        self.norm.forward_gelu(&pooled, self.norm.mode(cx))
    }
}

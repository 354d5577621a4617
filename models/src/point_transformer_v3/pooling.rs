//! From one scale to the next coarser one, with its orders.

use crate::layers::{CellPooling, NormKind};
use crate::{Compute, Forward};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::segment::{Groups, Reduce};
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use std::sync::Arc;

/// Linear, reduction of the voxels that fall together, norm, GELU.
#[derive(Debug)]
pub struct SerializedPooling {
    pooling: CellPooling,
    shift: u32,
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
        norm: NormKind,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let pooling = CellPooling::new(in_channels, channels, reduce, norm, compute, vb)?;
        Ok(Self { pooling, shift: stride.trailing_zeros() })
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
        Ok((self.pooling.forward(x, groups.clone(), cx)?, coarse, groups))
    }
}

//! Attention inside patches, places known by rotation.

use super::scale::Scale;
use crate::layers::Linear;
use crate::{Compute, ops};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::Heads;

/// Shape of a [`PointRopeAttention`].
#[derive(Debug, Clone, Copy)]
pub struct AttentionShape {
    /// Width of its rows.
    pub channels: usize,
    /// Heads; six times as many divide the channels.
    pub num_heads: usize,
    /// Points of a patch.
    pub patch_size: usize,
    /// Number of the curve order.
    pub order: usize,
    /// Base of the angles.
    pub rope_base: f64,
}

/// Multi-head attention inside patches of one curve order; queries and keys turn with the number of
/// their voxel.
#[derive(Debug)]
pub struct PointRopeAttention {
    qkv: Linear,
    proj: Linear,
    heads: Heads,
    shape: AttentionShape,
    precision: Precision,
}

impl PointRopeAttention {
    /// Parameters `qkv` and `proj`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(shape: AttentionShape, compute: Compute, vb: VarBuilder<'_>) -> Result<Self> {
        let c = shape.channels;
        Ok(Self {
            qkv: Linear::with(compute, c, 3 * c, true, vb.pp("qkv"))?,
            proj: Linear::with(compute, c, c, true, vb.pp("proj"))?,
            heads: Heads { count: shape.num_heads, dim: c / shape.num_heads },
            shape,
            precision: compute.precision,
        })
    }

    /// `proj(attention(x))`, plus a residual if given. `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: Tensor, scale: &Scale, residual: Option<&Tensor>) -> Result<Tensor> {
        let cloud = scale.cloud();
        let qkv = self.qkv.forward(&x)?;
        drop(x);
        let rotations = scale.rotations(self.heads.dim, self.shape.rope_base);
        let turned = ops::point_rope(&qkv, self.heads, rotations)?;
        drop(qkv);
        let attended = ops::patch_attention(
            self.precision,
            &turned,
            self.heads,
            cloud.patches(self.shape.patch_size),
            cloud.order(self.shape.order).order.clone(),
        )?;
        drop(turned);
        self.proj.forward_residual(&attended, residual)
    }
}

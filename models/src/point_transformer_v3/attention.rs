//! Attention of a block.

use crate::layers::Linear;
use crate::{Compute, ops};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use serde::{Deserialize, Serialize};

/// Whether scenes of a batch are kept apart where the original mixes them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BatchRule {
    /// Curve depth and patch size of each scene depend on that scene alone.
    #[default]
    Isolated,
    /// Curve depth of the whole batch, as the original with flash attention.
    SharedDepth,
    /// Also patches no longer than the smallest scene, as the original without flash attention.
    SharedDepthAndPatch,
}

impl BatchRule {
    /// From which voxels curve bits are counted.
    pub(crate) fn curve_depth(self) -> CurveDepth {
        match self {
            Self::Isolated => CurveDepth::PerScene,
            Self::SharedDepth | Self::SharedDepthAndPatch => CurveDepth::WholeBatch,
        }
    }

    /// Points of a patch in a batch of scenes, of so many at most.
    pub(crate) fn patch_size(self, most: usize, offsets: &[usize]) -> usize {
        match self {
            Self::SharedDepthAndPatch => {
                let smallest = offsets.windows(2).map(|s| s[1] - s[0]).min();
                smallest.unwrap_or(most).clamp(1, most)
            }
            Self::Isolated | Self::SharedDepth => most,
        }
    }
}

/// Multi-head attention inside patches of one curve order.
#[derive(Debug)]
pub struct SerializedAttention {
    qkv: Linear,
    proj: Linear,
    heads: Heads,
    patch_size: usize,
    order: usize,
    batch_rule: BatchRule,
    precision: Precision,
}

impl SerializedAttention {
    /// Parameters `qkv` and `proj`; `order` is the number of the curve order.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        channels: usize,
        num_heads: usize,
        patch_size: usize,
        order: usize,
        batch_rule: BatchRule,
        compute: Compute,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            qkv: Linear::with(compute, channels, 3 * channels, true, vb.pp("qkv"))?,
            proj: Linear::with(compute, channels, channels, true, vb.pp("proj"))?,
            heads: Heads { count: num_heads, dim: channels / num_heads },
            patch_size,
            order,
            batch_rule,
            precision: compute.precision,
        })
    }

    /// `proj(attention(x))`, plus a residual if given. `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(
        &self,
        x: Tensor,
        cloud: &SerializedCloud,
        residual: Option<&Tensor>,
    ) -> Result<Tensor> {
        let patch_size = self.batch_rule.patch_size(self.patch_size, cloud.offsets());
        let order = &cloud.order(self.order).order;
        let qkv = self.qkv.forward(&x)?;
        drop(x);
        let attended = ops::patch_attention(
            self.precision,
            &qkv,
            self.heads,
            cloud.patches(patch_size),
            order.clone(),
        )?;
        drop(qkv);
        self.proj.forward_residual(&attended, residual)
    }
}

//! One block: positional convolution, attention, MLP, each with a residual.

use super::attention::{BatchRule, SerializedAttention};
use crate::layers::{AttentionMlp, ResidualConv, recomputed};
use crate::{Compute, Forward};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use std::sync::Arc;

/// Shape of a block.
#[derive(Debug, Clone, Copy)]
pub struct BlockShape {
    /// Width of its rows.
    pub channels: usize,
    /// Attention heads.
    pub num_heads: usize,
    /// Points of an attention patch.
    pub patch_size: usize,
    /// Width of the hidden layer, in channels.
    pub mlp_ratio: usize,
    /// Probability that a row skips a branch in training.
    pub drop_path: f64,
    /// Number of the curve order.
    pub order: usize,
    /// How scenes of a batch are kept apart.
    pub batch_rule: BatchRule,
    /// Precision, and whether the linear layer behind the convolution is folded into it.
    pub compute: Compute,
}

/// `x + LN(Linear(conv(x)))`, then attention and MLP on normalized rows.
#[derive(Debug, Clone)]
pub struct Block {
    conv: ResidualConv,
    rest: Arc<AttentionMlp<SerializedAttention>>,
}

impl Block {
    /// Parameters `cpe.{0,1,2}`, `norm1.0`, `attn`, `norm2.0`, `mlp.0`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(shape: BlockShape, vb: VarBuilder<'_>) -> Result<Self> {
        Self::with_rank(shape, None, vb)
    }

    /// As [`Block::new`]; with a rank it runs once it is [`calibrated`](Self::calibrated).
    pub(super) fn with_rank(
        shape: BlockShape,
        rank: Option<usize>,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (c, compute) = (shape.channels, shape.compute);
        let attention = SerializedAttention::new(
            c,
            shape.num_heads,
            shape.patch_size,
            shape.order,
            shape.batch_rule,
            compute,
            vb.pp("attn"),
        )?;
        let (ratio, drop_path) = (shape.mlp_ratio, shape.drop_path);
        Ok(Self {
            conv: ResidualConv::new(compute, c, rank, vb.pp("cpe"))?,
            rest: Arc::new(AttentionMlp::new(attention, c, ratio, drop_path, compute, &vb)?),
        })
    }

    /// The block with the rank of its convolution decided by what that reads, and the part of its
    /// variance that is kept.
    pub(super) fn calibrated(
        &self,
        input: &Tensor,
        cloud: &SerializedCloud,
    ) -> Result<(Self, f64)> {
        let (conv, kept) = self.conv.calibrated(input, cloud)?;
        Ok((Self { conv, ..self.clone() }, kept))
    }

    /// As [`forward`](Self::forward); if the context says so, without keeping what the backward pass
    /// can compute again.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_shared(
        self: &Arc<Self>,
        x: Tensor,
        conv_input: Option<Tensor>,
        cloud: &Arc<SerializedCloud>,
        cx: &mut Forward<'_>,
    ) -> Result<Tensor> {
        let Some(recompute) = cx.recompute.clone() else {
            return self.forward(x, conv_input, cloud, cx);
        };
        let (block, cloud) = (Arc::clone(self), Arc::clone(cloud));
        let inputs: Vec<&Tensor> = std::iter::once(&x).chain(&conv_input).collect();
        recomputed(&recompute, &inputs, Some(self.rest.drop_path), cx, move |inputs, cx| {
            block.forward(inputs[0].clone(), inputs.get(1).cloned(), &cloud, cx)
        })
    }

    /// `[N, C] → [N, C]`. The convolution reads `conv_input` where given (the first decoder block
    /// of a stage: its weights were trained seeing the skip branch only), else the rows themselves.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(
        &self,
        x: Tensor,
        conv_input: Option<Tensor>,
        cloud: &SerializedCloud,
        cx: &mut Forward<'_>,
    ) -> Result<Tensor> {
        let x = self.conv.forward(&x, conv_input, cloud)?;
        self.rest.forward(x, cx, |attention, x, residual| attention.forward(x, cloud, residual))
    }
}

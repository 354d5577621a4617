//! One block: a convolution, attention with an MLP, or both.

use super::attention::{AttentionShape, PointRopeAttention};
use super::scale::Scale;
use crate::layers::{AttentionMlp, LayerNorm, ResidualConv, recomputed};
use crate::{Compute, Forward};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What the blocks of a stage are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BlockKind {
    /// A convolution over 3³ voxels.
    Convolution,
    /// Attention and MLP.
    Attention,
    /// A convolution, then attention and MLP.
    Both,
}

impl BlockKind {
    /// Whether there is a convolution.
    pub fn has_convolution(self) -> bool {
        self != Self::Attention
    }

    /// Whether there is attention.
    pub fn has_attention(self) -> bool {
        self != Self::Convolution
    }
}

/// Shape of a block.
#[derive(Debug, Clone, Copy)]
pub struct BlockShape {
    /// What it is made of.
    pub kind: BlockKind,
    /// Width of its rows, and its attention if it has one.
    pub attention: AttentionShape,
    /// Width of the hidden layer, in channels.
    pub mlp_ratio: usize,
    /// Probability that a row skips a branch of the attention in training.
    pub drop_path: f64,
    /// Precision, and whether the linear layer behind the convolution is folded into it.
    pub compute: Compute,
}

/// `x + LN(Linear(conv(x)))`, or, without convolution, `LN(x)` in place of `x`; then attention and
/// MLP on normalized rows, where there is attention. A convolution alone has no activation and no
/// drop path.
#[derive(Debug)]
pub struct Block {
    entry: Entry,
    attention: Option<AttentionMlp<PointRopeAttention>>,
}

#[derive(Debug)]
enum Entry {
    Convolution(Box<ResidualConv>),
    Norm(LayerNorm),
}

impl Block {
    /// Parameters `conv.{0,1,2}` or `norm0.0`, then `norm1.0`, `attn`, `norm2.0`, `mlp.0`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(shape: BlockShape, vb: VarBuilder<'_>) -> Result<Self> {
        let (c, compute) = (shape.attention.channels, shape.compute);
        let entry = if shape.kind.has_convolution() {
            Entry::Convolution(Box::new(ResidualConv::new(compute, c, None, vb.pp("conv"))?))
        } else {
            Entry::Norm(LayerNorm::new(c, vb.pp("norm0.0"))?)
        };
        let attention = || {
            let attention = PointRopeAttention::new(shape.attention, compute, vb.pp("attn"))?;
            AttentionMlp::new(attention, c, shape.mlp_ratio, shape.drop_path, compute, &vb)
        };
        let attention = shape.kind.has_attention().then(attention).transpose()?;
        Ok(Self { entry, attention })
    }

    /// As [`forward`](Self::forward); if the context says so, without keeping what the backward pass
    /// can compute again.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_shared(
        self: &Arc<Self>,
        x: Tensor,
        scale: &Arc<Scale>,
        cx: &mut Forward<'_>,
    ) -> Result<Tensor> {
        let Some(recompute) = cx.recompute.clone() else {
            return self.forward(x, scale, cx);
        };
        let (block, scale) = (Arc::clone(self), Arc::clone(scale));
        let drop_path = self.attention.as_ref().map(|part| part.drop_path);
        recomputed(&recompute, &[&x], drop_path, cx, move |inputs, cx| {
            block.forward(inputs[0].clone(), &scale, cx)
        })
    }

    /// `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: Tensor, scale: &Scale, cx: &mut Forward<'_>) -> Result<Tensor> {
        let x = match &self.entry {
            Entry::Convolution(conv) => conv.forward(&x, None, scale.cloud())?,
            Entry::Norm(norm) => norm.forward(&x)?,
        };
        match &self.attention {
            Some(part) => {
                part.forward(x, cx, |attention, x, residual| attention.forward(x, scale, residual))
            }
            None => Ok(x),
        }
    }
}

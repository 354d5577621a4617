//! One block: a convolution, attention with an MLP, or both.

use super::attention::{AttentionShape, PointRopeAttention};
use super::scale::Scale;
use crate::layers::{DropPath, LayerNorm, Mlp, ResidualConv};
use crate::{Compute, Forward, Mode};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use rand_chacha::ChaCha8Rng;
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
/// MLP on normalised rows, where there is attention. A convolution alone has no activation and no
/// drop path.
#[derive(Debug)]
pub struct Block {
    entry: Entry,
    attention: Option<Attention>,
}

#[derive(Debug)]
enum Entry {
    Convolution(Box<ResidualConv>),
    Norm(LayerNorm),
}

#[derive(Debug)]
struct Attention {
    norm1: LayerNorm,
    attention: PointRopeAttention,
    norm2: LayerNorm,
    mlp: Mlp,
    drop_path: DropPath,
}

impl Block {
    /// Parameters `conv.{0,1,2}` or `norm0.0`, then `norm1.0`, `attn`, `norm2.0`, `mlp.0`.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(shape: BlockShape, vb: VarBuilder<'_>) -> Result<Self> {
        let (c, compute) = (shape.attention.channels, shape.compute);
        let entry = if shape.kind.has_convolution() {
            Entry::Convolution(Box::new(ResidualConv::new(compute, c, vb.pp("conv"))?))
        } else {
            Entry::Norm(LayerNorm::new(c, vb.pp("norm0.0"))?)
        };
        let attention = || -> Result<Attention> {
            Ok(Attention {
                norm1: LayerNorm::new(c, vb.pp("norm1.0"))?,
                attention: PointRopeAttention::new(shape.attention, compute, vb.pp("attn"))?,
                norm2: LayerNorm::new(c, vb.pp("norm2.0"))?,
                mlp: Mlp::with(compute, c, shape.mlp_ratio * c, vb.pp("mlp.0"))?,
                drop_path: DropPath { rate: shape.drop_path },
            })
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
        let (mode, rng) = (cx.mode, cx.rng.clone());
        let run = move |inputs: &[Tensor], rng: &mut ChaCha8Rng| {
            let mut cx = Forward { mode, ..Forward::eval(rng) };
            block.forward(inputs[0].clone(), &scale, &mut cx)
        };
        // Draws what the block draws, so that the next block does not draw the same.
        if let (Some(part), Mode::Train) = (&self.attention, cx.mode) {
            let rows = x.dim(0)?;
            (0..2).for_each(|_| part.drop_path.skip(rows, cx.rng));
        }
        recompute.apply(&[&x], move |inputs| run(inputs, &mut rng.clone()))
    }

    /// `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: Tensor, scale: &Scale, cx: &mut Forward<'_>) -> Result<Tensor> {
        // Rows are as large as memory gets: each is given up as soon as nothing reads it.
        let mut x = x;
        x = match &self.entry {
            Entry::Convolution(conv) => conv.forward(&x, None, scale.cloud())?,
            Entry::Norm(norm) => norm.forward(&x)?,
        };
        let Some(part) = &self.attention else { return Ok(x) };
        let normed = part.norm1.forward(&x)?;
        if cx.mode == Mode::Eval || part.drop_path.rate <= 0.0 {
            x = part.attention.forward(normed, scale, Some(&x))?;
            return part.mlp.forward_residual(&part.norm2.forward(&x)?, &x);
        }
        let branch = part.attention.forward(normed, scale, None)?;
        x = part.drop_path.forward_residual(&branch, &x, cx.mode, cx.rng)?;
        let branch = part.mlp.forward(&part.norm2.forward(&x)?)?;
        part.drop_path.forward_residual(&branch, &x, cx.mode, cx.rng)
    }
}

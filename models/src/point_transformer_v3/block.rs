//! One block: positional convolution, attention, MLP, each with a residual.

use super::attention::{BatchRule, SerializedAttention};
use crate::layers::{DropPath, LayerNorm, Mlp, ResidualConv};
use crate::{Compute, Forward, Mode};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use rand_chacha::ChaCha8Rng;
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

/// `x + LN(Linear(conv(x)))`, then attention and MLP on normalised rows.
#[derive(Debug, Clone)]
pub struct Block {
    conv: ResidualConv,
    norm1: LayerNorm,
    attention: Arc<SerializedAttention>,
    norm2: LayerNorm,
    mlp: Arc<Mlp>,
    drop_path: DropPath,
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
        let c = shape.channels;
        Ok(Self {
            conv: ResidualConv::with_rank(shape.compute, c, rank, vb.pp("cpe"))?,
            norm1: LayerNorm::new(c, vb.pp("norm1.0"))?,
            attention: Arc::new(SerializedAttention::new(
                c,
                shape.num_heads,
                shape.patch_size,
                shape.order,
                shape.batch_rule,
                shape.compute,
                vb.pp("attn"),
            )?),
            norm2: LayerNorm::new(c, vb.pp("norm2.0"))?,
            mlp: Arc::new(Mlp::with(shape.compute, c, shape.mlp_ratio * c, vb.pp("mlp.0"))?),
            drop_path: DropPath { rate: shape.drop_path },
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
        let (mode, rng) = (cx.mode, cx.rng.clone());
        let run = move |inputs: &[Tensor], rng: &mut ChaCha8Rng| {
            let mut cx = Forward { mode, ..Forward::eval(rng) };
            block.forward(inputs[0].clone(), inputs.get(1).cloned(), &cloud, &mut cx)
        };
        // Draws what the block draws, so that the next block does not draw the same.
        if cx.mode == Mode::Train {
            let rows = x.dim(0)?;
            (0..2).for_each(|_| self.drop_path.skip(rows, cx.rng));
        }
        let inputs: Vec<&Tensor> = std::iter::once(&x).chain(&conv_input).collect();
        recompute.apply(&inputs, move |inputs| run(inputs, &mut rng.clone()))
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
        // Rows are as large as memory gets: each is given up as soon as nothing reads it.
        let mut x = x;
        x = self.conv.forward(&x, conv_input, cloud)?;
        if cx.mode == Mode::Eval || self.drop_path.rate <= 0.0 {
            x = self.attention.forward(self.norm1.forward(&x)?, cloud, Some(&x))?;
            return self.mlp.forward_residual(&self.norm2.forward(&x)?, &x);
        }
        let branch = self.attention.forward(self.norm1.forward(&x)?, cloud, None)?;
        let x = self.drop_path.forward_residual(&branch, &x, cx.mode, cx.rng)?;
        let branch = self.mlp.forward(&self.norm2.forward(&x)?)?;
        self.drop_path.forward_residual(&branch, &x, cx.mode, cx.rng)
    }
}

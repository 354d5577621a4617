//! Attention and an MLP, each on normalized rows with a residual; and blocks that are computed again.

use super::{DropPath, LayerNorm, Mlp};
use crate::{Compute, Forward, Mode, Recompute};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;

/// The second part of a block: `x + A(LN(x))`, then `x + MLP(LN(x))`.
#[derive(Debug)]
pub(crate) struct AttentionMlp<A> {
    norm1: LayerNorm,
    attention: A,
    norm2: LayerNorm,
    mlp: Mlp,
    /// Of both branches.
    pub drop_path: DropPath,
}

impl<A> AttentionMlp<A> {
    /// Parameters `norm1.0`, `norm2.0`, `mlp.0`, the last with hidden rows `mlp_ratio` times as wide.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(
        attention: A,
        channels: usize,
        mlp_ratio: usize,
        drop_path: f64,
        compute: Compute,
        vb: &VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            norm1: LayerNorm::new(channels, vb.pp("norm1.0"))?,
            attention,
            norm2: LayerNorm::new(channels, vb.pp("norm2.0"))?,
            mlp: Mlp::new(compute, channels, mlp_ratio * channels, vb.pp("mlp.0"))?,
            drop_path: DropPath { rate: drop_path },
        })
    }

    /// `[N, C] → [N, C]`; `attend` runs the attention, and adds a residual if it gets one.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(
        &self,
        mut x: Tensor,
        cx: &mut Forward<'_>,
        attend: impl Fn(&A, Tensor, Option<&Tensor>) -> Result<Tensor>,
    ) -> Result<Tensor> {
        // Rows are as large as memory gets: each is given up as soon as nothing reads it.
        if cx.mode == Mode::Eval || self.drop_path.rate <= 0.0 {
            x = attend(&self.attention, self.norm1.forward(&x)?, Some(&x))?;
            return self.mlp.forward_residual(&self.norm2.forward(&x)?, &x);
        }
        let branch = attend(&self.attention, self.norm1.forward(&x)?, None)?;
        x = self.drop_path.forward_residual(&branch, &x, cx.mode, cx.rng)?;
        let branch = self.mlp.forward(&self.norm2.forward(&x)?)?;
        self.drop_path.forward_residual(&branch, &x, cx.mode, cx.rng)
    }
}

/// Runs a block without keeping what the backward pass can compute again. Two branches with this drop path draw from the
/// random numbers of `cx`, which go on behind those.
///
/// # Errors
/// Those of `run`.
pub(crate) fn recomputed(
    recompute: &Recompute,
    inputs: &[&Tensor],
    drop_path: Option<DropPath>,
    cx: &mut Forward<'_>,
    run: impl Fn(&[Tensor], &mut Forward<'_>) -> Result<Tensor> + Send + Sync + 'static,
) -> Result<Tensor> {
    let (mode, rng) = (cx.mode, cx.rng.clone());
    if let (Some(drop_path), Mode::Train) = (drop_path, mode) {
        let rows = inputs[0].dim(0)?;
        (0..2).for_each(|_| drop_path.skip(rows, cx.rng));
    }
    recompute.apply(inputs, move |inputs| {
        let mut rng = rng.clone();
        run(inputs, &mut Forward { mode, ..Forward::eval(&mut rng) })
    })
}

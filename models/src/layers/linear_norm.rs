//! A linear layer with a norm and a GELU behind it.

use super::linear::parameters;
use super::{Linear, Norm, NormKind, add, vector};
use crate::{Compute, Forward, Mode, ops};
use candle_core::Result;
use candle_core::Tensor;
use candle_nn::VarBuilder;

/// `gelu(norm(Linear(x)))`; one linear layer where a batch norm is frozen and may be folded into it.
#[derive(Debug, Clone)]
pub struct LinearNorm {
    linear: Linear,
    /// `None` if it is part of the linear layer.
    norm: Option<Norm>,
}

impl LinearNorm {
    /// Parameters of the linear layer (with bias) and of the norm from their own builders.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(
        compute: Compute,
        kind: NormKind,
        cin: usize,
        cout: usize,
        linear: VarBuilder<'_>,
        norm: VarBuilder<'_>,
    ) -> Result<Self> {
        let (weight, bias) = parameters(cin, cout, true, &linear)?;
        let norm = Norm::new(kind, cout, norm)?;
        let Some((scale, shift)) = norm.scale_shift().filter(|_| compute.fold) else {
            return Ok(Self { linear: Linear::of(compute, weight, bias)?, norm: Some(norm) });
        };
        let mut weight = weight.flatten_all()?.to_vec1::<f32>()?;
        for (row, scale) in weight.chunks_exact_mut(cin.max(1)).zip(scale) {
            row.iter_mut().for_each(|w| *w *= scale);
        }
        let bias = match bias {
            Some(bias) => vector(&bias)?,
            None => vec![0.0; cout],
        };
        let bias = bias.iter().zip(scale).zip(shift).map(|((b, s), t)| b.mul_add(*s, *t)).collect();
        Ok(Self { linear: Linear::frozen(compute, &weight, cin, cout, Some(bias)), norm: None })
    }

    /// As [`BatchNorm::mode`](super::BatchNorm::mode).
    pub fn mode(&self, cx: &Forward<'_>) -> Mode {
        self.norm.as_ref().map_or(cx.mode, |norm| norm.mode(cx))
    }

    /// `[N, in] → [N, out]`
    ///
    /// # Errors
    /// If the input does not fit, or as [`BatchNorm::forward_gelu`](super::BatchNorm::forward_gelu).
    pub fn forward(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        match &self.norm {
            Some(norm) => norm.forward_gelu(&self.linear.forward(x)?, mode),
            None if mode == Mode::Train => ops::frozen_cannot_train(),
            None => self.linear.forward_gelu(x, None),
        }
    }

    /// `forward(x) + residual`
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    pub fn forward_residual(&self, x: &Tensor, residual: &Tensor, mode: Mode) -> Result<Tensor> {
        match &self.norm {
            None if mode == Mode::Eval => self.linear.forward_gelu(x, Some(residual)),
            _ => add(&self.forward(x, mode)?, Some(residual)),
        }
    }
}

//! Layer normalization with a gradient.

use super::{add, stays_tensor, vector};
use crate::ops;
use candle_core::{Result, Tensor};
use candle_nn::{Init, VarBuilder};

/// LayerNorm over the channels, ε = 1e-5.
#[derive(Debug, Clone)]
pub struct LayerNorm(Form);

const EPS: f32 = 1e-5;

#[derive(Debug, Clone)]
enum Form {
    Tensors { weight: Tensor, bias: Tensor },
    Frozen { weight: Vec<f32>, bias: Vec<f32> },
}

impl LayerNorm {
    /// Parameters `weight` (1) and `bias` (0).
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(channels: usize, vb: VarBuilder<'_>) -> Result<Self> {
        let (weight, bias) = Self::parameters(channels, &vb)?;
        Ok(Self(if stays_tensor(&weight) {
            Form::Tensors { weight, bias }
        } else {
            Form::Frozen { weight: vector(&weight)?, bias: vector(&bias)? }
        }))
    }

    /// Weight and bias.
    pub(crate) fn parameters(channels: usize, vb: &VarBuilder<'_>) -> Result<(Tensor, Tensor)> {
        let weight = vb.get_with_hints(channels, "weight", Init::Const(1.0))?;
        Ok((weight, vb.get_with_hints(channels, "bias", Init::Const(0.0))?))
    }

    /// `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.forward_residual(x, None)
    }

    /// `forward(x) + residual`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_residual(&self, x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
        match &self.0 {
            Form::Tensors { weight, bias } => {
                add(&ops::layer_norm(x, weight, bias, EPS)?, residual)
            }
            Form::Frozen { weight, bias } => ops::layer_norm_frozen(x, weight, bias, EPS, residual),
        }
    }
}

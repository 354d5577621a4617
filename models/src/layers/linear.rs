//! Linear layer.

use super::{add, vector};
use crate::ops;
use candle_core::{Result, Tensor};
use candle_nn::{Init, VarBuilder};
use scenesplat_kernels::gemm::PackedMatrix;

/// `y = x · Wᵀ + b`, `W`: `[out, in]`.
#[derive(Debug, Clone)]
pub struct Linear(Form);

#[derive(Debug, Clone)]
enum Form {
    Trainable { weight: Tensor, bias: Option<Tensor> },
    Frozen { weight: PackedMatrix, bias: Option<Vec<f32>> },
}

impl Linear {
    /// Creates or finds `weight` and, if asked for, `bias`. Initial values are PyTorch's:
    /// uniform in ±1/√in.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(cin: usize, cout: usize, bias: bool, vb: VarBuilder<'_>) -> Result<Self> {
        let bound = 1.0 / (cin as f64).sqrt();
        let init = Init::Uniform { lo: -bound, up: bound };
        let weight = vb.get_with_hints((cout, cin), "weight", init)?;
        let bias = bias.then(|| vb.get_with_hints(cout, "bias", init)).transpose()?;
        if weight.is_variable() {
            return Ok(Self(Form::Trainable { weight, bias }));
        }
        let weight =
            ops::read("linear", &weight, |w| Ok(PackedMatrix::from_strided(w, cin, cout, 1, cin)))?;
        let bias = bias.as_ref().map(vector).transpose()?;
        Ok(Self(Form::Frozen { weight, bias }))
    }

    /// `[N, in] → [N, out]`
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
            Form::Trainable { weight, bias } => {
                add(&ops::linear(x, weight, bias.as_ref())?, residual)
            }
            Form::Frozen { weight, bias } => {
                ops::linear_frozen(x, weight, bias.as_deref(), residual)
            }
        }
    }

    /// Packed weight and bias, when frozen with a bias.
    pub(crate) fn packed(&self) -> Option<(&PackedMatrix, &[f32])> {
        match &self.0 {
            Form::Frozen { weight, bias: Some(bias) } => Some((weight, bias)),
            _ => None,
        }
    }
}

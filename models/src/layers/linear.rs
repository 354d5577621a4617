//! Linear layer.

use super::{add, stays_tensor, vector};
use crate::{Compute, ops};
use candle_core::{Result, Tensor};
use candle_nn::{Init, VarBuilder};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::PackedMatrix;

/// `y = x · Wᵀ + b`, `W`: `[out, in]`.
#[derive(Debug, Clone)]
pub struct Linear(Form);

#[derive(Debug, Clone)]
enum Form {
    Tensors { weight: Tensor, bias: Option<Tensor>, precision: Precision },
    Frozen { weight: PackedMatrix, bias: Option<Vec<f32>> },
}

impl Linear {
    /// Creates or finds `weight` and, if asked for, `bias`. Initial values are PyTorch's:
    /// uniform in ±1/√in.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(cin: usize, cout: usize, bias: bool, vb: VarBuilder<'_>) -> Result<Self> {
        Self::with(Compute::default(), cin, cout, bias, vb)
    }

    /// [`Linear::new`] with choices.
    ///
    /// # Errors
    /// As [`Linear::new`].
    pub fn with(
        compute: Compute,
        cin: usize,
        cout: usize,
        bias: bool,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (weight, bias) = parameters(cin, cout, bias, &vb)?;
        Self::of(compute, weight, bias)
    }

    /// The layer with these parameters.
    pub(crate) fn of(compute: Compute, weight: Tensor, bias: Option<Tensor>) -> Result<Self> {
        let (cout, cin) = weight.dims2()?;
        if stays_tensor(&weight) {
            ops::refuse_training("linear", compute.precision)?;
            return Ok(Self(Form::Tensors { weight, bias, precision: compute.precision }));
        }
        let bias = bias.as_ref().map(vector).transpose()?;
        ops::read("linear", &weight, |w| Ok(Self::frozen(compute, w, cin, cout, bias)))
    }

    /// A layer of given values, not to be trained. `weight`: `[cout, cin]`
    pub(crate) fn frozen(
        compute: Compute,
        weight: &[f32],
        cin: usize,
        cout: usize,
        bias: Option<Vec<f32>>,
    ) -> Self {
        let weight = PackedMatrix::from_strided_with(compute.precision, weight, cin, cout, 1, cin);
        Self(Form::Frozen { weight, bias })
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
            Form::Tensors { weight, bias, precision } => {
                add(&ops::linear_with(*precision, x, weight, bias.as_ref())?, residual)
            }
            Form::Frozen { weight, bias } => {
                ops::linear_frozen(x, weight, bias.as_deref(), false, residual)
            }
        }
    }

    /// `forward(x)` at unit length; a zero row stays zero.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_unit(&self, x: &Tensor) -> Result<Tensor> {
        match &self.0 {
            Form::Tensors { .. } => ops::l2_normalize(&self.forward(x)?),
            Form::Frozen { weight, bias } => ops::linear_unit_frozen(x, weight, bias.as_deref()),
        }
    }

    /// `gelu(forward(x))`, plus a residual if given.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_gelu(&self, x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
        match &self.0 {
            Form::Tensors { .. } => add(&ops::gelu(&self.forward(x)?)?, residual),
            Form::Frozen { weight, bias } => {
                ops::linear_frozen(x, weight, bias.as_deref(), true, residual)
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

/// Weight and bias, uniform in ±1/√in as PyTorch's.
pub(crate) fn parameters(
    cin: usize,
    cout: usize,
    bias: bool,
    vb: &VarBuilder<'_>,
) -> Result<(Tensor, Option<Tensor>)> {
    let bound = 1.0 / (cin as f64).sqrt();
    let init = Init::Uniform { lo: -bound, up: bound };
    let weight = vb.get_with_hints((cout, cin), "weight", init)?;
    Ok((weight, bias.then(|| vb.get_with_hints(cout, "bias", init)).transpose()?))
}

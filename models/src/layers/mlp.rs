//! Two linear layers with a GELU between.

use super::{Linear, add};
use crate::{Compute, ops};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;

/// `fc2(gelu(fc1(x)))`
#[derive(Debug, Clone)]
pub struct Mlp {
    fc1: Linear,
    fc2: Linear,
}

impl Mlp {
    /// Parameters `fc1` and `fc2`.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(
        compute: Compute,
        channels: usize,
        hidden: usize,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            fc1: Linear::with(compute, channels, hidden, true, vb.pp("fc1"))?,
            fc2: Linear::with(compute, hidden, channels, true, vb.pp("fc2"))?,
        })
    }

    /// `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.fc2.forward(&ops::gelu(&self.fc1.forward(x)?)?)
    }

    /// `forward(x) + residual`; with frozen weights the hidden rows are never stored as a whole.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward_residual(&self, x: &Tensor, residual: &Tensor) -> Result<Tensor> {
        match (self.fc1.packed(), self.fc2.packed()) {
            (Some(first), Some(second)) => ops::mlp_frozen(x, first, second, residual),
            _ => add(&self.forward(x)?, Some(residual)),
        }
    }
}

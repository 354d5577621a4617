//! Linear layer, batch norm with PyTorch's constants, ReLU.

use super::{BatchNorm, BatchNormConstants, Linear};
use crate::{Compute, Mode};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;

/// A batch norm with PyTorch's constants.
pub(crate) fn batch_norm(channels: usize, vb: VarBuilder<'_>) -> Result<BatchNorm> {
    BatchNorm::with(BatchNormConstants::PYTORCH, channels, vb)
}

/// A linear layer with a batch norm and a ReLU behind it.
#[derive(Debug)]
pub(crate) struct LinearNormRelu {
    linear: Linear,
    norm: BatchNorm,
}

impl LinearNormRelu {
    /// Parameters `linear` and `norm`.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub(crate) fn new(
        compute: Compute,
        i: usize,
        o: usize,
        bias: bool,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let linear = Linear::with(compute, i, o, bias, vb.pp("linear"))?;
        Ok(Self { linear, norm: batch_norm(o, vb.pp("norm"))? })
    }

    /// `[N, in] → [N, out]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub(crate) fn forward(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        self.norm.forward_relu(&self.linear.forward(x)?, mode)
    }
}

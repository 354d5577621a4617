//! Linear layer, batch norm with PyTorch's constants, ReLU; and a linear layer behind them.

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

/// A small network on positions or weights: hidden layer with norm and ReLU, then a linear layer.
#[derive(Debug)]
pub(crate) struct Encoding {
    hidden: LinearNormRelu,
    last: Linear,
}

impl Encoding {
    /// Parameters `hidden` and `last`, of these widths: input, hidden layer, output.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub(crate) fn new(
        compute: Compute,
        [i, hidden, o]: [usize; 3],
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        Ok(Self {
            hidden: LinearNormRelu::new(compute, i, hidden, true, vb.pp("hidden"))?,
            last: Linear::with(compute, hidden, o, true, vb.pp("last"))?,
        })
    }

    /// `[N, in] → [N, out]`
    ///
    /// # Errors
    /// If the input does not fit.
    pub(crate) fn forward(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        self.last.forward(&self.hidden.forward(x, mode)?)
    }
}

//! The norm of a network between a linear layer and its activation: over the batch, or over the channels.

use super::{BatchNorm, LayerNorm};
use crate::{Forward, Mode, ops};
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;

/// Which norm stands in front of the activations of stem, pooling and unpooling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NormKind {
    /// Each channel over all rows.
    Batch,
    /// Each row over its channels.
    Layer,
}

impl NormKind {
    /// Values of its parameters and buffers; at most `usize::MAX`.
    pub(crate) fn num_values(self, channels: usize) -> usize {
        match self {
            // Weight, bias, mean, variance, and the number of batches.
            Self::Batch => channels.saturating_mul(4).saturating_add(1),
            Self::Layer => channels.saturating_mul(2),
        }
    }
}

/// One of the two.
#[derive(Debug, Clone)]
pub(crate) enum Norm {
    Batch(BatchNorm),
    Layer(LayerNorm),
}

impl Norm {
    /// Parameters as the norm of this kind names them.
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(kind: NormKind, channels: usize, vb: VarBuilder<'_>) -> Result<Self> {
        Ok(match kind {
            NormKind::Batch => Self::Batch(BatchNorm::new(channels, vb)?),
            NormKind::Layer => Self::Layer(LayerNorm::new(channels, vb)?),
        })
    }

    /// As [`BatchNorm::mode`]; a norm over the channels is the same in both modes.
    pub fn mode(&self, cx: &Forward<'_>) -> Mode {
        match self {
            Self::Batch(norm) => norm.mode(cx),
            Self::Layer(_) => cx.mode,
        }
    }

    /// Factor and summand per channel, of a frozen batch norm.
    pub fn scale_shift(&self) -> Option<(&[f32], &[f32])> {
        match self {
            Self::Batch(norm) => norm.scale_shift(),
            Self::Layer(_) => None,
        }
    }

    /// `gelu(norm(x))`. `[N, C] → [N, C]`
    ///
    /// # Errors
    /// If the input does not fit, or as [`BatchNorm::forward_gelu`].
    pub fn forward_gelu(&self, x: &Tensor, mode: Mode) -> Result<Tensor> {
        match self {
            Self::Batch(norm) => norm.forward_gelu(x, mode),
            Self::Layer(norm) => ops::gelu(&norm.forward(x)?),
        }
    }
}

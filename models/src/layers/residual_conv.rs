//! A convolution whose normalised result is added to its rows.

use super::{LayerNorm, Linear, SparseConv};
use crate::Compute;
use candle_core::{Result, Tensor};
use candle_nn::VarBuilder;
use scenesplat_kernels::serialized_cloud::SerializedCloud;

/// `x + LN(Linear(conv(x)))`, convolution over 3³ voxels, no activation.
#[derive(Debug, Clone)]
pub struct ResidualConv {
    conv: SparseConv,
    /// `None` if it is part of the convolution.
    linear: Option<Linear>,
    norm: LayerNorm,
}

impl ResidualConv {
    /// Parameters `0` (convolution), `1` (linear layer), `2` (norm).
    ///
    /// # Errors
    /// If parameters exist with another shape.
    pub fn new(compute: Compute, channels: usize, vb: VarBuilder<'_>) -> Result<Self> {
        let (conv, linear) = SparseConv::with_linear(compute, channels, 3, vb.pp("0"), vb.pp("1"))?;
        Ok(Self { conv, linear, norm: LayerNorm::new(channels, vb.pp("2"))? })
    }

    /// `[N, C] → [N, C]`; the convolution reads `input` where given, else `x`.
    ///
    /// # Errors
    /// If the input does not fit.
    pub fn forward(
        &self,
        x: &Tensor,
        input: Option<Tensor>,
        cloud: &SerializedCloud,
    ) -> Result<Tensor> {
        let map = cloud.kernel_map(self.conv.kernel_size()).map_err(candle_core::Error::wrap)?;
        // Rows are as large as memory gets: each is given up as soon as nothing reads it.
        let mut y = self.conv.forward(input.as_ref().unwrap_or(x), map)?;
        drop(input);
        if let Some(linear) = &self.linear {
            y = linear.forward(&y)?;
        }
        self.norm.forward_residual(&y, Some(x))
    }
}

//! A convolution whose normalized result is added to its rows.

use super::low_rank_conv::{LowRankConv, PlainConv};
use super::{LayerNorm, Linear, SparseConv};
use crate::Compute;
use candle_core::{Result, Tensor, bail};
use candle_nn::VarBuilder;
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use std::sync::Arc;

/// Taps along one axis.
const KERNEL: usize = 3;

/// `x + LN(Linear(conv(x)))`, convolution over 3³ voxels, no activation.
#[derive(Debug, Clone)]
pub struct ResidualConv {
    conv: Conv,
    /// `None` if it is part of the convolution.
    linear: Option<Linear>,
    norm: LayerNorm,
}

#[derive(Debug, Clone)]
enum Conv {
    Full(SparseConv),
    /// Of this rank, once there is an example of its input.
    Waiting(Arc<PlainConv>, usize),
    LowRank(LowRankConv),
}

impl ResidualConv {
    /// Parameters `0` (convolution), `1` (linear layer), `2` (norm). With a rank it runs once it is
    /// [`calibrated`](Self::calibrated).
    ///
    /// # Errors
    /// If parameters exist with another shape, or are to be trained with a rank.
    pub(crate) fn new(
        compute: Compute,
        channels: usize,
        rank: Option<usize>,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (first, second) = (vb.pp("0"), vb.pp("1"));
        let (conv, linear) = match rank {
            None => {
                let (conv, linear) =
                    SparseConv::with_linear(compute, channels, KERNEL, first, second)?;
                (Conv::Full(conv), linear)
            }
            Some(rank) => {
                let (conv, linear) =
                    SparseConv::plain_with_linear(compute, channels, KERNEL, first, second)?;
                (Conv::Waiting(Arc::new(conv), rank), linear)
            }
        };
        Ok(Self { conv, linear, norm: LayerNorm::new(channels, vb.pp("2"))? })
    }

    /// The layer with its rank decided by what it reads, `[N, C]`, and the part of the convolution's
    /// variance that is kept; as it is, if it has no rank.
    ///
    /// # Errors
    /// If the input does not fit.
    pub(crate) fn calibrated(
        &self,
        input: &Tensor,
        cloud: &SerializedCloud,
    ) -> Result<(Self, f64)> {
        let Conv::Waiting(conv, rank) = &self.conv else { return Ok((self.clone(), 1.0)) };
        let map = cloud.kernel_map(KERNEL).map_err(candle_core::Error::wrap)?;
        let (conv, kept) = conv.factor(*rank, input, &map)?;
        let (linear, norm) = (self.linear.clone(), self.norm.clone());
        Ok((Self { conv: Conv::LowRank(conv), linear, norm }, kept))
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
        let map = cloud.kernel_map(KERNEL).map_err(candle_core::Error::wrap)?;
        // Rows are as large as memory gets: each is given up as soon as nothing reads it.
        let read = input.as_ref().unwrap_or(x);
        let mut y = match &self.conv {
            Conv::Full(conv) => conv.forward(read, map)?,
            Conv::LowRank(conv) => conv.forward(read, &map)?,
            Conv::Waiting(..) => {
                bail!("sparse_conv: its rank needs an example of the input (Backbone::calibrated)")
            }
        };
        drop(input);
        if let Some(linear) = &self.linear {
            y = linear.forward(&y)?;
        }
        self.norm.forward_residual(&y, Some(x))
    }
}

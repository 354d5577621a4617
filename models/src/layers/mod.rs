//! Trainable layers with gradients (candle's own norms have none) and a packed form for inference.

mod attention_mlp;
mod batch_norm;
mod cell_pooling;
mod drop_path;
mod layer_norm;
pub(crate) mod linear;
mod linear_norm;
mod linear_norm_relu;
mod low_rank_conv;
mod mlp;
mod norm;
mod residual_conv;
pub(crate) mod sparse_conv;

pub(crate) use attention_mlp::{AttentionMlp, recomputed};
pub use batch_norm::{BatchNorm, BatchNormConstants, StatisticsUpdate, record_statistics};
pub(crate) use cell_pooling::CellPooling;
pub use drop_path::DropPath;
pub use layer_norm::LayerNorm;
pub use linear::Linear;
pub use linear_norm::LinearNorm;
pub(crate) use linear_norm_relu::{Encoding, LinearNormRelu, batch_norm};
pub use mlp::Mlp;
pub(crate) use norm::Norm;
pub use norm::NormKind;
pub use residual_conv::ResidualConv;
pub use sparse_conv::SparseConv;

use crate::device::off_host;
use candle_core::{Result, Tensor};

/// Whether a layer keeps its parameters as tensors: they are trained, or on a device, where nothing is packed.
pub(crate) fn stays_tensor(parameter: &Tensor) -> bool {
    parameter.is_variable() || off_host(parameter.device())
}

/// The values of a parameter vector.
pub(crate) fn vector(t: &Tensor) -> Result<Vec<f32>> {
    t.to_vec1::<f32>()
}

/// `x + residual` for tensors that may want gradients.
pub(crate) fn add(x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
    match residual {
        Some(r) => crate::ops::add_scaled_rows(x, None, r),
        None => Ok(x.clone()),
    }
}

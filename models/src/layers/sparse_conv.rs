//! Submanifold convolution layer.

use super::vector;
use crate::ops;
use candle_core::{Result, Tensor};
use candle_nn::{Init, VarBuilder};
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::sparse_conv::PackedConv;
use std::sync::Arc;

/// Submanifold convolution with a cubic kernel, weights `[out, k, k, k, in]`.
#[derive(Debug, Clone)]
pub struct SparseConv {
    kernel_size: usize,
    form: Form,
}

#[derive(Debug, Clone)]
enum Form {
    Trainable { weight: Tensor, bias: Option<Tensor> },
    Frozen { weight: PackedConv, bias: Option<Vec<f32>> },
}

impl SparseConv {
    /// Parameters `weight` and, if asked for, `bias`; uniform in ±1/√(in·k³).
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(
        cin: usize,
        cout: usize,
        kernel_size: usize,
        bias: bool,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let k = kernel_size;
        let bound = 1.0 / ((cin * k.pow(3)) as f64).sqrt();
        let init = Init::Uniform { lo: -bound, up: bound };
        let weight = vb.get_with_hints((cout, k, k, k, cin), "weight", init)?;
        let bias = bias.then(|| vb.get_with_hints(cout, "bias", init)).transpose()?;
        let form = if weight.is_variable() {
            Form::Trainable { weight, bias }
        } else {
            let weight =
                ops::read("sparse_conv", &weight, |w| Ok(PackedConv::new(w, cin, cout, k.pow(3))))?;
            Form::Frozen { weight, bias: bias.as_ref().map(vector).transpose()? }
        };
        Ok(Self { kernel_size, form })
    }

    /// Taps along one axis.
    pub fn kernel_size(&self) -> usize {
        self.kernel_size
    }

    /// `[N, in] → [N, out]`
    ///
    /// # Errors
    /// If the input does not fit the map.
    pub fn forward(&self, x: &Tensor, map: Arc<KernelMap>) -> Result<Tensor> {
        match &self.form {
            Form::Trainable { weight, bias } => ops::sparse_conv(x, weight, bias.as_ref(), map),
            Form::Frozen { weight, bias } => {
                ops::sparse_conv_frozen(x, weight, bias.as_deref(), &map)
            }
        }
    }
}

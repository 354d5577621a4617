//! Submanifold convolution layer.

use super::low_rank_conv::PlainConv;
use super::{Linear, stays_tensor, vector};
use crate::device::off_host;
use crate::{Compute, ops};
use candle_core::{Result, Tensor, bail};
use candle_nn::{Init, VarBuilder};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm};
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
    Tensors { weight: Tensor, bias: Option<Tensor>, precision: Precision },
    Frozen { weight: PackedConv, bias: Option<Vec<f32>> },
}

impl SparseConv {
    /// Parameters `weight` and, if asked for, `bias`; uniform in ±1/√(in·k³).
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn new(
        compute: Compute,
        cin: usize,
        cout: usize,
        kernel_size: usize,
        bias: bool,
        vb: VarBuilder<'_>,
    ) -> Result<Self> {
        let (weight, bias) = parameters(cin, cout, kernel_size, bias, &vb)?;
        Self::of(compute, weight, bias)
    }

    /// The layer with these parameters.
    fn of(compute: Compute, weight: Tensor, bias: Option<Tensor>) -> Result<Self> {
        let (cout, kernel_size, _, _, cin) = weight.dims5()?;
        if stays_tensor(&weight) {
            ops::refuse_training("sparse_conv", compute.precision)?;
            let form = Form::Tensors { weight, bias, precision: compute.precision };
            return Ok(Self { kernel_size, form });
        }
        let bias = bias.as_ref().map(vector).transpose()?;
        ops::read("sparse_conv", &weight, |w| {
            Ok(Self::frozen(compute, w, [cin, cout, kernel_size], bias))
        })
    }

    fn frozen(
        compute: Compute,
        weight: &[f32],
        [cin, cout, kernel_size]: [usize; 3],
        bias: Option<Vec<f32>>,
    ) -> Self {
        let taps = kernel_size.pow(3);
        let weight = PackedConv::with_precision(compute.precision, weight, cin, cout, taps);
        Self { kernel_size, form: Form::Frozen { weight, bias } }
    }

    /// A convolution and the linear layer after it: one convolution with the products of their
    /// weights if both are frozen and may be folded, else the two.
    ///
    /// # Errors
    /// If the parameters exist with another shape.
    pub fn with_linear(
        compute: Compute,
        channels: usize,
        kernel_size: usize,
        conv: VarBuilder<'_>,
        linear: VarBuilder<'_>,
    ) -> Result<(Self, Option<Linear>)> {
        let (inner, outer) = pair(channels, kernel_size, &conv, &linear)?;
        if stays_tensor(&inner.0) || !compute.fold {
            let conv = Self::of(compute, inner.0, inner.1)?;
            return Ok((conv, Some(Linear::of(compute, outer.0, outer.1)?)));
        }
        let (weight, bias) = join(inner, outer, channels, kernel_size)?;
        let shape = [channels, channels, kernel_size];
        Ok((Self::frozen(compute, &weight, shape, Some(bias)), None))
    }

    /// As [`with_linear`](Self::with_linear), of a rank that an example will decide on.
    ///
    /// # Errors
    /// If the parameters exist with another shape, or are to be trained.
    pub(crate) fn plain_with_linear(
        compute: Compute,
        channels: usize,
        kernel_size: usize,
        conv: VarBuilder<'_>,
        linear: VarBuilder<'_>,
    ) -> Result<(PlainConv, Option<Linear>)> {
        let (inner, outer) = pair(channels, kernel_size, &conv, &linear)?;
        if inner.0.is_variable() {
            bail!("sparse_conv: a convolution of low rank cannot be trained");
        }
        if off_host(inner.0.device()) {
            bail!(
                "sparse_conv: a convolution of low rank runs on the CPU only; leave out the rank"
            );
        }
        let shape = [channels, channels, kernel_size.pow(3)];
        if !compute.fold {
            let (weight, bias) = (inner.0.flatten_all()?.to_vec1()?, inner.1);
            let bias = vector_or_zero(bias, channels)?;
            let linear = Linear::of(compute, outer.0, outer.1)?;
            return Ok((PlainConv { weight, bias, shape, compute }, Some(linear)));
        }
        let (weight, bias) = join(inner, outer, channels, kernel_size)?;
        Ok((PlainConv { weight, bias, shape, compute }, None))
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
            Form::Tensors { weight, bias, precision } => {
                ops::sparse_conv_with(*precision, x, weight, bias.as_ref(), map)
            }
            Form::Frozen { weight, bias } => {
                ops::sparse_conv_frozen(x, weight, bias.as_deref(), &map)
            }
        }
    }
}

/// Weight and bias; uniform in ±1/√(in·k³).
pub(crate) fn parameters(
    cin: usize,
    cout: usize,
    k: usize,
    bias: bool,
    vb: &VarBuilder<'_>,
) -> Result<(Tensor, Option<Tensor>)> {
    let bound = 1.0 / ((cin * k.pow(3)) as f64).sqrt();
    let init = Init::Uniform { lo: -bound, up: bound };
    let weight = vb.get_with_hints((cout, k, k, k, cin), "weight", init)?;
    Ok((weight, bias.then(|| vb.get_with_hints(cout, "bias", init)).transpose()?))
}

/// A weight with its bias.
pub(crate) type Parameters = (Tensor, Option<Tensor>);

/// Those of a convolution and of the linear layer after it.
fn pair(
    channels: usize,
    kernel_size: usize,
    conv: &VarBuilder<'_>,
    linear: &VarBuilder<'_>,
) -> Result<(Parameters, Parameters)> {
    let inner = parameters(channels, channels, kernel_size, true, conv)?;
    Ok((inner, super::linear::parameters(channels, channels, true, linear)?))
}

/// One convolution that is both: the products of their weights, `[c, taps, c]`, and its bias.
pub(crate) fn join(
    (weight, bias): Parameters,
    (outer, outer_bias): Parameters,
    c: usize,
    kernel_size: usize,
) -> Result<(Vec<f32>, Vec<f32>)> {
    let (bias, outer_bias) = (vector_or_zero(bias, c)?, vector_or_zero(outer_bias, c)?);
    let taps = kernel_size.pow(3);
    ops::read("sparse_conv", &weight, |weight| {
        ops::read("linear", &outer, |outer| {
            // outer: [c, c], weight: [c, taps·c]
            let inner = PackedMatrix::from_strided(weight, c, taps * c, taps * c, 1);
            let mut joined = vec![0.0; weight.len()];
            gemm(outer, &inner, Epilogue::default(), &mut joined);
            let inner_bias = |row: &[f32]| -> f64 {
                row.iter().zip(&bias).map(|(w, b)| f64::from(*w) * f64::from(*b)).sum()
            };
            let bias = outer.chunks_exact(c).zip(&outer_bias);
            let bias = bias.map(|(row, b)| (inner_bias(row) + f64::from(*b)) as f32).collect();
            Ok((joined, bias))
        })
    })
}

fn vector_or_zero(bias: Option<Tensor>, channels: usize) -> Result<Vec<f32>> {
    bias.map_or_else(|| Ok(vec![0.0; channels]), |b| vector(&b))
}

//! Linear layers.

use super::add_bias::add_bias;
use super::{Array, Operation, apply, check_shape, frozen, refuse_training, unwritten};
use crate::device::off_host;
use candle_core::{DType, Result, Shape, Tensor, bail};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn_with, gemm_unit_rows, mlp};
use scenesplat_kernels::sparse_conv::backward_bias;

struct Linear(Precision);

impl Operation for Linear {
    const NAME: &'static str = "linear";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (n, k) = inputs[1].dims2()?;
        Ok((rows(inputs[0], n, k)?, n).into())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let ((x, dims), (w, of_weight)) = (inputs[0], inputs[1]);
        let [n, k] = [of_weight[0], of_weight[1]];
        let packed = PackedMatrix::from_strided_with(self.0, w, k, n, 1, k);
        // SAFETY: the kernel writes all of it and reads none before.
        let mut out = unsafe { unwritten(dims[0] * n) };
        let bias = inputs.get(2).map(|(bias, _)| *bias);
        gemm(x, &packed, Epilogue { bias, ..Epilogue::default() }, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let ((x, _), (w, of_weight)) = (inputs[0], inputs[1]);
        let [n, k] = [of_weight[0], of_weight[1]];
        let (mut dx, mut dw) = (vec![0.0; x.len()], vec![0.0; w.len()]);
        let packed = PackedMatrix::from_strided_with(self.0, w, n, k, k, 1);
        gemm(grad, &packed, Epilogue::default(), &mut dx);
        gemm_tn_with(self.0, grad, n, x, k, None, &mut dw);
        let mut found = vec![dx, dw];
        found.extend((inputs.len() > 2).then(|| backward_bias(grad, n)));
        Ok(found)
    }
}

/// Rows of an input that fits a weight `[n, k]`.
fn rows(x: &Shape, n: usize, k: usize) -> Result<usize> {
    let (m, width) = x.dims2()?;
    if width != k {
        bail!("linear: input [{m}, {width}] does not fit weight [{n}, {k}]");
    }
    Ok(m)
}

/// `x · Wᵀ + b`.
///
/// # Shapes
/// `x`: `[N, in]` · `weight`: `[out, in]` · `bias`: `[out]` · returns `[N, out]`
///
/// # Errors
/// If shapes do not fit or a tensor is not f32.
pub fn linear(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>) -> Result<Tensor> {
    linear_with(Precision::F32, x, weight, bias)
}

/// [`linear`] with operands in another precision, in the gradients too. Results are f32.
///
/// # Errors
/// As [`linear`], or if the precision has no gradient.
pub fn linear_with(
    precision: Precision,
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
) -> Result<Tensor> {
    refuse_training("linear", precision)?;
    if off_host(x.device()) {
        return by_matmul(precision, x, weight, bias);
    }
    let inputs: Vec<&Tensor> = [x, weight].into_iter().chain(bias).collect();
    apply(Linear(precision), &inputs)
}

/// As [`linear_with`] by candle's own product, which is the device's library's, and its gradients.
fn by_matmul(
    precision: Precision,
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
) -> Result<Tensor> {
    let (n, k) = weight.dims2()?;
    rows(x.shape(), n, k)?;
    let dtype = if precision == Precision::Bf16 { DType::BF16 } else { DType::F32 };
    let product = x.to_dtype(dtype)?.matmul(&weight.to_dtype(dtype)?.t()?)?.to_dtype(DType::F32)?;
    match bias {
        Some(bias) => add_bias(&product, bias),
        None => Ok(product),
    }
}

/// `x · Wᵀ + b`, the GELU of that if asked for, plus a residual if given, with packed weights.
///
/// # Errors
/// If shapes do not fit or an input requires a gradient.
pub fn linear_frozen(
    x: &Tensor,
    weight: &PackedMatrix,
    bias: Option<&[f32]>,
    gelu: bool,
    residual: Option<&Tensor>,
) -> Result<Tensor> {
    let shape = [rows(x.shape(), weight.n(), weight.k())?, weight.n()];
    check_shape("linear", residual, shape)?;
    // SAFETY: the kernel writes all of it and reads none before.
    unsafe {
        frozen("linear", x, residual, shape.as_slice(), |x, residual, out| {
            gemm(x, weight, Epilogue { bias, gelu, residual }, out);
        })
    }
}

/// `x · Wᵀ + b` at unit length, with packed weights: [`l2_normalize`](super::l2_normalize) of [`linear_frozen`], without the
/// rows in between.
///
/// # Errors
/// If shapes do not fit or `x` requires a gradient.
pub fn linear_unit_frozen(
    x: &Tensor,
    weight: &PackedMatrix,
    bias: Option<&[f32]>,
) -> Result<Tensor> {
    let shape = (rows(x.shape(), weight.n(), weight.k())?, weight.n());
    // SAFETY: the kernel writes all of it and reads none before.
    unsafe { frozen("linear", x, None, shape, |x, _, out| gemm_unit_rows(x, weight, bias, out)) }
}

/// `residual + W₂ · gelu(W₁ · x + b₁) + b₂` with packed weights, block of rows by block of rows.
///
/// # Errors
/// If shapes do not fit or an input requires a gradient.
pub fn mlp_frozen(
    x: &Tensor,
    first: (&PackedMatrix, &[f32]),
    second: (&PackedMatrix, &[f32]),
    residual: &Tensor,
) -> Result<Tensor> {
    let (m, k) = x.dims2()?;
    let shape = [m, second.0.n()];
    check_shape("mlp", Some(residual), shape)?;
    if k != first.0.k() {
        bail!("mlp: input [{m}, {k}] does not fit weight [{}, {}]", first.0.n(), first.0.k());
    }
    // SAFETY: the kernel writes all of it and reads none before.
    unsafe {
        frozen("mlp", x, Some(residual), shape.as_slice(), |x, residual, out| {
            mlp(x, first, second.0, Epilogue { bias: Some(second.1), gelu: false, residual }, out);
        })
    }
}

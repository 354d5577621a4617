//! Linear layers.

use super::add_bias::add_bias;
use super::{
    Pass, check_residual, cpu_slice, forward_on_device, here, make, make_unwritten, read,
    refuse_gradient, refuse_training, unwritten,
};
use crate::device::off_host;
use candle_core::{CpuStorage, CustomOp2, CustomOp3, DType, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn_with, gemm_unit_rows, mlp};
use scenesplat_kernels::sparse_conv::backward_bias;

struct Linear(Precision);

fn forward(
    precision: Precision,
    x: (&CpuStorage, &Layout),
    w: (&CpuStorage, &Layout),
    bias: Option<&[f32]>,
) -> Result<(CpuStorage, Shape)> {
    let (m, k) = x.1.shape().dims2()?;
    let (n, k2) = w.1.shape().dims2()?;
    if k != k2 {
        bail!("linear: input [{m}, {k}] does not fit weight [{n}, {k2}]");
    }
    let x = cpu_slice("linear", x.0, x.1)?;
    let w = cpu_slice("linear", w.0, w.1)?;
    let packed = PackedMatrix::from_strided_with(precision, w, k, n, 1, k);
    // SAFETY: the kernel writes all of it and reads none before.
    let mut out = unsafe { unwritten(m * n) };
    gemm(x, &packed, Epilogue { bias, ..Epilogue::default() }, &mut out);
    Ok((CpuStorage::F32(out), (m, n).into()))
}

fn backward(
    precision: Precision,
    x: &Tensor,
    w: &Tensor,
    grad: &Tensor,
) -> Result<(Tensor, Tensor, Tensor)> {
    let (m, k) = x.dims2()?;
    let n = w.dim(0)?;
    let device = here("linear", Pass::Backward, x);
    let dx = read("linear", grad, |g| {
        read("linear", w, |w| {
            make(device, (m, k), |out| {
                let packed = PackedMatrix::from_strided_with(precision, w, n, k, k, 1);
                gemm(g, &packed, Epilogue::default(), out);
            })
        })
    })?;
    let dw = read("linear", grad, |g| {
        read("linear", x, |x| {
            make(device, (n, k), |out| gemm_tn_with(precision, g, n, x, k, None, out))
        })
    })?;
    let db =
        read("linear", grad, |g| make(device, n, |out| out.copy_from_slice(&backward_bias(g, n))))?;
    Ok((dx, dw, db))
}

impl CustomOp3 for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }
    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        forward(self.0, (s1, l1), (s2, l2), Some(cpu_slice("linear", s3, l3)?))
    }
    forward_on_device!(CustomOp3);
    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        _: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (dx, dw, db) = backward(self.0, x, w, grad)?;
        Ok((Some(dx), Some(dw), Some(db)))
    }
}

impl CustomOp2 for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }
    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        forward(self.0, (s1, l1), (s2, l2), None)
    }
    forward_on_device!(CustomOp2);
    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (dx, dw, _) = backward(self.0, x, w, grad)?;
        Ok((Some(dx), Some(dw)))
    }
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
    let x = x.contiguous()?;
    match bias {
        Some(bias) => x.apply_op3(weight, bias, Linear(precision)),
        None => x.apply_op2(weight, Linear(precision)),
    }
}

/// As [`linear_with`] by candle's own product, which is the device's library's, and its gradients.
fn by_matmul(
    precision: Precision,
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
) -> Result<Tensor> {
    let ((m, k), (n, k2)) = (x.dims2()?, weight.dims2()?);
    if k != k2 {
        bail!("linear: input [{m}, {k}] does not fit weight [{n}, {k2}]");
    }
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
/// If shapes do not fit or `x` wants a gradient.
pub fn linear_frozen(
    x: &Tensor,
    weight: &PackedMatrix,
    bias: Option<&[f32]>,
    gelu: bool,
    residual: Option<&Tensor>,
) -> Result<Tensor> {
    refuse_gradient("linear", x)?;
    let (m, k) = x.dims2()?;
    if let Some(r) = residual {
        check_residual("linear", r, [m, weight.n()])?;
    }
    if k != weight.k() {
        bail!("linear: input [{m}, {k}] does not fit weight [{}, {}]", weight.n(), weight.k());
    }
    let device = here("linear", Pass::Forward, x);
    read("linear", x, |x| {
        let run = |residual: Option<&[f32]>| {
            let fill = |out: &mut [f32]| gemm(x, weight, Epilogue { bias, gelu, residual }, out);
            // SAFETY: the kernel writes all of it and reads none before.
            unsafe { make_unwritten(device, (m, weight.n()), fill) }
        };
        match residual {
            Some(r) => read("linear", r, |r| run(Some(r))),
            None => run(None),
        }
    })
}

/// `x · Wᵀ + b` at unit length, with packed weights: what [`l2_normalize`](super::l2_normalize) makes
/// of [`linear_frozen`], without the rows in between.
///
/// # Errors
/// If shapes do not fit or `x` wants a gradient.
pub fn linear_unit_frozen(
    x: &Tensor,
    weight: &PackedMatrix,
    bias: Option<&[f32]>,
) -> Result<Tensor> {
    refuse_gradient("linear", x)?;
    let (m, k) = x.dims2()?;
    if k != weight.k() {
        bail!("linear: input [{m}, {k}] does not fit weight [{}, {}]", weight.n(), weight.k());
    }
    let device = here("linear", Pass::Forward, x);
    read("linear", x, |x| {
        // SAFETY: the kernel writes all of it and reads none before.
        unsafe {
            make_unwritten(device, (m, weight.n()), |out| gemm_unit_rows(x, weight, bias, out))
        }
    })
}

/// `residual + W₂ · gelu(W₁ · x + b₁) + b₂` with packed weights, block of rows by block of rows.
///
/// # Errors
/// If shapes do not fit or `x` wants a gradient.
pub fn mlp_frozen(
    x: &Tensor,
    first: (&PackedMatrix, &[f32]),
    second: (&PackedMatrix, &[f32]),
    residual: &Tensor,
) -> Result<Tensor> {
    refuse_gradient("mlp", x)?;
    let (m, k) = x.dims2()?;
    let n = second.0.n();
    check_residual("mlp", residual, [m, n])?;
    if k != first.0.k() {
        bail!("mlp: input [{m}, {k}] does not fit weight [{}, {}]", first.0.n(), first.0.k());
    }
    let device = here("mlp", Pass::Forward, x);
    read("mlp", x, |x| {
        read("mlp", residual, |residual| {
            let epilogue = Epilogue { bias: Some(second.1), gelu: false, residual: Some(residual) };
            // SAFETY: the kernel writes all of it and reads none before.
            unsafe { make_unwritten(device, (m, n), |out| mlp(x, first, second.0, epilogue, out)) }
        })
    })
}

//! The exact GELU.

use super::{cpu_slice, make, read};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use scenesplat_kernels::activation::{gelu_backward, gelu_forward};

struct Gelu;

impl CustomOp1 for Gelu {
    fn name(&self) -> &'static str {
        "gelu"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let x = cpu_slice("gelu", s, l)?;
        let mut out = vec![0f32; x.len()];
        gelu_forward(x, &mut out);
        Ok((CpuStorage::F32(out), l.shape().clone()))
    }
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let shape = x.shape().clone();
        read("gelu", x, |x| read("gelu", grad, |g| make(shape, |out| gelu_backward(x, g, out))))
            .map(Some)
    }
}

/// `x · Φ(x)` with the exact normal distribution, any shape.
///
/// # Errors
/// If the tensor is not f32 on the CPU.
pub fn gelu(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(Gelu)
}

//! The exact GELU.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, make, read,
};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use scenesplat_kernels::activation::{gelu_backward, gelu_forward};

struct Gelu;

impl Gelu {
    fn pass(&self, _: [&Layout; 1]) -> Result<Option<launches::Gelu>> {
        Ok(Some(launches::Gelu))
    }
}

impl CustomOp1 for Gelu {
    fn name(&self) -> &'static str {
        "gelu"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s, l)], || self.pass([l]))? {
            return Ok(made);
        }
        let x = cpu_slice("gelu", s, l)?;
        let mut out = vec![0f32; x.len()];
        gelu_forward(x, &mut out);
        Ok((CpuStorage::F32(out), l.shape().clone()))
    }
    forward_on_device!(CustomOp1, pass);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        if let Some(mut made) = launched([x, grad], &launches::GeluBackward)? {
            return Ok(made.pop());
        }
        let (shape, device) = (x.shape().clone(), here("gelu", Pass::Backward, x));
        let gelu_backward =
            |x: &[f32], g: &[f32]| make(device, shape, |out| gelu_backward(x, g, out));
        read("gelu", x, |x| read("gelu", grad, |g| gelu_backward(x, g))).map(Some)
    }
}

/// `x · Φ(x)` with the exact normal distribution, any shape.
///
/// # Errors
/// If the tensor is not f32.
pub fn gelu(x: &Tensor) -> Result<Tensor> {
    if composed::here("gelu", x.device()) {
        return x.gelu_erf();
    }
    x.contiguous()?.apply_op1(Gelu)
}

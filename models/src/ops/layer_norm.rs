//! Layer normalisation.

use super::{
    Pass, check_residual, composed, cpu_slice, emulated, forward_on_device, here, launched,
    launches, make, make_unwritten, read, refuse_gradient, unwritten,
};
use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::layer_norm::{backward, forward};

struct LayerNorm {
    eps: f32,
}

impl LayerNorm {
    fn pass(&self, [x, weight, _]: [&Layout; 3]) -> Result<Option<launches::LayerNorm>> {
        check(x.shape(), weight.shape().elem_count())?;
        Ok(Some(launches::LayerNorm { eps: self.eps }))
    }
}

impl CustomOp3 for LayerNorm {
    fn name(&self) -> &'static str {
        "layer_norm"
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
        let inputs = [(s1, l1), (s2, l2), (s3, l3)];
        if let Some(made) = emulated(inputs, || self.pass([l1, l2, l3]))? {
            return Ok(made);
        }
        let x = cpu_slice("layer_norm", s1, l1)?;
        let weight = cpu_slice("layer_norm", s2, l2)?;
        let bias = cpu_slice("layer_norm", s3, l3)?;
        check(l1.shape(), weight.len())?;
        // SAFETY: the kernel writes all of it and reads none before.
        let mut out = unsafe { unwritten(x.len()) };
        forward(x, None, weight, bias, self.eps, &mut out);
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }
    forward_on_device!(CustomOp3, pass);
    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let pass = launches::LayerNormBackward { eps: self.eps };
        if let Some(made) = launched([x, weight, grad], &pass)? {
            let of = |i: usize| made[1].get(i).and_then(|t| t.contiguous());
            return Ok((Some(made[0].clone()), Some(of(0)?), Some(of(1)?)));
        }
        let (shape, device) = (x.shape().clone(), here("layer_norm", Pass::Backward, x));
        let mut parameters = (Vec::new(), Vec::new());
        let dx = read("layer_norm", x, |x| {
            read("layer_norm", grad, |g| {
                read("layer_norm", weight, |w| {
                    make(device, shape, |dx| parameters = backward(x, g, w, self.eps, dx))
                })
            })
        })?;
        let c = weight.elem_count();
        let vector = |v: Vec<f32>| Tensor::from_vec(v, c, device);
        Ok((Some(dx), Some(vector(parameters.0)?), Some(vector(parameters.1)?)))
    }
}

fn check(shape: &Shape, channels: usize) -> Result<()> {
    let (_, c) = shape.dims2()?;
    if c != channels {
        bail!("layer_norm: input {shape:?} does not fit {channels} channels");
    }
    Ok(())
}

/// `(x − mean) / √(var + ε) · weight + bias` over the channels of each row.
///
/// # Shapes
/// `x`: `[N, C]` · `weight`, `bias`: `[C]` · returns `[N, C]`
///
/// # Errors
/// If shapes do not fit or a tensor is not f32.
pub fn layer_norm(x: &Tensor, weight: &Tensor, bias: &Tensor, eps: f32) -> Result<Tensor> {
    if composed::here("layer_norm", x.device()) {
        check(x.shape(), weight.elem_count())?;
        return composed::layer_norm(x, weight, bias, f64::from(eps));
    }
    x.contiguous()?.apply_op3(weight, bias, LayerNorm { eps })
}

/// [`layer_norm`] plus a residual, without gradient.
///
/// # Errors
/// If shapes do not fit or `x` wants a gradient.
pub fn layer_norm_frozen(
    x: &Tensor,
    weight: &[f32],
    bias: &[f32],
    eps: f32,
    residual: Option<&Tensor>,
) -> Result<Tensor> {
    refuse_gradient("layer_norm", x)?;
    check(x.shape(), weight.len())?;
    if let Some(r) = residual {
        check_residual("layer_norm", r, [x.dim(0)?, weight.len()])?;
    }
    let (shape, device) = (x.shape().clone(), here("layer_norm", Pass::Forward, x));
    let run = |x: &[f32], residual: Option<&[f32]>| {
        // SAFETY: the kernel writes all of it and reads none before.
        unsafe { make_unwritten(device, shape, |out| forward(x, residual, weight, bias, eps, out)) }
    };
    read("layer_norm", x, |x| match residual {
        Some(r) => read("layer_norm", r, |r| run(x, Some(r))),
        None => run(x, None),
    })
}

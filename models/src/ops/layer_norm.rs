//! Layer normalization.

use super::{Array, Operation, apply, check_shape, frozen, gradients, unwritten};
use crate::device::launches::{Input, Launched, matrix, room};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::{Launcher, ops};
use scenesplat_kernels::layer_norm::{backward, forward};

struct LayerNorm {
    eps: f32,
}

impl Operation for LayerNorm {
    const NAME: &'static str = "layer_norm";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        check(inputs[0], inputs[1].elem_count())?;
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (x, weight, bias) = (inputs[0].0, inputs[1].0, inputs[2].0);
        // SAFETY: the kernel writes all of it and reads none before.
        let mut out = unsafe { unwritten(x.len()) };
        forward(x, None, weight, bias, self.eps, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let (x, weight) = (inputs[0].0, inputs[1].0);
        let mut dx = vec![0.0; x.len()];
        let (of_weight, of_bias) = backward(x, grad, weight, self.eps, &mut dx);
        Ok(vec![dx, of_weight, of_bias])
    }
    fn gradients(&self, inputs: &[&Tensor], grad: &Tensor) -> Result<Vec<Tensor>> {
        let found = gradients(self, inputs, grad)?;
        // Kernels give weight and bias as one array.
        let [dx, both] = &found[..] else { return Ok(found) };
        Ok(vec![dx.clone(), both.get(0)?.contiguous()?, both.get(1)?.contiguous()?])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((x, dims), (weight, _), (bias, _)) = (inputs[0], inputs[1], inputs[2]);
        let (n, c) = matrix::<L>(dims)?;
        let mut out = room(l, dims)?;
        ops::layer_norm::forward(l, x, None, weight, bias, n, c, self.eps, &mut out)?;
        Ok(Some(vec![(out, dims.into())]))
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((x, dims), (weight, _), (grad, _)) = (inputs[0], inputs[1], inputs[3]);
        let (n, c) = matrix::<L>(dims)?;
        let mut dx = room(l, dims)?;
        let both = ops::layer_norm::backward(l, x, grad, weight, n, c, self.eps, &mut dx)?;
        Ok(Some(vec![(dx, dims.into()), (both, (2, c as usize).into())]))
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
    apply(LayerNorm { eps }, &[x, weight, bias])
}

/// [`layer_norm`] plus a residual, without gradient.
///
/// # Errors
/// If shapes do not fit or an input requires a gradient.
pub fn layer_norm_frozen(
    x: &Tensor,
    weight: &[f32],
    bias: &[f32],
    eps: f32,
    residual: Option<&Tensor>,
) -> Result<Tensor> {
    check(x.shape(), weight.len())?;
    check_shape("layer_norm", residual, [x.dim(0)?, weight.len()])?;
    // SAFETY: the kernel writes all of it and reads none before.
    unsafe {
        frozen("layer_norm", x, residual, x.shape(), |x, residual, out| {
            forward(x, residual, weight, bias, eps, out);
        })
    }
}

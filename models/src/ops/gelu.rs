//! The exact GELU.

use super::{Array, Operation, apply};
use crate::device::launches::{Input, Launched, room};
use candle_core::{Result, Shape, Tensor};
use scenesplat_device::{Launcher, ops};
use scenesplat_kernels::activation::{gelu_backward, gelu_forward};

struct Gelu;

impl Operation for Gelu {
    const NAME: &'static str = "gelu";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let mut out = vec![0.0; inputs[0].0.len()];
        gelu_forward(inputs[0].0, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let mut dx = vec![0.0; grad.len()];
        gelu_backward(inputs[0].0, grad, &mut dx);
        Ok(vec![dx])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let (x, dims) = inputs[0];
        let mut out = room(l, dims)?;
        ops::activation::gelu(l, x, dims.iter().product::<usize>() as u64, &mut out)?;
        Ok(Some(vec![(out, dims.into())]))
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let (grad, dims) = inputs[1];
        let mut dx = room(l, dims)?;
        let count = dims.iter().product::<usize>() as u64;
        ops::activation::gelu_backward(l, inputs[0].0, grad, count, &mut dx)?;
        Ok(Some(vec![(dx, dims.into())]))
    }
}

/// `x · Φ(x)` with the exact normal distribution, any shape.
///
/// # Errors
/// If the tensor is not f32.
pub fn gelu(x: &Tensor) -> Result<Tensor> {
    apply(Gelu, &[x])
}

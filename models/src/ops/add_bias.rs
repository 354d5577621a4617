//! A bias for every row, of layers whose product is the device's library's.

use super::{Array, Operation, apply, gradients};
use crate::device::launches::{Input, Launched, matrix, room};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::{Launcher, ops};
use scenesplat_kernels::sparse_conv::backward_bias;

struct AddBias;

impl Operation for AddBias {
    const NAME: &'static str = "add_bias";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (_, c) = inputs[0].dims2()?;
        if inputs[1].dims() != [c] {
            bail!("add_bias: rows {:?} do not fit a bias {:?}", inputs[0], inputs[1]);
        }
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (mut out, bias) = (inputs[0].0.to_vec(), inputs[1].0);
        for row in out.chunks_exact_mut(bias.len().max(1)) {
            row.iter_mut().zip(bias).for_each(|(v, b)| *v += b);
        }
        Ok(out)
    }
    fn gradients(&self, inputs: &[&Tensor], grad: &Tensor) -> Result<Vec<Tensor>> {
        Ok([vec![grad.clone()], gradients(self, &inputs[1..], grad)?].concat())
    }
    /// Of the bias alone.
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        Ok(vec![backward_bias(grad, inputs[0].0.len())])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((x, dims), (bias, _)) = (inputs[0], inputs[1]);
        let (n, c) = matrix::<L>(dims)?;
        let ones = l.upload_values(&vec![1_f32; c as usize])?;
        let mut out = room(l, dims)?;
        ops::batch_norm::apply(l, x, &ones, bias, n, c, false, &mut out)?;
        Ok(Some(vec![(out, dims.into())]))
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((_, of_bias), (grad, dims)) = (inputs[0], inputs[1]);
        let (n, c) = matrix::<L>(dims)?;
        let mut sums = room(l, of_bias)?;
        ops::columns::column_sums(l, grad, n, c, &mut sums)?;
        Ok(Some(vec![(sums, of_bias.into())]))
    }
}

/// `x + bias`. Thousands of rows are added up for the gradient of the bias, in f64.
///
/// # Shapes
/// `x`: `[N, C]` · `bias`: `[C]` · returns `[N, C]`
///
/// # Errors
/// If shapes do not fit or a tensor is not f32.
pub(super) fn add_bias(x: &Tensor, bias: &Tensor) -> Result<Tensor> {
    apply(AddBias, &[x, bias])
}

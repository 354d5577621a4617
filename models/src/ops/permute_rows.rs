//! A permutation of rows whose backward pass is the gather by the inverse.

use super::{Array, Operation, apply, gather_launch};
use crate::device::launches::{Input, Launched};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::Launcher;
use scenesplat_kernels::permute::gather_rows;
use std::sync::Arc;

struct PermuteRows {
    order: Arc<Vec<u32>>,
    inverse: Arc<Vec<u32>>,
}

impl Operation for PermuteRows {
    const NAME: &'static str = "permute_rows";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        if inputs[0].dims2()?.0 != self.order.len() {
            bail!("permute_rows: expected {} rows, got {:?}", self.order.len(), inputs[0]);
        }
        Ok(inputs[0].clone())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (x, dims) = inputs[0];
        let mut out = vec![0.0; x.len()];
        gather_rows(x, dims[1], &self.order, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let mut dx = vec![0.0; grad.len()];
        gather_rows(grad, inputs[0].1[1], &self.inverse, &mut dx);
        Ok(vec![dx])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        gather_launch(l, inputs[0], &self.order)
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        gather_launch(l, inputs[1], &self.inverse)
    }
}

/// `out[i] = x[order[i]]`, where `order` is a permutation and `inverse` its inverse.
///
/// # Shapes
/// `x`: `[N, C]` · `order`, `inverse`: `[N]` · returns `[N, C]`
///
/// # Errors
/// If shapes do not fit or the tensor is not f32.
pub fn permute_rows(x: &Tensor, order: Arc<Vec<u32>>, inverse: Arc<Vec<u32>>) -> Result<Tensor> {
    apply(PermuteRows { order, inverse }, &[x])
}

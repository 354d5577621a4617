//! Pooling of groups of rows, and its counterpart.

use super::{Array, Operation, apply, gather_launch};
use crate::device::launches::{Input, Launched, Uploaded, matrix, narrow, room};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::{Launcher, ops::segment as device};
use scenesplat_kernels::permute::gather_rows;
use scenesplat_kernels::segment::{Groups, Reduce, reduce, reduce_backward};
use std::sync::Arc;

struct SegmentReduce {
    groups: Arc<Groups>,
    how: Reduce,
}

/// Groups on a device.
struct OnDevice<B> {
    rows: B,
    offsets: B,
    inverse: B,
    num_rows: u32,
    num_groups: u32,
}

impl<B> OnDevice<B> {
    fn new<L: Launcher<Buffer = B>>(l: &L, groups: &Groups) -> Uploaded<L, Self> {
        Ok(Self {
            rows: l.upload_values(groups.rows())?,
            offsets: l.upload_values(groups.offsets())?,
            inverse: l.upload_values(groups.inverse())?,
            num_rows: narrow::<L>(groups.rows().len())?,
            num_groups: narrow::<L>(groups.len())?,
        })
    }

    fn view(&self) -> device::Groups<'_, B> {
        let Self { rows, offsets, inverse, num_rows, num_groups } = self;
        device::Groups { rows, offsets, inverse, num_rows: *num_rows, num_groups: *num_groups }
    }
}

fn on_device(how: Reduce) -> device::Reduce {
    match how {
        Reduce::Sum => device::Reduce::Sum,
        Reduce::Mean => device::Reduce::Mean,
        Reduce::Max => device::Reduce::Max,
    }
}

fn reduced<L: Launcher>(
    l: &L,
    (x, dims): Input<'_, L>,
    groups: &Groups,
    how: Reduce,
) -> Launched<L> {
    let (_, c) = matrix::<L>(dims)?;
    let uploaded = OnDevice::new(l, groups)?;
    let shape = [groups.len(), c as usize];
    let mut out = room(l, &shape)?;
    device::reduce(l, x, c, uploaded.view(), on_device(how), &mut out)?;
    Ok(Some(vec![(out, shape.as_slice().into())]))
}

impl Operation for SegmentReduce {
    const NAME: &'static str = "segment_reduce";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (n, c) = inputs[0].dims2()?;
        if n != self.groups.rows().len() {
            bail!("segment_reduce: expected {} rows, got {n}", self.groups.rows().len());
        }
        Ok((self.groups.len(), c).into())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (x, dims) = inputs[0];
        let mut out = vec![0.0; self.groups.len() * dims[1]];
        reduce(x, dims[1], &self.groups, self.how, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let (x, dims) = inputs[0];
        let mut dx = vec![0.0; x.len()];
        reduce_backward(x, dims[1], &self.groups, self.how, grad, &mut dx);
        Ok(vec![dx])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        reduced(l, inputs[0], &self.groups, self.how)
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((x, dims), (grad, _)) = (inputs[0], inputs[1]);
        let (_, c) = matrix::<L>(dims)?;
        let groups = OnDevice::new(l, &self.groups)?;
        let mut dx = room(l, dims)?;
        device::reduce_backward(l, x, c, groups.view(), on_device(self.how), grad, &mut dx)?;
        Ok(Some(vec![(dx, dims.into())]))
    }
}

/// Reduces each group of rows to one. `x`: `[N, C]` → `[G, C]`
///
/// # Errors
/// If the row count differs from the groups' or the tensor is not f32.
pub fn segment_reduce(x: &Tensor, groups: Arc<Groups>, how: Reduce) -> Result<Tensor> {
    apply(SegmentReduce { groups, how }, &[x])
}

struct ExpandGroups {
    groups: Arc<Groups>,
}

impl Operation for ExpandGroups {
    const NAME: &'static str = "expand_groups";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (g, c) = inputs[0].dims2()?;
        if g != self.groups.len() {
            bail!("expand_groups: expected {} rows, got {g}", self.groups.len());
        }
        Ok((self.groups.inverse().len(), c).into())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let (x, dims) = inputs[0];
        let mut out = vec![0.0; self.groups.inverse().len() * dims[1]];
        gather_rows(x, dims[1], self.groups.inverse(), &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let (x, dims) = inputs[0];
        let mut dx = vec![0.0; x.len()];
        reduce(grad, dims[1], &self.groups, Reduce::Sum, &mut dx);
        Ok(vec![dx])
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        gather_launch(l, inputs[0], self.groups.inverse())
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        reduced(l, inputs[1], &self.groups, Reduce::Sum)
    }
}

/// Gives every row the row of its group. `x`: `[G, C]` → `[N, C]`
///
/// # Errors
/// If the row count differs from the number of groups or the tensor is not f32.
pub fn expand_groups(x: &Tensor, groups: Arc<Groups>) -> Result<Tensor> {
    apply(ExpandGroups { groups }, &[x])
}

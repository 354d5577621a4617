//! Pooling of groups of rows, and its counterpart.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, make, read,
};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::permute::gather_rows;
use scenesplat_kernels::segment::{Groups, Reduce, reduce, reduce_backward};
use std::sync::Arc;

struct SegmentReduce {
    groups: Arc<Groups>,
    how: Reduce,
}

impl SegmentReduce {
    fn check(&self, l: &Layout) -> Result<usize> {
        let (n, c) = l.shape().dims2()?;
        if n != self.groups.rows().len() {
            bail!("segment_reduce: expected {} rows, got {n}", self.groups.rows().len());
        }
        Ok(c)
    }

    fn pass(&self, [x]: [&Layout; 1]) -> Result<Option<launches::SegmentReduce<'_>>> {
        self.check(x)?;
        Ok(Some(launches::SegmentReduce { groups: &self.groups, how: self.how }))
    }
}

impl CustomOp1 for SegmentReduce {
    fn name(&self) -> &'static str {
        "segment_reduce"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s, l)], || self.pass([l]))? {
            return Ok(made);
        }
        let c = self.check(l)?;
        let mut out = vec![0f32; self.groups.len() * c];
        reduce(cpu_slice("segment_reduce", s, l)?, c, &self.groups, self.how, &mut out);
        Ok((CpuStorage::F32(out), (self.groups.len(), c).into()))
    }
    forward_on_device!(CustomOp1, pass);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let (n, c) = x.dims2()?;
        let pass = launches::SegmentReduceBackward { groups: &self.groups, how: self.how };
        if let Some(mut made) = launched([x, grad], &pass)? {
            return Ok(made.pop());
        }
        let device = here("segment_reduce", Pass::Backward, x);
        read("segment_reduce", x, |x| {
            read("segment_reduce", grad, |g| {
                make(device, (n, c), |dx| reduce_backward(x, c, &self.groups, self.how, g, dx))
            })
        })
        .map(Some)
    }
}

/// Reduces each group of rows to one. `x`: `[N, C]` → `[G, C]`
///
/// # Errors
/// If the row count differs from the groups' or the tensor is not f32.
pub fn segment_reduce(x: &Tensor, groups: Arc<Groups>, how: Reduce) -> Result<Tensor> {
    let reduce = SegmentReduce { groups, how };
    if how != Reduce::Max && composed::here("segment_reduce", x.device()) {
        reduce.check(x.layout())?;
        return composed::segment_reduce(x, &reduce.groups, how == Reduce::Mean);
    }
    x.contiguous()?.apply_op1(reduce)
}

struct ExpandGroups {
    groups: Arc<Groups>,
}

impl ExpandGroups {
    fn check(&self, l: &Layout) -> Result<usize> {
        let (g, c) = l.shape().dims2()?;
        if g != self.groups.len() {
            bail!("expand_groups: expected {} rows, got {g}", self.groups.len());
        }
        Ok(c)
    }

    fn pass(&self, [x]: [&Layout; 1]) -> Result<Option<launches::Gather<'_>>> {
        self.check(x)?;
        Ok(Some(launches::Gather { rows: self.groups.inverse() }))
    }
}

impl CustomOp1 for ExpandGroups {
    fn name(&self) -> &'static str {
        "expand_groups"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s, l)], || self.pass([l]))? {
            return Ok(made);
        }
        let c = self.check(l)?;
        let n = self.groups.inverse().len();
        let mut out = vec![0f32; n * c];
        gather_rows(cpu_slice("expand_groups", s, l)?, c, self.groups.inverse(), &mut out);
        Ok((CpuStorage::F32(out), (n, c).into()))
    }
    forward_on_device!(CustomOp1, pass);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let (g, c) = x.dims2()?;
        let pass = launches::SegmentReduce { groups: &self.groups, how: Reduce::Sum };
        if let Some(mut made) = launched([grad], &pass)? {
            return Ok(made.pop());
        }
        let device = here("expand_groups", Pass::Backward, x);
        read("expand_groups", grad, |grad| {
            make(device, (g, c), |dx| reduce(grad, c, &self.groups, Reduce::Sum, dx))
        })
        .map(Some)
    }
}

/// Gives every row the row of its group. `x`: `[G, C]` → `[N, C]`
///
/// # Errors
/// If the row count differs from the number of groups or the tensor is not f32.
pub fn expand_groups(x: &Tensor, groups: Arc<Groups>) -> Result<Tensor> {
    let expand = ExpandGroups { groups };
    if composed::here("expand_groups", x.device()) {
        expand.check(x.layout())?;
        return composed::gather(x, expand.groups.inverse());
    }
    x.contiguous()?.apply_op1(expand)
}

//! Pooling of groups of rows, and its counterpart.

use super::{cpu_slice, make, read};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::permute::gather_rows;
use scenesplat_kernels::segment::{Groups, Reduce, reduce, reduce_backward};
use std::sync::Arc;

struct SegmentReduce {
    groups: Arc<Groups>,
    how: Reduce,
}

impl CustomOp1 for SegmentReduce {
    fn name(&self) -> &'static str {
        "segment_reduce"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let (n, c) = l.shape().dims2()?;
        if n != self.groups.rows().len() {
            bail!("segment_reduce: expected {} rows, got {n}", self.groups.rows().len());
        }
        let mut out = vec![0f32; self.groups.len() * c];
        reduce(cpu_slice("segment_reduce", s, l)?, c, &self.groups, self.how, &mut out);
        Ok((CpuStorage::F32(out), (self.groups.len(), c).into()))
    }
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let (n, c) = x.dims2()?;
        read("segment_reduce", x, |x| {
            read("segment_reduce", grad, |g| {
                make((n, c), |dx| reduce_backward(x, c, &self.groups, self.how, g, dx))
            })
        })
        .map(Some)
    }
}

/// Reduces each group of rows to one. `x`: `[N, C]` → `[G, C]`
///
/// # Errors
/// If the row count differs from the groups' or the tensor is not f32 on the CPU.
pub fn segment_reduce(x: &Tensor, groups: Arc<Groups>, how: Reduce) -> Result<Tensor> {
    x.contiguous()?.apply_op1(SegmentReduce { groups, how })
}

struct ExpandGroups {
    groups: Arc<Groups>,
}

impl CustomOp1 for ExpandGroups {
    fn name(&self) -> &'static str {
        "expand_groups"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let (g, c) = l.shape().dims2()?;
        if g != self.groups.len() {
            bail!("expand_groups: expected {} rows, got {g}", self.groups.len());
        }
        let n = self.groups.inverse().len();
        let mut out = vec![0f32; n * c];
        gather_rows(cpu_slice("expand_groups", s, l)?, c, self.groups.inverse(), &mut out);
        Ok((CpuStorage::F32(out), (n, c).into()))
    }
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let (g, c) = x.dims2()?;
        read("expand_groups", grad, |grad| {
            make((g, c), |dx| reduce(grad, c, &self.groups, Reduce::Sum, dx))
        })
        .map(Some)
    }
}

/// Gives every row the row of its group. `x`: `[G, C]` → `[N, C]`
///
/// # Errors
/// If the row count differs from the number of groups or the tensor is not f32 on the CPU.
pub fn expand_groups(x: &Tensor, groups: Arc<Groups>) -> Result<Tensor> {
    x.contiguous()?.apply_op1(ExpandGroups { groups })
}

//! A permutation of rows whose backward is the gather by the inverse.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, make, read,
};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::permute::gather_rows;
use std::sync::Arc;

struct PermuteRows {
    order: Arc<Vec<u32>>,
    inverse: Arc<Vec<u32>>,
}

impl PermuteRows {
    fn check(&self, l: &Layout) -> Result<(usize, usize)> {
        let (n, c) = l.shape().dims2()?;
        if n != self.order.len() {
            bail!("permute_rows: expected {} rows, got {:?}", self.order.len(), l.shape());
        }
        Ok((n, c))
    }

    fn pass(&self, [x]: [&Layout; 1]) -> Result<Option<launches::Gather<'_>>> {
        self.check(x)?;
        Ok(Some(launches::Gather { rows: &self.order }))
    }
}

impl CustomOp1 for PermuteRows {
    fn name(&self) -> &'static str {
        "permute_rows"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s, l)], || self.pass([l]))? {
            return Ok(made);
        }
        let (n, c) = self.check(l)?;
        let mut out = vec![0f32; n * c];
        gather_rows(cpu_slice("permute_rows", s, l)?, c, &self.order, &mut out);
        Ok((CpuStorage::F32(out), l.shape().clone()))
    }
    forward_on_device!(CustomOp1, pass);
    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let (n, c) = x.dims2()?;
        if let Some(mut made) = launched([grad], &launches::Gather { rows: &self.inverse })? {
            return Ok(made.pop());
        }
        let device = here("permute_rows", Pass::Backward, x);
        read("permute_rows", grad, |g| {
            make(device, (n, c), |out| gather_rows(g, c, &self.inverse, out))
        })
        .map(Some)
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
    let permutation = PermuteRows { order, inverse };
    if composed::here("permute_rows", x.device()) {
        permutation.check(x.layout())?;
        return composed::gather(x, &permutation.order);
    }
    x.contiguous()?.apply_op1(permutation)
}

//! A bias for every row, of layers whose product is the device's library's.

use super::{Pass, composed, cpu_slice, emulated, forward_on_device, here, launched};
use super::{launches, make, read};
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::sparse_conv::backward_bias;

struct AddBias;

impl AddBias {
    fn check(x: &Layout, bias: &Layout) -> Result<usize> {
        let (_, c) = x.shape().dims2()?;
        if bias.shape().dims() != [c] {
            bail!("add_bias: rows {:?} do not fit a bias {:?}", x.shape(), bias.shape());
        }
        Ok(c)
    }

    fn pass(&self, [x, bias]: [&Layout; 2]) -> Result<Option<launches::AddBias>> {
        Self::check(x, bias)?;
        Ok(Some(launches::AddBias))
    }
}

impl CustomOp2 for AddBias {
    fn name(&self) -> &'static str {
        "add_bias"
    }
    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        if let Some(made) = emulated([(s1, l1), (s2, l2)], || self.pass([l1, l2]))? {
            return Ok(made);
        }
        let c = Self::check(l1, l2)?;
        let mut out = cpu_slice("add_bias", s1, l1)?.to_vec();
        let bias = cpu_slice("add_bias", s2, l2)?;
        for row in out.chunks_exact_mut(c.max(1)) {
            row.iter_mut().zip(bias).for_each(|(v, b)| *v += b);
        }
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }
    forward_on_device!(CustomOp2, pass);
    fn bwd(
        &self,
        x: &Tensor,
        bias: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        if let Some(mut made) = launched([grad], &launches::ColumnSums)? {
            return Ok((Some(grad.clone()), made.pop()));
        }
        let (c, device) = (bias.elem_count(), here("add_bias", Pass::Backward, x));
        let sums = read("add_bias", grad, |g| {
            make(device, c, |out| out.copy_from_slice(&backward_bias(g, c)))
        })?;
        Ok((Some(grad.clone()), Some(sums)))
    }
}

/// `x + bias`. Thousands of rows are added up for the gradient of the bias: in f64, or by parts of the device's product.
///
/// # Shapes
/// `x`: `[N, C]` · `bias`: `[C]` · returns `[N, C]`
///
/// # Errors
/// If shapes do not fit or a tensor is not f32.
pub(super) fn add_bias(x: &Tensor, bias: &Tensor) -> Result<Tensor> {
    if composed::here("add_bias", x.device()) {
        AddBias::check(x.layout(), bias.layout())?;
        return composed::add_bias(x, bias);
    }
    x.contiguous()?.apply_op2(bias, AddBias)
}

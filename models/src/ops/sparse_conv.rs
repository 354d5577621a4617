//! Submanifold convolution.

use super::{
    Pass, composed, cpu_slice, emulated, forward_on_device, here, launched, launches, make,
    make_unwritten, read, refuse_gradient, refuse_training, unwritten,
};
use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor, bail};
use scenesplat_kernels::Precision;
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::sparse_conv::{
    PackedConv, backward_bias, backward_input, backward_weight, forward,
};
use std::sync::Arc;

struct SparseConv {
    precision: Precision,
    map: Arc<KernelMap>,
}

impl SparseConv {
    /// Rows, channels of the input and of the output.
    fn check(&self, x: &Layout, w: &Layout) -> Result<(usize, usize, usize)> {
        let (n, cin) = x.shape().dims2()?;
        let k = self.map.kernel_size();
        let (cout, w_in) = match *w.shape().dims() {
            [cout, k1, k2, k3, cin] if [k1, k2, k3] == [k; 3] => (cout, cin),
            ref other => bail!("sparse_conv: expected [out, {k}, {k}, {k}, in], got {other:?}"),
        };
        if cin != w_in || n != self.map.rows() {
            bail!("sparse_conv: expected [{}, {w_in}], got {:?}", self.map.rows(), x.shape());
        }
        Ok((n, cin, cout))
    }

    /// Without or with a bias.
    fn pass<const N: usize>(
        &self,
        layouts: [&Layout; N],
    ) -> Result<Option<launches::SparseConv<'_>>> {
        let (_, _, cout) = self.check(layouts[0], layouts[1])?;
        Ok(Some(launches::SparseConv { map: &self.map, cout }))
    }

    fn run(
        &self,
        x: (&CpuStorage, &Layout),
        w: (&CpuStorage, &Layout),
        bias: Option<&[f32]>,
    ) -> Result<(CpuStorage, Shape)> {
        let (n, cin, cout) = self.check(x.1, w.1)?;
        let values = cpu_slice("sparse_conv", w.0, w.1)?;
        let weight = PackedConv::with_precision(self.precision, values, cin, cout, self.map.taps());
        // SAFETY: the kernel writes all of it and reads none before.
        let mut out = unsafe { unwritten(n * cout) };
        forward(&self.map, cpu_slice("sparse_conv", x.0, x.1)?, &weight, bias, &mut out);
        Ok((CpuStorage::F32(out), (n, cout).into()))
    }

    /// Of the input, the weight and, if there is one, the bias.
    fn gradients(
        &self,
        x: &Tensor,
        w: &Tensor,
        has_bias: bool,
        grad: &Tensor,
    ) -> Result<(Tensor, Tensor, Option<Tensor>)> {
        let (n, cin) = x.dims2()?;
        let cout = w.dim(0)?;
        let pass = launches::SparseConvBackward(launches::SparseConv { map: &self.map, cout });
        if let Some(made) = launched([x, w, grad], &pass)? {
            return Ok((made[0].clone(), made[1].clone(), Some(made[2].clone())));
        }
        let device = here("sparse_conv", Pass::Backward, x);
        let dx = read("sparse_conv", grad, |g| {
            read("sparse_conv", w, |w| {
                make(device, (n, cin), |dx| {
                    backward_input(self.precision, &self.map, g, w, cin, cout, dx);
                })
            })
        })?;
        let dw = read("sparse_conv", grad, |g| {
            read("sparse_conv", x, |x| {
                make(device, w.shape().clone(), |dw| {
                    backward_weight(self.precision, &self.map, x, g, cin, cout, dw);
                })
            })
        })?;
        let bias = || {
            read("sparse_conv", grad, |g| {
                make(device, cout, |out| out.copy_from_slice(&backward_bias(g, cout)))
            })
        };
        Ok((dx, dw, has_bias.then(bias).transpose()?))
    }
}

impl CustomOp3 for SparseConv {
    fn name(&self) -> &'static str {
        "sparse_conv"
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
        self.run((s1, l1), (s2, l2), Some(cpu_slice("sparse_conv", s3, l3)?))
    }
    forward_on_device!(CustomOp3, pass);
    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        _: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (dx, dw, db) = self.gradients(x, w, true, grad)?;
        Ok((Some(dx), Some(dw), db))
    }
}

impl CustomOp2 for SparseConv {
    fn name(&self) -> &'static str {
        "sparse_conv"
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
        self.run((s1, l1), (s2, l2), None)
    }
    forward_on_device!(CustomOp2, pass);
    fn bwd(
        &self,
        x: &Tensor,
        w: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (dx, dw, _) = self.gradients(x, w, false, grad)?;
        Ok((Some(dx), Some(dw)))
    }
}

/// `out[p] = bias + Σ_tap W[:, tap, :] · x[p + tap − centre]` over occupied voxels.
///
/// # Shapes
/// `x`: `[N, in]` · `weight`: `[out, k, k, k, in]` · `bias`: `[out]` · returns `[N, out]`
///
/// # Errors
/// If shapes do not fit the map or a tensor is not f32.
pub fn sparse_conv(
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    map: Arc<KernelMap>,
) -> Result<Tensor> {
    sparse_conv_with(Precision::F32, x, weight, bias, map)
}

/// [`sparse_conv`] with operands in another precision, in the gradients too. Results are f32.
///
/// # Errors
/// As [`sparse_conv`], or if the precision has no gradient.
pub fn sparse_conv_with(
    precision: Precision,
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
    map: Arc<KernelMap>,
) -> Result<Tensor> {
    refuse_training("sparse_conv", precision)?;
    let conv = SparseConv { precision, map };
    if composed::here("sparse_conv", x.device()) {
        conv.check(x.layout(), weight.layout())?;
        return composed::sparse_conv(x, weight, bias, &conv.map);
    }
    let x = x.contiguous()?;
    match bias {
        Some(bias) => x.apply_op3(weight, bias, conv),
        None => x.apply_op2(weight, conv),
    }
}

/// [`sparse_conv`] with packed weights, without gradient.
///
/// # Errors
/// If shapes do not fit or `x` wants a gradient.
pub fn sparse_conv_frozen(
    x: &Tensor,
    weight: &PackedConv,
    bias: Option<&[f32]>,
    map: &KernelMap,
) -> Result<Tensor> {
    refuse_gradient("sparse_conv", x)?;
    let (n, cin) = x.dims2()?;
    if cin != weight.cin() || n != map.rows() {
        bail!("sparse_conv: expected [{}, {}], got {:?}", map.rows(), weight.cin(), x.shape());
    }
    let device = here("sparse_conv", Pass::Forward, x);
    read("sparse_conv", x, |x| {
        // SAFETY: the kernel writes all of it and reads none before.
        unsafe {
            make_unwritten(device, (n, weight.cout()), |out| forward(map, x, weight, bias, out))
        }
    })
}

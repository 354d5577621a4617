//! Submanifold convolution.

use super::{Array, Operation, apply, frozen, refuse_training, unwritten};
use crate::device::launches::{Input, Launched, Uploaded, matrix, narrow, room};
use candle_core::{Result, Shape, Tensor, bail};
use scenesplat_device::Launcher;
use scenesplat_device::ops::sparse_conv::{self as device, Method};
use scenesplat_device::ops::{columns, kernel_map};
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
    fn upload<L: Launcher>(&self, l: &L) -> Uploaded<L, kernel_map::KernelMap<L::Buffer>> {
        let (n, taps) = (self.map.rows(), self.map.taps());
        let mut neighbors = vec![u32::MAX; n * taps];
        let (mut starts, mut input, mut output) = (vec![0], Vec::new(), Vec::new());
        for (tap, row) in (0..taps).zip(neighbors.chunks_exact_mut(n.max(1))) {
            let (from, to) = self.map.tap_pairs(tap);
            from.iter().zip(&to).for_each(|(from, to)| row[*to as usize] = *from);
            input.extend(from);
            output.extend(to);
            starts.push(narrow::<L>(input.len())?);
        }
        starts.resize(taps + 1, 0);
        Ok(kernel_map::KernelMap {
            kernel_size: narrow::<L>(self.map.kernel_size())?,
            rows: narrow::<L>(n)?,
            pairs: narrow::<L>(input.len())?,
            duplicates: self.map.has_duplicates(),
            neighbors: l.upload_values(&neighbors)?,
            starts: l.upload_values(&starts)?,
            input: l.upload_values(&input)?,
            output: l.upload_values(&output)?,
        })
    }
}

impl Operation for SparseConv {
    const NAME: &'static str = "sparse_conv";

    fn shape(&self, inputs: &[&Shape]) -> Result<Shape> {
        let (n, cin) = inputs[0].dims2()?;
        let k = self.map.kernel_size();
        let (cout, w_in) = match *inputs[1].dims() {
            [cout, k1, k2, k3, cin] if [k1, k2, k3] == [k; 3] => (cout, cin),
            ref other => bail!("sparse_conv: expected [out, {k}, {k}, {k}, in], got {other:?}"),
        };
        if cin != w_in || n != self.map.rows() {
            bail!("sparse_conv: expected [{}, {w_in}], got {:?}", self.map.rows(), inputs[0]);
        }
        Ok((n, cout).into())
    }
    fn forward(&self, inputs: &[Array<'_>]) -> Result<Vec<f32>> {
        let ((x, dims), (w, of_weight)) = (inputs[0], inputs[1]);
        let (cin, cout, taps) = (dims[1], of_weight[0], self.map.taps());
        let weight = PackedConv::with_precision(self.precision, w, cin, cout, taps);
        let bias = inputs.get(2).map(|(bias, _)| *bias);
        // SAFETY: the kernel writes all of it and reads none before.
        let mut out = unsafe { unwritten(dims[0] * cout) };
        forward(&self.map, x, &weight, bias, &mut out);
        Ok(out)
    }
    fn backward(&self, inputs: &[Array<'_>], grad: &[f32]) -> Result<Vec<Vec<f32>>> {
        let ((x, dims), (w, of_weight)) = (inputs[0], inputs[1]);
        let (cin, cout) = (dims[1], of_weight[0]);
        let (mut dx, mut dw) = (vec![0.0; x.len()], vec![0.0; w.len()]);
        backward_input(self.precision, &self.map, grad, w, cin, cout, &mut dx);
        backward_weight(self.precision, &self.map, x, grad, cin, cout, &mut dw);
        let mut found = vec![dx, dw];
        found.extend((inputs.len() > 2).then(|| backward_bias(grad, cout)));
        Ok(found)
    }
    fn launch<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let ((x, dims), (weight, of_weight)) = (inputs[0], inputs[1]);
        let (map, (_, cin)) = (self.upload(l)?, matrix::<L>(dims)?);
        let (shape, cout) = ([dims[0], of_weight[0]], narrow::<L>(of_weight[0])?);
        let bias = inputs.get(2).map(|(bias, _)| *bias);
        let mut out = room(l, &shape)?;
        device::forward(l, Method::ByWidth, &map, x, weight, bias, cin, cout, &mut out)?;
        Ok(Some(vec![(out, shape.as_slice().into())]))
    }
    fn launch_backward<L: Launcher>(&self, l: &L, inputs: &[Input<'_, L>]) -> Launched<L> {
        let (grad, _) = inputs[inputs.len() - 1];
        let ((x, dims), (weight, of_weight)) = (inputs[0], inputs[1]);
        let (map, (n, cin)) = (self.upload(l)?, matrix::<L>(dims)?);
        let cout = narrow::<L>(of_weight[0])?;
        let (mut dx, mut dw) = (room(l, dims)?, room(l, of_weight)?);
        device::backward_input(l, Method::ByWidth, &map, grad, weight, cin, cout, &mut dx)?;
        device::backward_weight(l, &map, x, grad, cin, cout, &mut dw)?;
        let mut found = vec![(dx, dims.into()), (dw, of_weight.into())];
        if let [_, _, (_, of_bias), _] = inputs {
            let mut db = room(l, of_bias)?;
            columns::column_sums(l, grad, n, cout, &mut db)?;
            found.push((db, (*of_bias).into()));
        }
        Ok(Some(found))
    }
}

/// `out[p] = bias + Σ_tap W[:, tap, :] · x[p + tap − center]` over occupied voxels.
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
    let inputs: Vec<&Tensor> = [x, weight].into_iter().chain(bias).collect();
    apply(SparseConv { precision, map }, &inputs)
}

/// [`sparse_conv`] with packed weights, without gradient.
///
/// # Errors
/// If shapes do not fit or `x` requires a gradient.
pub fn sparse_conv_frozen(
    x: &Tensor,
    weight: &PackedConv,
    bias: Option<&[f32]>,
    map: &KernelMap,
) -> Result<Tensor> {
    let (n, cin) = x.dims2()?;
    if cin != weight.cin() || n != map.rows() {
        bail!("sparse_conv: expected [{}, {}], got {:?}", map.rows(), weight.cin(), x.shape());
    }
    let shape = (n, weight.cout());
    // SAFETY: the kernel writes all of it and reads none before.
    unsafe { frozen("sparse_conv", x, None, shape, |x, _, out| forward(map, x, weight, bias, out)) }
}

//! Operations of the networks: candle glue over `scenesplat-kernels`, on tensors of any device. With the feature
//! `rasterizer` there is the rasterizer as an operation, too.
//!
//! The differentiable ones are candle custom operations (`operation`) that hold their index tables. The others, for
//! frozen weights, refuse an input that requires a gradient.

#![cfg_attr(
    not(any(feature = "cuda", feature = "emulation")),
    allow(dead_code, reason = "nothing launches the kernels")
)]

mod add_bias;
mod batch_norm;
mod gelu;
mod layer_norm;
mod linear;
mod normalize;
mod operation;
mod patch_attention;
mod permute_rows;
mod point_rope;
#[cfg(feature = "rasterizer")]
mod rasterize;
mod residual;
mod segment_reduce;
mod sparse_conv;

pub(crate) use batch_norm::shared_batch_statistics;
pub use batch_norm::{
    BatchStatistics, StatisticsSource, batch_norm, batch_statistics, scale_shift,
};
pub(crate) use batch_norm::{frozen_cannot_train, scale_shift_frozen};
pub use gelu::gelu;
pub use layer_norm::{layer_norm, layer_norm_frozen};
pub use linear::{linear, linear_frozen, linear_unit_frozen, linear_with, mlp_frozen};
pub use normalize::{l2_normalize, l2_normalize_above};
pub use patch_attention::patch_attention;
pub use permute_rows::permute_rows;
pub use point_rope::point_rope;
#[cfg(feature = "rasterizer")]
pub use rasterize::{DepthChannel, GaussianTensors, rasterize};
pub use residual::add_scaled_rows;
pub(crate) use scenesplat_kernels::fallbacks::Pass;
pub use scenesplat_kernels::normalize::normalize_rows;
pub use segment_reduce::{expand_groups, segment_reduce};
pub use sparse_conv::{sparse_conv, sparse_conv_frozen, sparse_conv_with};

pub(crate) use operation::{Operation, apply, forward_passes, gradients, here};

use crate::device::launches::{Input, Launched, matrix, narrow, room};
use candle_core::{CpuStorage, DType, Device, Layout, Result, Shape, Storage, Tensor, bail};
use scenesplat_device::Launcher;
use scenesplat_device::ops::rows::{Width, gather_rows};
use scenesplat_kernels::Precision;

/// Values of a tensor on the CPU, with its dimensions.
pub(crate) type Array<'a> = (&'a [f32], &'a [usize]);

/// The f32 values of a contiguous CPU tensor.
pub(crate) fn cpu_slice<'a>(
    op: &str,
    storage: &'a CpuStorage,
    layout: &Layout,
) -> Result<&'a [f32]> {
    let CpuStorage::F32(values) = storage else {
        let got = dtype_of(storage);
        bail!("{op}: expected f32, got {got:?}; cast with to_dtype first")
    };
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&values[start..end]),
        None => bail!("{op}: expected a contiguous tensor, got strides {:?}", layout.stride()),
    }
}

fn dtype_of(storage: &CpuStorage) -> DType {
    candle_core::backend::BackendStorage::dtype(storage)
}

/// Lends the values of tensors, made contiguous if needed, and copied if they are on another device: who computes with them
/// says so first ([`here`]).
pub(crate) fn read_all<R>(
    op: &str,
    tensors: &[&Tensor],
    f: impl FnOnce(&[Array<'_>]) -> Result<R>,
) -> Result<R> {
    let mut whole = Vec::with_capacity(tensors.len());
    for tensor in tensors {
        whole.push(tensor.to_device(&Device::Cpu)?.contiguous()?);
    }
    let held: Vec<_> = whole.iter().map(Tensor::storage_and_layout).collect();
    let mut arrays = Vec::with_capacity(held.len());
    for (storage, layout) in &held {
        let Storage::Cpu(storage) = &**storage else {
            bail!("{op}: the values could not be copied to the CPU")
        };
        arrays.push((cpu_slice(op, storage, layout)?, layout.dims()));
    }
    f(&arrays)
}

/// As [`read_all`] of one tensor.
pub(crate) fn read<R>(op: &str, t: &Tensor, f: impl FnOnce(&[f32]) -> Result<R>) -> Result<R> {
    read_all(op, &[t], |arrays| f(arrays[0].0))
}

/// An operation of frozen weights on rows and, if there is one, a residual; it refuses inputs that require a gradient.
///
/// # Safety
/// `fill` writes each value of the result before it reads it.
pub(crate) unsafe fn frozen(
    op: &'static str,
    x: &Tensor,
    residual: Option<&Tensor>,
    shape: impl Into<Shape>,
    fill: impl FnOnce(&[f32], Option<&[f32]>, &mut [f32]),
) -> Result<Tensor> {
    let inputs: Vec<&Tensor> = [x].into_iter().chain(residual).collect();
    if inputs.iter().any(|t| t.track_op()) {
        bail!(
            "{op}: these weights are frozen for inference and give no gradient; load them into a \
             trainable ParamStore, or detach the input"
        );
    }
    let (shape, device) = (shape.into(), here(op, Pass::Forward, x));
    read_all(op, &inputs, |arrays| {
        // SAFETY: passed on.
        let mut out = unsafe { unwritten(shape.elem_count()) };
        fill(arrays[0].0, arrays.get(1).map(|(values, _)| *values), &mut out);
        Tensor::from_vec(out, shape, device)
    })
}

/// `out[i] = x[rows[i]]` on a device.
fn gather_launch<L: Launcher>(l: &L, (x, dims): Input<'_, L>, rows: &[u32]) -> Launched<L> {
    let (n, (_, c)) = (narrow::<L>(rows.len())?, matrix::<L>(dims)?);
    let shape = [rows.len(), c as usize];
    let mut out = room(l, &shape)?;
    gather_rows(l, x, Width::Four, c, &l.upload_values(rows)?, n, &mut out)?;
    Ok(Some(vec![(out, shape.as_slice().into())]))
}

/// Room for values that a kernel writes. Clearing it first is done by one thread alone, and takes as long as
/// a quarter of a narrow layer. In debug builds it is full of NaN, which whoever reads too early finds.
///
/// # Safety
/// Each value is written before it is read.
#[expect(clippy::uninit_vec, reason = "that is what it is for; any bits are an f32")]
pub(crate) unsafe fn unwritten(len: usize) -> Vec<f32> {
    let mut values = Vec::with_capacity(len);
    // SAFETY: the room is there, and what is in it is not read, as the caller promises.
    unsafe { values.set_len(len) };
    if cfg!(debug_assertions) {
        values.fill(f32::NAN);
    }
    values
}

/// Stops training in a precision that has no gradient.
pub(crate) fn refuse_training(op: &str, precision: Precision) -> Result<()> {
    if !precision.has_gradient() {
        bail!(
            "{op}: {precision} is for inference and has no gradient; train in f32, split or bf16, then \
             read the weights into a frozen ParamStore"
        );
    }
    Ok(())
}

/// Checks the shape of a residual.
pub(crate) fn check_shape(op: &str, residual: Option<&Tensor>, shape: [usize; 2]) -> Result<()> {
    match residual {
        Some(r) if r.dims() != shape => {
            bail!("{op}: expected a residual {shape:?}, got {:?}", r.shape())
        }
        _ => Ok(()),
    }
}

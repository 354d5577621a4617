//! Operations of the networks and of the rasterizer: candle glue over `scenesplat-kernels` and
//! `scenesplat-rasterizer`, on tensors of any device; `device` says what happens on another than the CPU.
//!
//! The differentiable ones are candle custom operations; index tables live inside the operation.
//! The others, used with frozen weights, refuse an input that wants a gradient.

mod add_bias;
mod batch_norm;
mod composed;
pub(crate) mod device;
mod gelu;
pub(crate) mod launches;
mod layer_norm;
mod linear;
mod normalize;
mod patch_attention;
mod permute_rows;
mod point_rope;
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
pub use rasterize::{DepthChannel, GaussianTensors, rasterize};
pub use residual::add_scaled_rows;
pub(crate) use scenesplat_kernels::fallbacks::Pass;
pub use scenesplat_kernels::normalize::normalize_rows;
pub use segment_reduce::{expand_groups, segment_reduce};
pub use sparse_conv::{sparse_conv, sparse_conv_frozen, sparse_conv_with};

pub(crate) use device::{emulated, forward_on_device, here, launched};

use candle_core::{CpuStorage, Device, Layout, Result, Shape, Storage, Tensor, bail};
use scenesplat_kernels::Precision;

/// The f32 values of a contiguous CPU tensor.
pub(crate) fn cpu_slice<'a>(
    op: &str,
    storage: &'a CpuStorage,
    layout: &Layout,
) -> Result<&'a [f32]> {
    let CpuStorage::F32(values) = storage else {
        bail!("{op}: expected f32, got {:?}; cast with to_dtype first", storage_dtype(storage))
    };
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&values[start..end]),
        None => bail!("{op}: expected a contiguous tensor, got strides {:?}", layout.stride()),
    }
}

fn storage_dtype(storage: &CpuStorage) -> candle_core::DType {
    use candle_core::backend::BackendStorage;
    storage.dtype()
}

/// Lends the values of a tensor, made contiguous if needed, and copied here if they are on another device: who
/// computes with them says so first ([`device::here`]).
pub(crate) fn read<R>(op: &str, t: &Tensor, f: impl FnOnce(&[f32]) -> Result<R>) -> Result<R> {
    let t = t.to_device(&Device::Cpu)?.contiguous()?;
    let (storage, layout) = t.storage_and_layout();
    match &*storage {
        Storage::Cpu(storage) => f(cpu_slice(op, storage, layout)?),
        _ => bail!("{op}: the values could not be copied to the CPU"),
    }
}

/// Makes a tensor of values that `f` fills, on a device.
pub(crate) fn make(
    device: &Device,
    shape: impl Into<Shape>,
    f: impl FnOnce(&mut [f32]),
) -> Result<Tensor> {
    let shape = shape.into();
    let mut out = vec![0f32; shape.elem_count()];
    f(&mut out);
    Tensor::from_vec(out, shape, device)
}

/// As [`make`], of values that nobody cleared.
///
/// # Safety
/// As [`unwritten`].
pub(crate) unsafe fn make_unwritten(
    device: &Device,
    shape: impl Into<Shape>,
    f: impl FnOnce(&mut [f32]),
) -> Result<Tensor> {
    let shape = shape.into();
    // SAFETY: passed on.
    let mut out = unsafe { unwritten(shape.elem_count()) };
    f(&mut out);
    Tensor::from_vec(out, shape, device)
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

/// Stops an input that wants a gradient from entering an operation that has none.
pub(crate) fn refuse_gradient(op: &str, x: &Tensor) -> Result<()> {
    if x.track_op() {
        bail!(
            "{op}: these weights are frozen for inference and give no gradient; load them into a \
             trainable ParamStore, or detach the input"
        );
    }
    Ok(())
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

/// Checks the shape of a residual, and that it wants no gradient.
pub(crate) fn check_residual(op: &str, residual: &Tensor, shape: [usize; 2]) -> Result<()> {
    refuse_gradient(op, residual)?;
    if residual.dims() != shape {
        bail!("{op}: expected a residual {shape:?}, got {:?}", residual.shape());
    }
    Ok(())
}

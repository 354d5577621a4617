//! Kernels on candle's CUDA tensors: their memory and their stream.

use super::launches::{self, Launches};
use candle_core::cuda_backend::cudarc::driver::{CudaStream, DevicePtr, SyncOnDrop};
use candle_core::cuda_backend::{CudaDType, DeviceId};
use candle_core::op::BackpropOp;
use candle_core::{CudaDevice, CudaStorage, Error, Layout, Result, Shape, Storage, Tensor, bail};
use scenesplat_device::cuda::{CudaBuffer, CudaLauncher};
use scenesplat_device::nvrtc::Cache;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

/// The launcher of a device, which keeps the kernels that it has loaded. Its stream is candle's, so kernels follow what
/// candle has asked for before.
fn launcher(device: &CudaDevice) -> Result<Arc<CudaLauncher>> {
    static ALL: Mutex<Option<HashMap<DeviceId, Arc<CudaLauncher>>>> = Mutex::new(None);
    let mut all = ALL.lock().unwrap_or_else(PoisonError::into_inner);
    let all = all.get_or_insert_with(HashMap::new);
    if let Some(launcher) = all.get(&device.id()) {
        return Ok(Arc::clone(launcher));
    }
    let launcher =
        CudaLauncher::new(device.cuda_stream(), Cache::of_user()).map_err(Error::wrap)?;
    let launcher = Arc::new(launcher);
    all.insert(device.id(), Arc::clone(&launcher));
    Ok(launcher)
}

fn inside(what: &str) -> Error {
    Error::Msg(format!("internal error: {what}"))
}

/// The memory of an input, as long as the guard lives.
fn input<'a>(
    storage: &'a CudaStorage,
    layout: &Layout,
    stream: &'a CudaStream,
) -> Result<(CudaBuffer, SyncOnDrop<'a>)> {
    let Some((start, end)) = layout.contiguous_offsets() else {
        bail!("expected a contiguous tensor, got strides {:?}", layout.stride())
    };
    let (address, guard) = f32::as_cuda_slice(storage)?.device_ptr(stream);
    let address = address + (start * size_of::<f32>()) as u64;
    // SAFETY: the tensor is held by the caller until the launches are asked for, and its memory is freed in the order of
    // the stream.
    let buffer = unsafe { CudaBuffer::borrowed(address, (end - start) * size_of::<f32>()) };
    Ok((buffer, guard))
}

/// Runs a pass on storages, which are to be f32 and contiguous; all arrays that it makes.
fn run(
    inputs: &[(&CudaStorage, &Layout)],
    pass: &impl Launches,
) -> Result<Option<Vec<(CudaStorage, Shape)>>> {
    let device = inputs[0].0.device.clone();
    let (launcher, stream) = (launcher(&device)?, device.cuda_stream());
    let mut found = Vec::with_capacity(inputs.len());
    for (storage, layout) in inputs {
        found.push(input(storage, layout, &stream)?);
    }
    let arrays = found.iter().zip(inputs).map(|((buffer, _), (_, layout))| (buffer, layout.dims()));
    let arrays: Vec<_> = arrays.collect();
    let Some(made) = pass.launch(&*launcher, &arrays).map_err(Error::wrap)? else {
        return Ok(None);
    };
    let storage = |(buffer, shape): (CudaBuffer, Shape)| {
        let slice = match buffer {
            CudaBuffer::Owned(slice) => {
                // SAFETY: the memory was given for as many f32 by this stream, and is left to this slice.
                unsafe { stream.upgrade_device_ptr::<f32>(slice.leak(), shape.elem_count()) }
            }
            CudaBuffer::Empty => device.alloc_zeros::<f32>(0)?,
            CudaBuffer::Borrowed { .. } => return Err(inside("an input would be the output")),
        };
        Ok((f32::wrap_cuda_slice(slice, device.clone()), shape))
    };
    made.into_iter().map(storage).collect::<Result<_>>().map(Some)
}

/// A forward pass.
pub(crate) fn on_storages(
    inputs: &[(&CudaStorage, &Layout)],
    pass: &impl Launches,
) -> Result<Option<(CudaStorage, Shape)>> {
    let Some(mut made) = run(inputs, pass)? else { return Ok(None) };
    made.pop().map(Some).ok_or_else(|| inside("a pass made nothing"))
}

/// Mean and biased variance of each channel.
pub(crate) fn batch_statistics(x: &Tensor) -> Result<(Vec<f64>, Vec<f64>)> {
    let x = x.contiguous()?;
    let (storage, layout) = x.storage_and_layout();
    let Storage::Cuda(storage) = &*storage else { bail!("expected a tensor on CUDA") };
    let (launcher, stream) = (launcher(&storage.device)?, storage.device.cuda_stream());
    let (buffer, _guard) = input(storage, layout, &stream)?;
    launches::batch_statistics(&*launcher, (&buffer, x.dims())).map_err(Error::wrap)
}

/// A backward pass; its results are in no graph.
pub(crate) fn on_tensors(inputs: &[&Tensor], pass: &impl Launches) -> Result<Option<Vec<Tensor>>> {
    let mut whole = Vec::with_capacity(inputs.len());
    for tensor in inputs {
        whole.push(tensor.contiguous()?);
    }
    let held: Vec<_> = whole.iter().map(Tensor::storage_and_layout).collect();
    let mut storages = Vec::with_capacity(held.len());
    for (storage, layout) in &held {
        let Storage::Cuda(storage) = &**storage else { bail!("expected a tensor on CUDA") };
        storages.push((storage, *layout));
    }
    let made = run(&storages, pass)?;
    let tensor = |(storage, shape)| {
        Tensor::from_storage(Storage::Cuda(storage), shape, BackpropOp::none(), false)
    };
    Ok(made.map(|made| made.into_iter().map(tensor).collect()))
}

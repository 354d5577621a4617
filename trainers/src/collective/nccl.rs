//! Ranks of MPI whose gradients go from device to device.

use super::tensors::{Exchange, sum_over_ranks};
use super::{Collective, CollectiveError, MessagePassing};
use candle_core::cuda_backend::CudaDType;
use candle_core::cuda_backend::cudarc::driver::{CudaSlice, CudaView};
use candle_core::cuda_backend::cudarc::nccl::{self, Comm, Id};
use candle_core::op::BackpropOp;
use candle_core::{CudaDevice, Device, Storage, Tensor};
use std::fmt;

/// Bytes of what names a group of devices.
const ID_BYTES: usize = 128;

/// The ranks of an MPI world, each with a CUDA device of its own: sums of tensors go by NCCL and do not leave the devices,
/// all else goes by MPI. The order of sums is that of [`MessagePassing`], and so are their bits.
pub struct Nccl {
    ranks: MessagePassing,
    comm: Comm,
    device: CudaDevice,
}

#[allow(clippy::needless_pass_by_value, reason = "as `map_err` gives it")]
fn failed(problem: impl fmt::Display) -> CollectiveError {
    CollectiveError::Device { problem: problem.to_string() }
}

#[allow(clippy::needless_pass_by_value, reason = "as `map_err` gives it")]
fn refused(error: nccl::result::NcclError) -> CollectiveError {
    failed(format!("NCCL: {error:?} (NCCL_DEBUG=WARN says more)"))
}

impl Nccl {
    /// Joins the devices of all ranks; every rank calls it, with its own device.
    ///
    /// # Errors
    /// If the device is not a CUDA device, the library is missing on one of the ranks, or the devices do not find each other (two
    /// ranks on one device do not).
    pub fn start(ranks: MessagePassing, device: &Device) -> Result<Self, CollectiveError> {
        let Device::Cuda(device) = device else {
            return Err(failed("NCCL needs a CUDA device on each rank"));
        };
        // SAFETY: opening the library runs its initialisers, which have no demands.
        let present = unsafe { nccl::sys::is_culib_present() };
        // A rank without it must not leave the others waiting.
        let all = ranks.all_gather(&[u8::from(present)])?;
        if let Some(rank) = all.iter().position(|said| said != &[1]) {
            return Err(failed(format!(
                "libnccl was not found on rank {rank}; install NVIDIA's NCCL (nvidia-nccl-cu13 of the Python packages has \
                 it) and name its folder in LD_LIBRARY_PATH"
            )));
        }
        let id = if ranks.rank() == 0 { Some(Id::new()) } else { None };
        let mine = match &id {
            Some(Ok(id)) => id.internal().map(i8_to_byte).to_vec(),
            _ => Vec::new(),
        };
        let told = ranks.broadcast(0, &mine)?;
        if let Some(Err(error)) = id {
            return Err(refused(error));
        }
        let told: [u8; ID_BYTES] = told.try_into().map_err(|_| failed("rank 0 tells no id"))?;
        let id = Id::uninit(told.map(byte_to_i8));
        let stream = device.cuda_stream();
        let comm = Comm::from_rank(stream, ranks.rank(), ranks.size(), id).map_err(refused)?;
        Ok(Self { ranks, comm, device: device.clone() })
    }

    /// Sends and receives by `exchange`, with the values of `sent` and room for `len` values, as one operation of NCCL.
    fn exchanged(
        &self,
        sent: &Tensor,
        shape: (usize, usize),
        exchange: impl FnOnce(
            &Comm,
            &CudaView<'_, f32>,
            &mut CudaSlice<f32>,
        ) -> Result<(), nccl::result::NcclError>,
    ) -> Result<Tensor, CollectiveError> {
        let sent = sent.contiguous().map_err(failed)?;
        let (storage, layout) = sent.storage_and_layout();
        let Storage::Cuda(storage) = &*storage else {
            return Err(failed("a tensor that is not on the device"));
        };
        let (from, to) = layout.contiguous_offsets().unwrap_or_default();
        let values = f32::as_cuda_slice(storage).map_err(failed)?.slice(from..to);
        // SAFETY: all of it is received before anything reads it: both are on one stream.
        let got = unsafe { self.device.cuda_stream().alloc::<f32>(shape.0 * shape.1) };
        let mut got = got.map_err(failed)?;
        exchange(&self.comm, &values, &mut got).map_err(refused)?;
        let storage = Storage::Cuda(f32::wrap_cuda_slice(got, self.device.clone()));
        Ok(Tensor::from_storage(storage, shape, BackpropOp::none(), false))
    }
}

fn i8_to_byte(value: core::ffi::c_char) -> u8 {
    value.to_ne_bytes()[0]
}

fn byte_to_i8(value: u8) -> core::ffi::c_char {
    core::ffi::c_char::from_ne_bytes([value])
}

impl Exchange for Nccl {
    fn size(&self) -> usize {
        self.ranks.size()
    }

    fn all_to_all(&self, rows: &Tensor) -> Result<Tensor, CollectiveError> {
        let (ranks, len) = rows.dims2().map_err(failed)?;
        self.exchanged(rows, (ranks, len), |comm, values, got| {
            nccl::group_start()?;
            for rank in 0..ranks {
                let at = rank * len..(rank + 1) * len;
                let peer = i32::try_from(rank).unwrap_or(i32::MAX);
                comm.send(&values.slice(at.clone()), peer)?;
                comm.recv(&mut got.slice_mut(at), peer)?;
            }
            nccl::group_end().map(drop)
        })
    }

    fn all_gather(&self, row: &Tensor) -> Result<Tensor, CollectiveError> {
        let shape = (self.ranks.size(), row.elem_count());
        self.exchanged(row, shape, |comm, values, got| comm.all_gather(values, got).map(drop))
    }
}

impl fmt::Debug for Nccl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Nccl({:?})", self.ranks)
    }
}

impl Collective for Nccl {
    fn rank(&self) -> usize {
        self.ranks.rank()
    }

    fn size(&self) -> usize {
        self.ranks.size()
    }

    fn all_gather(&self, mine: &[u8]) -> Result<Vec<Vec<u8>>, CollectiveError> {
        self.ranks.all_gather(mine)
    }

    fn all_to_all(&self, parts: &[&[f32]]) -> Result<Vec<Vec<f32>>, CollectiveError> {
        self.ranks.all_to_all(parts)
    }

    fn carrier(&self) -> &'static str {
        "NCCL from device to device"
    }

    fn all_reduce_tensor(&self, values: &Tensor) -> Result<Option<Tensor>, CollectiveError> {
        if !values.device().is_cuda() {
            return Ok(None);
        }
        sum_over_ranks(self, values).map(Some)
    }

    fn barrier(&self) -> Result<(), CollectiveError> {
        self.ranks.barrier()
    }

    fn abort(&self) {
        self.ranks.abort();
    }
}

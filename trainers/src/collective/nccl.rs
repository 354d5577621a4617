//! Sums on graphics processors by NCCL.
//!
//! **This has been compiled and never run**: no machine with two such processors was to be had. What is tested are the
//! ranks it stands on ([`MessagePassing`]) and the trainer above it.

use super::{Collective, CollectiveError, MessagePassing};
use candle_core::Device;
use candle_core::cuda_backend::cudarc::driver::CudaStream;
use candle_core::cuda_backend::cudarc::nccl::{self, Comm, Id, ReduceOp};
use std::fmt;
use std::sync::Arc;

/// Ranks of an MPI world with a graphics processor each. Sums of gradients are NCCL's, all else goes by MPI.
///
/// NCCL adds in an order of its own, which its choice of ring or tree decides: runs on the same machines with the same
/// number of ranks repeat, but a run of other ranks, or of one process, rounds otherwise.
pub struct Nccl {
    ranks: MessagePassing,
    comm: Comm,
    stream: Arc<CudaStream>,
}

impl Nccl {
    /// Joins the ranks' devices. Each rank needs one of its own: the launcher gives it one (`srun --gpus-per-task 1`), or
    /// names it in `CUDA_VISIBLE_DEVICES`. The id of the group is made by rank 0 and sent by MPI.
    ///
    /// # Errors
    /// If the device is no CUDA device, NCCL is not there, or the ranks do not find each other; on all ranks alike.
    pub fn start(ranks: MessagePassing, device: &Device) -> Result<Self, CollectiveError> {
        let rank = ranks.rank();
        let problem = |problem: String| CollectiveError::Disagreement { rank, problem };
        // SAFETY: opening the library runs its initialisers, which have no demands.
        let there = unsafe { nccl::sys::is_culib_present() };
        let own = match device {
            Device::Cuda(_) if there => Ok(()),
            Device::Cuda(_) => Err("libnccl was not found; name its folder in LD_LIBRARY_PATH"),
            _ => Err("has no CUDA device (--device cuda:0), which sums by NCCL need"),
        };
        // All learn of it before one waits for another.
        for (rank, bytes) in
            ranks.all_gather(own.err().unwrap_or("").as_bytes())?.iter().enumerate()
        {
            if !bytes.is_empty() {
                let problem = String::from_utf8_lossy(bytes).into_owned();
                return Err(CollectiveError::Disagreement { rank, problem });
            }
        }
        let Device::Cuda(cuda) = device else {
            return Err(problem("has no CUDA device".to_owned()));
        };
        let mine = match rank {
            0 => {
                let id = Id::new()
                    .map_err(|error| problem(format!("makes no id for NCCL: {error:?}")))?;
                id.internal().iter().map(|c| c.to_ne_bytes()[0]).collect()
            }
            _ => Vec::new(),
        };
        let sent = ranks.broadcast(0, &mine)?;
        let bytes: [u8; 128] =
            sent.try_into().map_err(|_| problem("got no id for NCCL from rank 0".to_owned()))?;
        let id = Id::uninit(bytes.map(|b| std::ffi::c_char::from_ne_bytes([b])));
        let stream = cuda.cuda_stream();
        let comm = Comm::from_rank(Arc::clone(&stream), rank, ranks.size(), id)
            .map_err(|error| problem(format!("does not join NCCL: {error:?}")))?;
        Ok(Self { ranks, comm, stream })
    }
}

impl fmt::Debug for Nccl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Nccl({} of {})", self.rank(), self.size())
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

    fn barrier(&self) -> Result<(), CollectiveError> {
        self.ranks.barrier()
    }

    /// By NCCL, on the device: a bucket goes there and comes back.
    fn all_reduce(&self, values: &mut [f32]) -> Result<(), CollectiveError> {
        let rank = self.rank();
        let problem = |what: &str, error: &dyn fmt::Debug| CollectiveError::Disagreement {
            rank,
            problem: format!("{what}: {error:?}"),
        };
        // Ranks that bring another number would wait for ever.
        let count = (values.len() as u64).to_le_bytes();
        let counts = self.ranks.all_gather(&count)?;
        if let Some(rank) = counts.iter().position(|other| other != &count) {
            let problem = format!("sums another number of values than {}", values.len());
            return Err(CollectiveError::Disagreement { rank, problem });
        }
        if values.is_empty() {
            return Ok(());
        }
        let mut bucket =
            self.stream.clone_htod(values).map_err(|e| problem("cannot send its bucket", &e))?;
        let sum = self.comm.all_reduce_in_place(&mut bucket, &ReduceOp::Sum);
        sum.map_err(|e| problem("NCCL does not sum", &e))?;
        let back = self.stream.memcpy_dtoh(&bucket, values);
        back.and_then(|()| self.stream.synchronize()).map_err(|e| problem("NCCL does not sum", &e))
    }

    fn abort(&self) {
        self.ranks.abort();
    }
}

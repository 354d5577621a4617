//! The other processes of a training, if a launcher has started several.

use crate::error::refuse;
use anyhow::Result;
use candle_core::Device;
use scenesplat::trainers::Collective;
use std::rc::Rc;

/// By these a process knows how many a launcher has started: Open MPI's, MPICH's and Slurm's PMI.
const SIZES: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE"];

fn launched() -> Option<(&'static str, usize)> {
    let size = |name: &&'static str| std::env::var(name).ok()?.parse().ok().map(|n| (*name, n));
    SIZES.iter().find_map(size)
}

/// The ranks, this one among them. Between CUDA devices gradients go by NCCL, if the program was built with it.
///
/// # Errors
/// If there are several, and this program cannot talk to them.
#[cfg(feature = "mpi")]
pub fn start(device: &Device) -> Result<Rc<dyn Collective>> {
    use anyhow::Context;
    use scenesplat::trainers::collective::MessagePassing;
    if launched().is_none() {
        return Ok(Rc::new(scenesplat::trainers::Alone));
    }
    let ranks = MessagePassing::start().context("MPI does not start in this process")?;
    #[cfg(feature = "nccl")]
    if device.is_cuda() && ranks.size() > 1 {
        use scenesplat::trainers::collective::Nccl;
        let rank = ranks.rank();
        let ranks = Nccl::start(ranks, device).with_context(|| format!("rank {rank}"))?;
        return Ok(Rc::new(ranks));
    }
    let _ = device;
    Ok(Rc::new(ranks))
}

/// The ranks, this one among them.
///
/// # Errors
/// If there are several, and this program cannot talk to them.
#[cfg(not(feature = "mpi"))]
pub fn start(_: &Device) -> Result<Rc<dyn Collective>> {
    match launched() {
        Some((name, size @ 2..)) => {
            refuse!(
                "{name}={size}: several processes were started, but this program was built without the feature mpi and \
                 each would train for itself: cargo build --release --features mpi"
            );
        }
        _ => Ok(Rc::new(scenesplat::trainers::Alone)),
    }
}

/// What became of the training; where this rank failed, says so and ends the others, which would wait for it.
pub fn all_end<T>(ranks: &dyn Collective, done: Result<T>) -> Result<T> {
    if let (Err(error), 2..) = (&done, ranks.size()) {
        crate::terminal::print_error(&anyhow::anyhow!(
            "rank {} of {}: {error:#}",
            ranks.rank(),
            ranks.size()
        ));
        ranks.abort();
    }
    done
}

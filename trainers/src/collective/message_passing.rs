//! Ranks that `mpirun` or `srun` has started.

use super::{Collective, CollectiveError};
use mpi::Count;
use mpi::datatype::{Partition, PartitionMut};
use mpi::environment::Universe;
use mpi::topology::{Communicator, SimpleCommunicator};
use mpi::traits::CommunicatorCollectives;
use std::fmt;

/// The ranks of an MPI world. A rank that dies takes the others with it, and the launcher names it.
pub struct MessagePassing {
    world: SimpleCommunicator,
    _universe: Universe,
}

impl MessagePassing {
    /// The world of this process, if it was started as one of several; once in a process.
    pub fn start() -> Option<Self> {
        let universe = mpi::initialize()?;
        Some(Self { world: universe.world(), _universe: universe })
    }

    fn count(&self, len: usize) -> Result<Count, CollectiveError> {
        Count::try_from(len).map_err(|_| CollectiveError::Disagreement {
            rank: self.rank(),
            problem: format!("{len} values are more than MPI can send at once"),
        })
    }

    /// Lengths that the ranks will send, and where they go.
    fn receiving(&self, lengths: &[Count]) -> Result<(Vec<Count>, usize), CollectiveError> {
        let (mut starts, mut sum) = (Vec::with_capacity(lengths.len()), 0);
        for &length in lengths {
            starts.push(self.count(sum)?);
            sum += length as usize;
        }
        self.count(sum)?;
        Ok((starts, sum))
    }
}

impl fmt::Debug for MessagePassing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MessagePassing({} of {})", self.rank(), self.size())
    }
}

impl Collective for MessagePassing {
    fn rank(&self) -> usize {
        usize::try_from(self.world.rank()).unwrap_or(0)
    }

    fn size(&self) -> usize {
        usize::try_from(self.world.size()).unwrap_or(1)
    }

    fn all_gather(&self, mine: &[u8]) -> Result<Vec<Vec<u8>>, CollectiveError> {
        let mut lengths: Vec<Count> = vec![0; self.size()];
        self.world.all_gather_into(&self.count(mine.len())?, &mut lengths[..]);
        let (starts, sum) = self.receiving(&lengths)?;
        let mut all = vec![0_u8; sum];
        let mut parts = PartitionMut::new(&mut all[..], lengths.clone(), &starts[..]);
        self.world.all_gather_varcount_into(mine, &mut parts);
        Ok(split(&all, &starts, &lengths))
    }

    fn all_to_all(&self, parts: &[&[f32]]) -> Result<Vec<Vec<f32>>, CollectiveError> {
        let counts = parts.iter().map(|part| self.count(part.len()));
        let counts = counts.collect::<Result<Vec<Count>, _>>()?;
        let mut lengths: Vec<Count> = vec![0; self.size()];
        self.world.all_to_all_into(&counts[..], &mut lengths[..]);
        let (to, _) = self.receiving(&counts)?;
        let (from, sum) = self.receiving(&lengths)?;
        let sent = parts.concat();
        let mut got = vec![0.0_f32; sum];
        let sending = Partition::new(&sent[..], counts, &to[..]);
        let mut getting = PartitionMut::new(&mut got[..], lengths.clone(), &from[..]);
        self.world.all_to_all_varcount_into(&sending, &mut getting);
        Ok(split(&got, &from, &lengths))
    }

    fn barrier(&self) -> Result<(), CollectiveError> {
        self.world.barrier();
        Ok(())
    }

    fn carrier(&self) -> &'static str {
        "MPI through the memory of the hosts"
    }

    fn abort(&self) {
        self.world.abort(1)
    }
}

fn split<T: Clone>(all: &[T], starts: &[Count], lengths: &[Count]) -> Vec<Vec<T>> {
    let part = |(start, length): (&Count, &Count)| {
        let start = *start as usize;
        all[start..start + *length as usize].to_vec()
    };
    starts.iter().zip(lengths).map(part).collect()
}

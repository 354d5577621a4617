//! Processes that train one network together.

#[cfg(feature = "mpi")]
mod message_passing;
#[cfg(feature = "nccl")]
mod nccl;
mod pairs;
mod step_peers;
#[cfg_attr(
    not(feature = "nccl"),
    allow(dead_code, reason = "tensors stay on devices with NCCL alone")
)]
mod tensors;
mod threads;

#[cfg(feature = "mpi")]
pub use message_passing::MessagePassing;
#[cfg(feature = "nccl")]
pub use nccl::Nccl;
pub(crate) use pairs::{InPairs, add_in_pairs};
pub(crate) use step_peers::StepPeers;
pub use threads::ThreadRank;

use candle_core::Tensor;
use std::fmt;

/// What goes wrong between processes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CollectiveError {
    /// Another process is gone.
    #[error("rank {rank} is gone")]
    Gone {
        /// Which.
        rank: usize,
    },
    /// Processes that do not say what was expected: they run other programs, or other settings.
    #[error("rank {rank}: {problem}")]
    Disagreement {
        /// Which.
        rank: usize,
        /// What is wrong.
        problem: String,
    },
    /// A device that does not send or receive.
    #[error("between the devices of the ranks: {problem}")]
    Device {
        /// What is wrong.
        problem: String,
    },
}

/// Processes of one training: rank 0 to `size - 1`. Every rank calls the same functions in the same order.
///
/// Data only move here; sums are made by those who have them, in the order of ranks, so that results repeat.
pub trait Collective: fmt::Debug {
    /// Which of them this is, from 0.
    fn rank(&self) -> usize;

    /// How many there are, at least 1.
    fn size(&self) -> usize;

    /// Gives every rank the bytes of all, in the order of ranks.
    ///
    /// # Errors
    /// If another rank is gone.
    fn all_gather(&self, mine: &[u8]) -> Result<Vec<Vec<u8>>, CollectiveError>;

    /// `parts[r]` goes to rank `r`; gives what the ranks sent to this one, in their order.
    ///
    /// # Errors
    /// If another rank is gone.
    fn all_to_all(&self, parts: &[&[f32]]) -> Result<Vec<Vec<f32>>, CollectiveError>;

    /// Waits until all are here.
    ///
    /// # Errors
    /// If another rank is gone.
    fn barrier(&self) -> Result<(), CollectiveError> {
        self.all_gather(&[]).map(drop)
    }

    /// Gives every rank the bytes of rank `root`; others give nothing.
    ///
    /// # Errors
    /// If another rank is gone.
    fn broadcast(&self, root: usize, bytes: &[u8]) -> Result<Vec<u8>, CollectiveError> {
        let mine = if self.rank() == root { bytes } else { &[] };
        let mut all = self.all_gather(mine)?;
        Ok(all.swap_remove(root))
    }

    /// Replaces `values` by the sum over the ranks, the same bits on all of them, of as many values on each: by pairs
    /// of ranks, pairs of pairs and so on. Each rank adds a part of the values, so that no more is sent than in a
    /// ring.
    ///
    /// # Errors
    /// If another rank is gone, or has another number of values.
    fn all_reduce(&self, values: &mut [f32]) -> Result<(), CollectiveError> {
        let ranks = self.size();
        let bound = |rank: usize| values.len() * rank / ranks;
        let parts: Vec<&[f32]> =
            (0..ranks).map(|rank| &values[bound(rank)..bound(rank + 1)]).collect();
        let mine = self.all_to_all(&parts)?;
        let expected = parts[self.rank()].len();
        if let Some(rank) = mine.iter().position(|part| part.len() != expected) {
            let problem = format!("sent {} values, not {expected}", mine[rank].len());
            return Err(CollectiveError::Disagreement { rank, problem });
        }
        let sum = add_in_pairs(mine);
        let to_all = vec![sum.as_slice(); ranks];
        let sums = self.all_to_all(&to_all)?;
        let mut rest = &mut values[..];
        for sum in sums {
            let (part, after) = rest.split_at_mut(sum.len());
            part.copy_from_slice(&sum);
            rest = after;
        }
        Ok(())
    }

    /// The sum over the ranks of as many f32 values (`[len]`) on each, where tensors go from device to device; with the bits of
    /// [`all_reduce`](Self::all_reduce). Nothing where they do not, and `all_reduce` is to be called.
    ///
    /// # Errors
    /// If another rank is gone, or a device does not answer.
    fn all_reduce_tensor(&self, values: &Tensor) -> Result<Option<Tensor>, CollectiveError> {
        let _ = values;
        Ok(None)
    }

    /// What carries gradients from rank to rank.
    fn carrier(&self) -> &'static str {
        "the memory of the host"
    }

    /// Ends all ranks, where nothing else would.
    fn abort(&self) {}
}

/// One process.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Alone;

impl Collective for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn all_gather(&self, mine: &[u8]) -> Result<Vec<Vec<u8>>, CollectiveError> {
        Ok(vec![mine.to_vec()])
    }

    fn all_to_all(&self, parts: &[&[f32]]) -> Result<Vec<Vec<f32>>, CollectiveError> {
        Ok(parts.iter().map(|part| part.to_vec()).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs `work` on so many ranks, and gives what they gave.
    fn on_ranks<R: Send>(size: usize, work: impl Fn(ThreadRank) -> R + Sync) -> Vec<R> {
        std::thread::scope(|scope| {
            let ranks = ThreadRank::group(size);
            let threads: Vec<_> =
                ranks.into_iter().map(|rank| scope.spawn(|| work(rank))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        })
    }

    #[test]
    fn everything_arrives_in_the_order_of_ranks() {
        for size in [1, 2, 3, 5] {
            let all = on_ranks(size, |rank| {
                let me = rank.rank();
                let mine = vec![me as u8; me + 1];
                let gathered = rank.all_gather(&mine).unwrap();
                let parts: Vec<Vec<f32>> =
                    (0..size).map(|to| vec![(10 * me + to) as f32; to + 1]).collect();
                let parts: Vec<&[f32]> = parts.iter().map(Vec::as_slice).collect();
                let got = rank.all_to_all(&parts).unwrap();
                rank.barrier().unwrap();
                let told = rank.broadcast(size - 1, &[me as u8, 7]).unwrap();
                (me, gathered, got, told)
            });
            for (me, gathered, got, told) in all {
                for (from, bytes) in gathered.iter().enumerate() {
                    assert_eq!(bytes, &vec![from as u8; from + 1]);
                }
                for (from, part) in got.iter().enumerate() {
                    assert_eq!(part, &vec![(10 * from + me) as f32; me + 1]);
                }
                assert_eq!(told, [size as u8 - 1, 7]);
            }
        }
    }

    #[test]
    fn sums_are_those_of_pairs_whatever_the_length() {
        // Of these the order of addition can be told.
        let value = |rank: usize, i: usize| [1e8_f32, 1.0, -1e8, 0.25][rank] * (1.0 + i as f32);
        for len in [0, 1, 3, 4, 10] {
            let all = on_ranks(4, |rank| {
                let mut values: Vec<f32> = (0..len).map(|i| value(rank.rank(), i)).collect();
                rank.all_reduce(&mut values).unwrap();
                values
            });
            let expected: Vec<f32> = (0..len)
                .map(|i| (value(0, i) + value(1, i)) + (value(2, i) + value(3, i)))
                .collect();
            for sums in all {
                assert_eq!(sums, expected);
            }
        }
    }

    #[test]
    fn ranks_that_are_gone_or_disagree_are_named() {
        let found = on_ranks(3, |rank| {
            if rank.rank() == 1 {
                return None;
            }
            Some(rank.all_gather(&[1]).unwrap_err())
        });
        for error in found.into_iter().flatten() {
            assert_eq!(error, CollectiveError::Gone { rank: 1 });
        }
        let found = on_ranks(2, |rank| {
            let mut values = vec![1.0; 2 + 2 * rank.rank()];
            rank.all_reduce(&mut values).unwrap_err().to_string()
        });
        assert!(found[0].contains("rank 1: sent 2 values, not 1"), "{found:?}");
    }
}

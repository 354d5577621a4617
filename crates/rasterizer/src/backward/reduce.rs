//! From records per (tile, Gaussian) to sums per Gaussian.

use crate::{RasterError, TileLists};
use rayon::prelude::*;

/// Rows of one task.
pub(crate) const CHUNK: usize = 2048;

/// For each visible Gaussian where its records are, in the order of the tiles.
#[derive(Debug, Default)]
pub(crate) struct PairsOfRow {
    /// One more than rows.
    offsets: Vec<u32>,
    pairs: Vec<u32>,
    /// Places that are next, while it is filled.
    next: Vec<u32>,
}

impl PairsOfRow {
    /// Finds the records of `rows` Gaussians.
    pub(crate) fn fill(&mut self, lists: &TileLists, rows: usize) -> Result<(), RasterError> {
        let limit = u32::MAX as usize - 1;
        let count = lists.entries.len();
        if count > limit {
            return Err(RasterError::TooMany { what: "Gaussians in lists of tiles", count, limit });
        }
        let Self { offsets, pairs, next } = self;
        offsets.clear();
        offsets.resize(rows + 1, 0);
        for &row in &lists.entries {
            offsets[row as usize + 1] += 1;
        }
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        next.clone_from(offsets);
        pairs.resize(count, 0);
        for (pair, &row) in lists.entries.iter().enumerate() {
            let at = &mut next[row as usize];
            pairs[*at as usize] = pair as u32;
            *at += 1;
        }
        Ok(())
    }

    /// Records of a row.
    #[inline(always)]
    fn of(&self, row: usize) -> &[u32] {
        &self.pairs[self.offsets[row] as usize..self.offsets[row + 1] as usize]
    }

    /// The sum of a row's records.
    #[inline(always)]
    pub(crate) fn sum<const K: usize>(&self, row: usize, records: &[[f32; K]]) -> [f32; K] {
        let mut sum = [0.0; K];
        for &pair in self.of(row) {
            let record = &records[pair as usize];
            for k in 0..K {
                sum[k] += record[k];
            }
        }
        sum
    }

    /// Gives every row of `out` the sum of its records.
    pub(crate) fn each<const K: usize, T: Send>(
        &self,
        records: &[[f32; K]],
        out: &mut [T],
        put: impl Fn(usize, [f32; K], &mut T) + Sync,
    ) {
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(i, out)| {
            for (k, out) in out.iter_mut().enumerate() {
                let row = i * CHUNK + k;
                put(row, self.sum(row, records), out);
            }
        });
    }
}

/// Cuts `values` (`width` per Gaussian) where chunks of visible rows begin, so that each task has
/// the Gaussians of its rows to itself. `index` ascends.
pub(crate) fn cut<'a, T>(values: &'a mut [T], index: &[u32], width: usize) -> Vec<&'a mut [T]> {
    let mut rest = values;
    let mut at = 0;
    let mut parts = Vec::with_capacity(index.len().div_ceil(CHUNK));
    for chunk in index.chunks(CHUNK) {
        let (Some(&first), Some(&last)) = (chunk.first(), chunk.last()) else { break };
        let (first, end) = (first as usize * width, (last as usize + 1) * width);
        let (_, tail) = std::mem::take(&mut rest).split_at_mut(first - at);
        let (part, tail) = tail.split_at_mut(end - first);
        parts.push(part);
        (rest, at) = (tail, end);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_cover_the_rows_of_their_chunk() {
        for n in [0, 1, CHUNK, CHUNK + 1, 3 * CHUNK + 7] {
            let index: Vec<u32> = (0..n as u32).map(|i| 3 * i + 2).collect();
            let mut values: Vec<u32> = (0..6 * n as u32 + 10).collect();
            let parts = cut(&mut values, &index, 2);
            assert_eq!(parts.len(), n.div_ceil(CHUNK));
            for (part, chunk) in parts.iter().zip(index.chunks(CHUNK)) {
                assert_eq!(part.first(), chunk.first().map(|i| 2 * i).as_ref());
                assert_eq!(part.last(), chunk.last().map(|i| 2 * i + 1).as_ref());
            }
        }
    }

    #[test]
    fn every_record_is_summed_once_in_order() {
        let lists = TileLists {
            columns: 3,
            rows: 1,
            offsets: vec![0, 2, 3, 6],
            entries: vec![2, 0, 2, 0, 1, 2],
            reach: vec![0; 6],
        };
        let mut pairs = PairsOfRow::default();
        // The second time with what the first has left.
        for _ in 0..2 {
            assert!(pairs.fill(&lists, 4).is_ok());
            let found = [0, 1, 2, 3].map(|row| pairs.of(row).to_vec());
            assert_eq!(found, [vec![1, 3], vec![4], vec![0, 2, 5], vec![]]);
        }
    }
}

use crate::error::{check_labels, check_num_classes, check_num_rows, check_rows};
use crate::{IGNORE, KdTree, MetricError, Neighbor};
use rayon::prelude::*;
use std::collections::BinaryHeap;

/// Queries handled by one task; large enough that its buffers pay.
const CHUNK: usize = 256;

/// The majority label among the `k` nearest labelled points, for each query point.
///
/// Carries labels from splats to the points a benchmark is scored on, and smooths them.
///
/// - Only points with `valid` vote (all if `None`). A voter without a label (-1) takes up one of the
///   `k` places and counts for no class.
/// - Equally near points: the smaller row is nearer. Equally frequent labels: the smaller class wins.
/// - If no neighbour has a label, or there is no voter, the result is -1.
/// - `k` is cut to the number of voters.
///
/// # Shapes
/// - `reference`: `[N, 3]` metres · `labels`: `[N]` · `valid`: `[N]` · `query`: `[M, 3]` metres
/// - returns `[M]`, -1 or below `num_classes`
///
/// # Errors
/// If lengths differ, a label is out of range, `k` is 0, or a query or voting point is not finite.
///
/// # Source
/// `neighbor_voting`, SceneSplat be9d5e1. Differs: distances in f64, ties of distance settled, and
/// `k` above the number of voters is no index error.
///
/// ```
/// let reference = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
/// let voted = scenesplat_metrics::vote(&reference, &[3, 1, -1], None, &[[1.9, 0.0, 0.0]], 2, 4)?;
/// assert_eq!(voted, [1]);
/// # Ok::<(), scenesplat_metrics::MetricError>(())
/// ```
pub fn vote(
    reference: &[[f32; 3]],
    labels: &[i32],
    valid: Option<&[bool]>,
    query: &[[f32; 3]],
    k: usize,
    num_classes: usize,
) -> Result<Vec<i32>, MetricError> {
    check_vote(reference, labels, valid, query, k, num_classes)?;
    let votes = |&row: &usize| valid.is_none_or(|valid| valid[row]);
    let tree = KdTree::of_rows(reference, (0..reference.len()).filter(votes))?;
    let order = near_each_other(query);
    let mut voted = vec![IGNORE; query.len()];
    let answers: Vec<Vec<i32>> = order
        .par_chunks(CHUNK)
        .map_init(
            || (Ballot::new(num_classes), BinaryHeap::new()),
            |(ballot, found), rows| {
                let answer = |&row: &u32| {
                    tree.search(query[row as usize], k, found);
                    ballot.winner(found.iter().map(|n: &Neighbor| labels[n.row as usize]))
                };
                rows.iter().map(answer).collect()
            },
        )
        .collect();
    for (&row, answer) in order.iter().zip(answers.into_iter().flatten()) {
        voted[row as usize] = answer;
    }
    Ok(voted)
}

/// The checks that every implementation of the vote shares.
pub(crate) fn check_vote(
    reference: &[[f32; 3]],
    labels: &[i32],
    valid: Option<&[bool]>,
    query: &[[f32; 3]],
    k: usize,
    num_classes: usize,
) -> Result<(), MetricError> {
    check_num_classes(num_classes)?;
    check_rows("reference labels", labels.len(), reference.len())?;
    if let Some(valid) = valid {
        check_rows("valid mask", valid.len(), reference.len())?;
    }
    check_labels("reference labels", labels, num_classes)?;
    if k == 0 {
        return Err(MetricError::Setting { field: "k", value: 0.0, expected: "at least 1" });
    }
    check_num_rows("query coord", query.len())?;
    match query.iter().position(|q| !q.iter().all(|v| v.is_finite())) {
        None => Ok(()),
        Some(row) => Err(MetricError::NonFinite { what: "query coord", row, value: query[row] }),
    }
}

/// The rows in an order in which neighbours in the list are neighbours in space, so that
/// consecutive searches touch the same memory. Scenes arrive in hash order.
fn near_each_other(coord: &[[f32; 3]]) -> Vec<u32> {
    let mut lower = [f32::INFINITY; 3];
    let mut upper = [f32::NEG_INFINITY; 3];
    for c in coord {
        for i in 0..3 {
            lower[i] = lower[i].min(c[i]);
            upper[i] = upper[i].max(c[i]);
        }
    }
    let extent = (0..3).map(|i| f64::from(upper[i]) - f64::from(lower[i])).fold(0.0, f64::max);
    let cells = 1023.0 / extent.max(f64::MIN_POSITIVE);
    let mut order: Vec<(u32, u32)> = (0_u32..)
        .zip(coord)
        .map(|(row, c)| {
            let cell = |i: usize| ((f64::from(c[i]) - f64::from(lower[i])) * cells) as u32;
            (spread(cell(0)) | spread(cell(1)) << 1 | spread(cell(2)) << 2, row)
        })
        .collect();
    order.par_sort_unstable();
    order.into_iter().map(|(_, row)| row).collect()
}

/// Moves bit `i` of a 10-bit number to bit `3 i`.
fn spread(v: u32) -> u32 {
    let v = v.min(1023);
    let v = (v | v << 16) & 0x0300_00FF;
    let v = (v | v << 8) & 0x0300_F00F;
    let v = (v | v << 4) & 0x030C_30C3;
    (v | v << 2) & 0x0924_9249
}

/// Counts votes for classes; empty between elections.
struct Ballot {
    votes: Vec<u32>,
    classes: Vec<usize>,
}

impl Ballot {
    fn new(num_classes: usize) -> Self {
        Self { votes: vec![0; num_classes], classes: Vec::new() }
    }

    fn winner(&mut self, labels: impl Iterator<Item = i32>) -> i32 {
        for label in labels {
            let Ok(class) = usize::try_from(label) else { continue };
            if self.votes[class] == 0 {
                self.classes.push(class);
            }
            self.votes[class] += 1;
        }
        let mut best = (0, IGNORE);
        for class in self.classes.drain(..) {
            let (votes, label) = (std::mem::take(&mut self.votes[class]), class as i32);
            if votes > best.0 || (votes == best.0 && label < best.1) {
                best = (votes, label);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn majorities_of_the_specification() {
        let mut ballot = Ballot::new(8);
        for (labels, winner) in
            [([3, 3, 1, 1, -1], 1), ([-1; 5], -1), ([2, 0, 0, 2, 7], 0), ([5, 4, 4, 5, -1], 4)]
        {
            assert_eq!(ballot.winner(labels.into_iter()), winner);
        }
    }

    #[test]
    fn spreads_ten_bits() {
        assert_eq!(spread(0b11), 0b1001);
        assert_eq!(spread(1023), 0x0924_9249);
        assert_eq!(spread(u32::MAX), 0x0924_9249);
    }
}

use crate::error::{check_labels, check_num_classes, check_num_rows, check_rows, check_setting};
use crate::{IGNORE, KdTree, MetricError};

/// The most neighbors that may vote: more ask all of a scene for each of its points.
pub const MAX_VOTERS: usize = 4096;

/// Removes the label from rows that had none before a vote among themselves: a row that was withheld as
/// unknown abstains and remains unknown.
///
/// # Shapes
/// - `before`, `after`: `[N]`; the rest of the longer one is kept
pub fn keep_withheld(before: &[i32], after: &mut [i32]) {
    for (after, &before) in after.iter_mut().zip(before) {
        if before == IGNORE {
            *after = IGNORE;
        }
    }
}

/// The majority label among the `k` nearest labeled points, for each query point.
///
/// Carries labels from splats to the points a benchmark is scored on, and smooths them.
///
/// - Only points with `valid` vote (all if `None`). A voter without a label (-1) takes up one of the
///   `k` places and counts for no class.
/// - Equally near points: the smaller row is nearer. Equally frequent labels: the smaller class wins.
/// - If no neighbor has a label, or there is no voter, the result is -1.
/// - `k` is cut to the number of voters.
///
/// # Shapes
/// - `reference`: `[N, 3]` meters · `labels`: `[N]` · `valid`: `[N]` · `query`: `[M, 3]` meters
/// - returns `[M]`, -1 or below `num_classes`
///
/// # Errors
/// If lengths differ, a label is out of range, `k` is 0 or above [`MAX_VOTERS`], or a query or voting point is not finite.
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
    Ok(tree.map_nearest(
        query,
        k,
        || Ballot::new(num_classes),
        |ballot, _, near| ballot.winner(near.iter().map(|n| labels[n.row as usize])),
    ))
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
    check_setting("k", k as f64, "1 to 4096", (1..=MAX_VOTERS).contains(&k))?;
    check_num_rows("query coord", query.len())?;
    match query.iter().position(|q| !q.iter().all(|v| v.is_finite())) {
        None => Ok(()),
        Some(row) => Err(MetricError::NonFinite { what: "query coord", row, value: query[row] }),
    }
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
    fn as_many_neighbors_vote_as_is_worth_it() {
        let at = [[0.0; 3]];
        let refused = |k: usize| vote(&at, &[0], None, &at, k, 1).is_err();
        assert!(refused(0) && refused(MAX_VOTERS + 1) && refused(usize::MAX));
        assert!(!refused(1) && !refused(MAX_VOTERS));
    }
}

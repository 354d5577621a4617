use crate::error::{check_labels, check_num_classes, check_rows};
use crate::{IGNORE, MetricError};

/// Gives all rows of one instance the label most of them have.
///
/// Within each instance id other than -1 every label is counted, **-1 too**: an instance that is
/// mostly undecided becomes undecided. Ties go to the smallest label, so to -1 first. Rows of
/// instance -1 keep their labels. Ids below -1 are instances like any other.
///
/// With instances taken from the ground truth this is a look at the answers and inflates a score;
/// the original does so silently whenever it finds an instance file. Here it happens only when
/// called.
///
/// # Shapes
/// - `labels`, `instances`: `[N]` · returns `[N]`
///
/// # Errors
/// If lengths differ or a label is out of range.
///
/// # Source
/// `clustering_voting`, SceneSplat be9d5e1.
pub fn instance_vote(
    labels: &[i32],
    instances: &[i32],
    num_classes: usize,
) -> Result<Vec<i32>, MetricError> {
    check_num_classes(num_classes)?;
    check_rows("instances", instances.len(), labels.len())?;
    check_labels("labels", labels, num_classes)?;
    let mut order: Vec<usize> = (0..labels.len()).filter(|&i| instances[i] != IGNORE).collect();
    order.sort_unstable_by_key(|&i| (instances[i], labels[i]));
    let mut voted = labels.to_vec();
    for members in order.chunk_by(|&a, &b| instances[a] == instances[b]) {
        let mut best = (0, IGNORE);
        // Runs come in rising label order, so a later one must be longer to win.
        for run in members.chunk_by(|&a, &b| labels[a] == labels[b]) {
            if run.len() > best.0 {
                best = (run.len(), labels[run[0]]);
            }
        }
        for &i in members {
            voted[i] = best.1;
        }
    }
    Ok(voted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_withheld_labels_and_breaks_ties_downwards() {
        let labels = [2, 1, 5, -1, -1, 4, 3, 3];
        let instances = [7, 7, -1, -2, -2, -2, 9, 9];
        let voted = instance_vote(&labels, &instances, 6).unwrap();
        assert_eq!(voted, [1, 1, 5, -1, -1, -1, 3, 3]);
    }

    #[test]
    fn empty_and_malformed_inputs() {
        assert!(instance_vote(&[], &[], 1).unwrap().is_empty());
        assert!(matches!(instance_vote(&[0], &[], 1), Err(MetricError::RowCount { .. })));
        assert!(matches!(
            instance_vote(&[0, 3], &[0, 0], 3),
            Err(MetricError::LabelRange { row: 1, value: 3, .. })
        ));
    }
}

//! What the original's evaluation does to labels after the vote, and this project does not: needed to hold
//! the rest of the chain against its numbers.

use scenesplat_metrics::IGNORE;
use std::collections::BTreeMap;

/// `clustering_voting`: all rows of one instance get the label most of them have.
///
/// Within each instance id other than -1 every label is counted, -1 too; ties go to the smallest label.
/// With instances of the ground truth this is a look at the answers; the original does it silently
/// whenever it finds an instance file.
pub fn instance_vote(labels: &[i32], instances: &[i32]) -> Vec<i32> {
    assert_eq!(labels.len(), instances.len());
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
    voted
}

/// The prediction label mapping: labels without an entry stay. The original's evaluator maps after
/// voting and its tester before, which differs when two labels are merged.
pub fn remap_labels(labels: &mut [i32], map: &BTreeMap<i32, i32>) {
    for label in labels {
        *label = map.get(label).copied().unwrap_or(*label);
    }
}

#[test]
fn instances_count_withheld_labels_and_break_ties_downwards() {
    let labels = [2, 1, 5, -1, -1, 4, 3, 3];
    let instances = [7, 7, -1, -2, -2, -2, 9, 9];
    assert_eq!(instance_vote(&labels, &instances), [1, 1, 5, -1, -1, -1, 3, 3]);
}

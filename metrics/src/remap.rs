use crate::error::check_num_classes;
use crate::{IGNORE, MetricError};
use std::collections::BTreeMap;

/// Replaces labels by `map`; labels without an entry, -1 among them, stay.
///
/// All replacements look at the old label, so a swap `{4: 5, 5: 4}` is a swap. Keys may be any
/// value (`{255: -1}` turns a data set's own marker into "no label"); after the replacement every
/// label must be -1 or below `num_classes`.
///
/// # Errors
/// If a label is out of range afterwards; `labels` is then unchanged.
///
/// # Source
/// The prediction label mapping of the zero-shot evaluator and tester, SceneSplat be9d5e1. There
/// the evaluator maps after voting and the tester before, which differs when two labels are merged;
/// the caller chooses by calling.
pub fn remap_labels(
    labels: &mut [i32],
    map: &BTreeMap<i32, i32>,
    num_classes: usize,
) -> Result<(), MetricError> {
    check_num_classes(num_classes)?;
    let get = |label: i32| map.get(&label).copied().unwrap_or(label);
    let fits = |v: i32| v == IGNORE || usize::try_from(v).is_ok_and(|v| v < num_classes);
    if let Some(row) = labels.iter().position(|&label| !fits(get(label))) {
        let value = get(labels[row]);
        return Err(MetricError::LabelRange { what: "remapped label", row, value, num_classes });
    }
    for label in labels.iter_mut() {
        *label = get(*label);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swap_is_a_swap_and_markers_become_none() {
        let mut labels = [4, 5, 255, -1, 0];
        let map = BTreeMap::from([(4, 5), (5, 4), (255, -1)]);
        remap_labels(&mut labels, &map, 6).unwrap();
        assert_eq!(labels, [5, 4, -1, -1, 0]);
    }

    #[test]
    fn a_bad_target_leaves_the_labels_alone() {
        let mut labels = [1, 0];
        let error = remap_labels(&mut labels, &BTreeMap::from([(0, 9)]), 2).unwrap_err();
        assert!(error.to_string().contains("remapped label[1] is 9"), "{error}");
        assert_eq!(labels, [1, 0]);
    }
}

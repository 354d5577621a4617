//! Counts and reports: numbers by hand, merging, relabelling, nothing to count.

use crate::support::{close, random_labels, rng};
use rand::seq::SliceRandom;
use scenesplat_metrics::{ConfusionMatrix, Measurement, Metric, MetricError};

fn matrix(classes: usize, prediction: &[i32], label: &[i32]) -> ConfusionMatrix {
    let mut matrix = ConfusionMatrix::new(classes).unwrap();
    matrix.update((prediction, label)).unwrap();
    matrix
}

#[test]
fn numbers_by_hand() {
    let prediction = [0, 1, 2, -1, 1, 2];
    let label = [0, 2, 2, 1, -1, 1];
    let tester = matrix(3, &prediction, &label).tester_report();
    let counts: Vec<_> =
        tester.classes.iter().map(|c| (c.intersection, c.union, c.target)).collect();
    assert_eq!(counts, [(1, 1, 1), (0, 3, 2), (1, 3, 2)]);
    close(tester.mean_iou.unwrap(), 4.0 / 9.0, 1e-9, "mIoU");
    close(tester.mean_accuracy.unwrap(), 0.5, 1e-9, "mAcc");
    assert_eq!(tester.all_accuracy, Some(0.4));

    let evaluator = matrix(3, &prediction, &label).evaluator_report();
    let counts: Vec<_> = evaluator
        .classes
        .iter()
        .map(|c| (c.true_positive, c.false_positive, c.false_negative))
        .collect();
    assert_eq!(counts, [(1, 0, 0), (0, 1, 2), (1, 1, 1)]);
    close(evaluator.mean_iou.unwrap(), 4.0 / 9.0, 1e-12, "mIoU");
    // Class 1 has one row with a prediction, which is wrong; the withheld one is not counted.
    assert_eq!(evaluator.classes[1].accuracy, Some(0.0));
    assert_eq!(evaluator.global_accuracy, Some(0.5));
}

#[test]
fn the_two_definitions_differ_on_predicted_but_absent_classes() {
    let both = matrix(3, &[0, 0, 2, -1], &[0, 0, 0, 1]);
    close(both.tester_report().mean_iou.unwrap(), (2.0 / 3.0) / 3.0, 1e-9, "tester");
    close(both.evaluator_report().mean_iou.unwrap(), (2.0 / 3.0) / 2.0, 1e-9, "evaluator");
    assert_eq!(both.tester_report().all_accuracy, Some(0.5));
    assert_eq!(both.evaluator_report().global_accuracy, Some(2.0 / 3.0));
}

#[test]
fn excluded_classes_leave_only_the_foreground_means() {
    let mut matrix = ConfusionMatrix::new(3).unwrap().with_excluded(&[0, 0]).unwrap();
    matrix.update((&[0, 1, 1, 0], &[0, 1, 2, 2])).unwrap();
    let report = matrix.tester_report();
    close(report.mean_iou.unwrap(), (0.5 + 0.5 + 0.0) / 3.0, 1e-9, "mIoU");
    close(report.foreground_mean_iou.unwrap(), 0.25, 1e-9, "f-mIoU");
    close(matrix.evaluator_report().foreground_mean_iou.unwrap(), 0.25, 1e-9, "fg_mIoU");
    let names: Vec<String> = matrix.measure().into_iter().map(|m| m.name).collect();
    assert_eq!(names, ["mIoU", "mAcc", "allAcc", "f-mIoU", "f-mAcc"]);
}

#[test]
fn nothing_counted_is_none_and_never_nan() {
    let none: [Measurement; 0] = [];
    for matrix in [
        ConfusionMatrix::new(2).unwrap(),
        matrix(2, &[], &[]),
        matrix(2, &[0, -1, 1], &[-1, -1, -1]),
    ] {
        assert_eq!(matrix.num_labelled(), 0);
        assert_eq!(matrix.measure(), none);
        let report = matrix.evaluator_report();
        assert_eq!((report.mean_iou, report.global_accuracy), (None, None));
        assert!(report.classes.iter().all(|c| c.iou.is_none() && c.accuracy.is_none()));
    }
    // All withheld: known to be wrong, not undefined.
    let withheld = matrix(2, &[-1, -1], &[1, 1]);
    assert_eq!(withheld.tester_report().mean_iou, Some(0.0));
    assert_eq!(withheld.evaluator_report().mean_accuracy, None);
    let everything = ConfusionMatrix::new(1).unwrap().with_excluded(&[0]).unwrap();
    assert_eq!(everything.tester_report().foreground_mean_iou, None);
    let single = matrix(1, &[0], &[0]).tester_report();
    close(single.mean_iou.unwrap(), 1.0, 1e-9, "single class");
}

#[test]
fn any_split_into_updates_and_workers_is_the_same() {
    let rng = &mut rng(1);
    let (prediction, label) = (random_labels(rng, 999, 7), random_labels(rng, 999, 7));
    let whole = matrix(7, &prediction, &label);
    let mut merged = ConfusionMatrix::new(7).unwrap();
    for (p, l) in prediction.chunks(100).zip(label.chunks(100)).rev() {
        merged.merge(&matrix(7, p, l)).unwrap();
    }
    assert_eq!(merged, whole);
    let other = ConfusionMatrix::new(8).unwrap();
    assert!(matches!(merged.merge(&other), Err(MetricError::ClassCount { .. })));
    let other = ConfusionMatrix::new(7).unwrap().with_excluded(&[3]).unwrap();
    assert!(matches!(merged.merge(&other), Err(MetricError::ClassRange { class: 3, .. })));
    assert_eq!(merged, whole);
}

#[test]
fn relabelling_both_sides_changes_no_mean() {
    for seed in 0..20 {
        let rng = &mut rng(seed);
        let (prediction, label) = (random_labels(rng, 300, 9), random_labels(rng, 300, 9));
        let mut names: Vec<i32> = (0..9).collect();
        names.shuffle(rng);
        let rename = |labels: &[i32]| -> Vec<i32> {
            labels.iter().map(|&l| if l < 0 { l } else { names[l as usize] }).collect()
        };
        let before = matrix(9, &prediction, &label);
        let after = matrix(9, &rename(&prediction), &rename(&label));
        let pairs = before.measure().into_iter().zip(after.measure()).chain(
            before
                .evaluator_report()
                .measurements()
                .into_iter()
                .zip(after.evaluator_report().measurements()),
        );
        for (a, b) in pairs {
            assert_eq!(a.name, b.name);
            close(a.value, b.value, 1e-12, &a.name);
        }
    }
}

#[test]
fn bad_labels_are_named_and_change_nothing() {
    let mut matrix = matrix(2, &[1], &[0]);
    let before = matrix.clone();
    for (prediction, label, message) in [
        (vec![0, 0, 2], vec![0, 0, 0], "prediction[2] is 2, expected -1 or a class below 2"),
        (vec![0, -2], vec![0, 0], "prediction[1] is -2, expected -1 or a class below 2"),
        (vec![0, 0], vec![0, 255], "label[1] is 255, expected -1 or a class below 2"),
        (vec![0], vec![i32::MIN], "label[0] is -2147483648, expected -1 or a class below 2"),
        (vec![0], vec![], "prediction: expected 0 rows, got 1"),
    ] {
        let error = matrix.update((&prediction, &label)).unwrap_err();
        assert_eq!(error.to_string(), message);
        assert_eq!(matrix, before);
    }
    assert!(ConfusionMatrix::new(0).is_err() && ConfusionMatrix::new(usize::MAX).is_err());
    let error = ConfusionMatrix::new(2).unwrap().with_excluded(&[2]).unwrap_err();
    assert_eq!(error.to_string(), "excluded: class 2 does not exist, there are 2");
}

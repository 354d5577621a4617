//! Labels by cosine, and what is counted of them.

use super::compare::{Wide, compare};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::{Noise, noise};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, Metric, TextRows, UnknownRule, ZeroShotOptions, classify,
    cosine_scores, sigmoid_threshold_to_cosine,
};

/// Width of the features: no multiple of a register.
const D: usize = 45;
/// Classes.
const C: usize = 7;

pub(super) fn cases() -> Vec<Case> {
    vec![
        case("cosine-scores", scores),
        case("labels-with-a-margin", argmax),
        case("labels-with-ties", |_| {
            let texts = [1.0, 0.0, 0.0, 1.0, 1.0, 0.0];
            let found =
                labels(&[3.0, 3.0, 1.0, 0.0, 0.0, 2.0], &texts, 2, &ZeroShotOptions::default())?;
            ensure!(found == [0, 0, 1], "{found:?}, [0, 0, 1] is right");
            Ok(())
        }),
        case("rows-without-a-direction", no_direction),
        case("unknown-threshold-can-fire", |_| {
            let min_cosine = Some(sigmoid_threshold_to_cosine(0.6));
            let unknown = UnknownRule { min_cosine, min_margin: None };
            let options = ZeroShotOptions { unknown, ..ZeroShotOptions::default() };
            // The sigmoid of 0.405 is 0.6.
            let features = [0.9, 0.435_889_9, 0.35, 0.936_749_9];
            let found = labels(&features, &[1.0, 0.0], 2, &options)?;
            ensure!(found == [0, -1], "{found:?}, [0, -1] is right");
            Ok(())
        }),
        case("candidates-compete-alone", |_| {
            let among = |candidates: [bool; 2]| {
                let candidates = Some(candidates.to_vec());
                let options = ZeroShotOptions { candidates, ..ZeroShotOptions::default() };
                labels(&[1.0, 0.1], &[1.0, 0.0, 0.0, 1.0], 2, &options)
            };
            let found = among([false, true])?;
            ensure!(found == [1], "{found:?}");
            ensure!(among([false; 2]).is_err(), "nobody competes");
            Ok(())
        }),
        case("texts-that-are-not-normalised", |_| {
            for bad in [[2.0, 0.0], [0.0, 0.0], [f32::NAN, 0.0], [0.99, 0.0]] {
                let rows = [1.0, 0.0, bad[0], bad[1]];
                ensure!(TextRows::new(&rows, 2).is_err(), "{bad:?} is taken for a text");
            }
            Ok(())
        }),
        case("confusion-by-hand", confusion),
        case("confusion-of-nothing", confusion_of_nothing),
        case("labels-beyond-the-classes", |_| {
            for (predicted, truth) in [(7, 0), (0, 7), (-2, 0), (0, -2), (i32::MAX, 0)] {
                let taken = ConfusionMatrix::new(C)?.update((&[predicted], &[truth])).is_ok();
                ensure!(!taken, "predicted {predicted}, true {truth} is taken");
            }
            let uneven = ConfusionMatrix::new(C)?.update((&[0, 1], &[0]));
            ensure!(uneven.is_err(), "2 predictions for 1 row");
            Ok(())
        }),
        case("confusion-in-parts", confusion_in_parts),
    ]
}

fn no_direction(_: &Trial<'_>) -> Result<(), Failure> {
    let features = [0.0, 0.0, f32::NAN, 1.0, f32::INFINITY, 1.0, 1e-42, 0.0, 3e38, 3e38];
    let (features, texts) = (FeatureSlice::new(&features, 2)?, [1.0, 0.0, 0.0, 1.0]);
    let found = classify(&features, TextRows::new(&texts, 2)?, &ZeroShotOptions::default())?;
    ensure!(found.labels == [-1, -1, -1, 0, 0], "labels {:?}", found.labels);
    ensure!(found.num_unusable == 3, "{} rows are unusable", found.num_unusable);
    ensure!(found.scores.iter().all(|s| s.is_finite()), "a score is not finite");
    Ok(())
}

fn confusion_of_nothing(_: &Trial<'_>) -> Result<(), Failure> {
    let report = ConfusionMatrix::new(C)?.tester_report();
    let means = [report.mean_iou, report.mean_accuracy, report.all_accuracy];
    ensure!(means == [None; 3], "{means:?}");
    ensure!(report.measurements().is_empty(), "a number of nothing is reported");
    let mut ignored = ConfusionMatrix::new(C)?;
    ignored.update((&[0, 1, -1], &[-1, -1, -1]))?;
    ensure!(ignored.num_labelled() == 0, "rows without a truth are counted");
    ensure!(ignored.evaluator_report().mean_iou.is_none(), "and have a mean");
    Ok(())
}

fn confusion_in_parts(_: &Trial<'_>) -> Result<(), Failure> {
    let mut rng = Noise::new(5);
    let mut list = |n: usize| -> Vec<i32> { (0..n).map(|_| rng.below(C + 1) as i32 - 1).collect() };
    let (predicted, truth) = (list(3000), list(3000));
    let mut whole = ConfusionMatrix::new(C)?;
    whole.update((&predicted, &truth))?;
    let mut parts = ConfusionMatrix::new(C)?;
    for (p, t) in predicted.chunks(700).zip(truth.chunks(700)) {
        let mut part = ConfusionMatrix::new(C)?;
        part.update((p, t))?;
        parts.merge(&part)?;
    }
    ensure!(whole.counts() == parts.counts(), "parts count otherwise");
    ensure!(whole.unassigned() == parts.unassigned(), "parts withhold otherwise");
    Ok(())
}

fn labels(
    features: &[f32],
    texts: &[f32],
    dim: usize,
    options: &ZeroShotOptions,
) -> Result<Vec<i32>, Failure> {
    let features = FeatureSlice::new(features, dim)?;
    Ok(classify(&features, TextRows::new(texts, dim)?, options)?.labels)
}

/// Unit rows, divided by their norm in f64.
fn texts() -> Vec<f32> {
    let mut rows = noise(C * D, 1, 1.0);
    for row in rows.chunks_exact_mut(D) {
        let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        row.iter_mut().for_each(|v| *v = (f64::from(*v) / norm) as f32);
    }
    rows
}

/// Rows of all sizes.
fn features() -> Vec<f32> {
    let sizes = [1.0, 1e-30, 1e30, 1e-15, 1e38];
    (0..400).flat_map(|row| noise(D, 10 + row as u64, sizes[row % 5])).collect()
}

/// Cosines of a row with all texts.
fn cosines(row: &[f32], texts: &[f32]) -> Vec<f64> {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    };
    let norm = dot(row, row).sqrt();
    texts.chunks_exact(D).map(|t| dot(row, t) / norm / dot(t, t).sqrt()).collect()
}

fn scores(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let (texts, features) = (texts(), features());
    trial.keep("features", &features)?;
    let got = trial.one_and_many(|| {
        Ok(cosine_scores(&FeatureSlice::new(&features, D)?, TextRows::new(&texts, D)?)?)
    })?;
    let want: Vec<Wide> = features
        .chunks_exact(D)
        .flat_map(|row| cosines(row, &texts))
        .map(|value| Wide::of(value, 1.0))
        .collect();
    compare(&got, &want, |i| format!("row {}, class {}", i / C, i % C))
}

fn argmax(trial: &Trial<'_>) -> Result<(), Failure> {
    let (texts, features) = (texts(), features());
    let found =
        trial.same_on_threads(|| labels(&features, &texts, D, &ZeroShotOptions::default()))?;
    let (mut flips, mut doubtful) = (0, 0);
    for (row, label) in features.chunks_exact(D).zip(found) {
        let cosines = cosines(row, &texts);
        let best = (0..C).max_by(|a, b| cosines[*a].total_cmp(&cosines[*b])).unwrap_or(0);
        let lead = cosines[best]
            - (0..C).filter(|c| *c != best).map(|c| cosines[c]).fold(f64::MIN, f64::max);
        let right = label == best as i32;
        // Strict outside of what f32 can tell apart; a flip within is a tie.
        ensure!(right || lead < 1e-6, "label {label}, {best} leads by {lead:e}");
        doubtful += usize::from(lead < 1e-6);
        flips += usize::from(!right);
    }
    ensure!(flips <= doubtful, "{flips} flips, {doubtful} ties");
    Ok(())
}

fn confusion(_: &Trial<'_>) -> Result<(), Failure> {
    let mut matrix = ConfusionMatrix::new(4)?.with_excluded(&[0])?;
    // Class 3 is predicted once and never true; one row of class 1 is withheld.
    matrix.update((&[0, 0, 1, -1, 3, 2, 1], &[0, 0, 1, 1, 2, 2, -1]))?;
    let report = matrix.tester_report();
    let near = |got: Option<f64>, want: f64| got.is_some_and(|got| (got - want).abs() < 1e-9);
    ensure!(near(report.mean_iou, (1.0 + 0.5 + 0.5 + 0.0) / 4.0), "mIoU {:?}", report.mean_iou);
    ensure!(near(report.mean_accuracy, 2.0 / 3.0), "mAcc {:?}", report.mean_accuracy);
    ensure!(near(report.all_accuracy, 4.0 / 6.0), "allAcc {:?}", report.all_accuracy);
    let foreground = report.foreground_mean_iou;
    ensure!(near(foreground, 1.0 / 3.0), "f-mIoU {foreground:?}");
    let training = matrix.evaluator_report();
    // Only classes of the truth, and withholding is free.
    ensure!(near(training.mean_iou, 2.0 / 3.0), "mIoU in training {:?}", training.mean_iou);
    ensure!(near(training.global_accuracy, 0.8), "accuracy {:?}", training.global_accuracy);
    Ok(())
}

//! Whether probabilities mean what they say.

use crate::MetricError;
use crate::error::{check_rows, check_shape};
use crate::zero_shot::check_temperature;
use serde::Serialize;

/// How sure answers were and how often right, by how sure they were: sums over any number of scenes.
#[derive(Debug, Clone, Default)]
pub struct ConfidenceBins {
    /// Of each bin: answers, sum of their confidence, number that are right.
    bins: [(f64, f64, f64); BINS],
}

impl ConfidenceBins {
    /// Adds one answer: its probability, 0..=1, and whether it is right.
    pub fn add(&mut self, confidence: f64, right: bool) {
        let bin = ((confidence * BINS as f64) as usize).min(BINS - 1);
        let (count, sum, rights) = &mut self.bins[bin];
        *count += 1.0;
        *sum += confidence;
        *rights += f64::from(u8::from(right));
    }

    /// Expected calibration error, 0..=1: mean distance of confidence from accuracy over 15 equal bins of confidence,
    /// each as heavy as it is full. `None` without an answer.
    ///
    /// # Source
    /// Guo et al., "On Calibration of Modern Neural Networks", ICML 2017, equation 3.
    pub fn error(&self) -> Option<f64> {
        let total: f64 = self.bins.iter().map(|b| b.0).sum();
        let gap = |(_, sum, rights): &(f64, f64, f64)| (sum - rights).abs();
        (total > 0.0).then(|| self.bins.iter().map(gap).sum::<f64>() / total)
    }
}

/// How well probabilities of classes fit the truth.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct ProbabilityError {
    /// Rows with a truth.
    pub rows: usize,
    /// Mean of −ln of the probability of the true class.
    pub nll: f64,
    /// The expected calibration error of the likeliest classes ([`ConfidenceBins::error`]), 0..=1.
    pub ece: f64,
}

/// Bins of the expected calibration error.
const BINS: usize = 15;

/// Temperatures that are searched.
const RANGE: [f64; 2] = [1e-3, 10.0];

/// How well the softmax of scores over a temperature fits the truth. Rows whose truth is negative, or whose scores are
/// not finite, do not count; without any all is 0.
///
/// # Shapes
/// - `scores`: `[N, C]`, row-major, of any range · `truth`: `[N]`, classes below `C`, or −1
///
/// # Errors
/// If the lengths do not fit, a truth is no class, or the temperature is no finite number above 0.
pub fn probability_error(
    scores: &[f32],
    truth: &[i32],
    num_classes: usize,
    temperature: f32,
) -> Result<ProbabilityError, MetricError> {
    check_temperature(temperature)?;
    check(scores, truth, num_classes)?;
    Ok(measure(scores, truth, num_classes, f64::from(temperature)))
}

/// The temperature at which the truth is likeliest (temperature scaling, Guo et al. 2017), 0.001 to 10, by a golden
/// section in its logarithm; the likelihood has one maximum in 1 / temperature. None without a row that counts.
///
/// # Errors
/// As [`probability_error`].
pub fn fit_temperature(
    scores: &[f32],
    truth: &[i32],
    num_classes: usize,
) -> Result<Option<f32>, MetricError> {
    check(scores, truth, num_classes)?;
    let loss = |ln: f64| measure(scores, truth, num_classes, ln.exp()).nll;
    if measure(scores, truth, num_classes, 1.0).rows == 0 {
        return Ok(None);
    }
    let section = (5.0_f64.sqrt() - 1.0) / 2.0;
    let [mut low, mut high] = RANGE.map(f64::ln);
    let mut inner = [high - section * (high - low), low + section * (high - low)];
    let mut losses = inner.map(loss);
    while high - low > 1e-4 {
        if losses[0] <= losses[1] {
            high = inner[1];
            inner = [high - section * (high - low), inner[0]];
            losses = [loss(inner[0]), losses[0]];
        } else {
            low = inner[0];
            inner = [inner[1], low + section * (high - low)];
            losses = [losses[1], loss(inner[1])];
        }
    }
    Ok(Some((0.5 * (low + high)).exp() as f32))
}

fn check(scores: &[f32], truth: &[i32], num_classes: usize) -> Result<(), MetricError> {
    let rows = check_shape("scores", scores.len(), num_classes)?;
    check_rows("truth", truth.len(), rows)?;
    let wrong = truth.iter().position(|&t| t >= 0 && t as usize >= num_classes);
    let error =
        |row| MetricError::LabelRange { what: "truth", row, value: truth[row], num_classes };
    wrong.map_or(Ok(()), |row| Err(error(row)))
}

fn measure(
    scores: &[f32],
    truth: &[i32],
    num_classes: usize,
    temperature: f64,
) -> ProbabilityError {
    let mut out = ProbabilityError::default();
    let mut bins = ConfidenceBins::default();
    for (row, truth) in scores.chunks_exact(num_classes).zip(truth) {
        let Ok(truth) = usize::try_from(*truth) else { continue };
        if !row.iter().all(|score| score.is_finite()) {
            continue;
        }
        let best = (1..row.len()).fold(0, |best, c| if row[c] > row[best] { c } else { best });
        let over = |c: usize| (f64::from(row[c]) - f64::from(row[best])) / temperature;
        let sum: f64 = (0..row.len()).map(|c| over(c).exp()).sum();
        out.rows += 1;
        out.nll += sum.ln() - over(truth);
        bins.add(1.0 / sum, best == truth);
    }
    out.nll /= out.rows.max(1) as f64;
    out.ece = bins.error().unwrap_or_default();
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::{sample_rng, unit};

    /// Scores of three classes, and truths drawn from their softmax over `temperature`.
    fn drawn(temperature: f64) -> (Vec<f32>, Vec<i32>) {
        let mut rng = sample_rng(3, 0, 0);
        let (mut scores, mut truth) = (Vec::new(), Vec::new());
        for _ in 0..20_000 {
            let row: [f32; 3] = std::array::from_fn(|_| unit(&mut rng) as f32);
            let weights = row.map(|v| (f64::from(v) / temperature).exp());
            let mut left = unit(&mut rng) * weights.iter().sum::<f64>();
            let class = weights.iter().position(|w| {
                left -= w;
                left < 0.0
            });
            scores.extend(row);
            truth.push(class.unwrap_or(2) as i32);
        }
        (scores, truth)
    }

    #[test]
    fn the_temperature_that_truths_were_drawn_by_is_found() {
        for due in [0.07, 0.4] {
            let (scores, truth) = drawn(due);
            let found = fit_temperature(&scores, &truth, 3).unwrap().unwrap();
            assert!((f64::from(found) / due - 1.0).abs() < 0.04, "{found} for {due}");
            let at = |t| probability_error(&scores, &truth, 3, t).unwrap();
            assert!(at(found).ece < 0.01, "{:?}", at(found));
            for other in [0.7 * found, 1.4 * found] {
                assert!(at(other).nll > at(found).nll && at(other).ece > 0.02, "{:?}", at(other));
            }
        }
    }

    #[test]
    fn confidence_is_compared_with_accuracy_bin_by_bin() {
        let mut bins = ConfidenceBins::default();
        assert_eq!(bins.error(), None);
        // Ten with 0.9 confidence of which nine are right: calibrated.
        (0..10).for_each(|i| bins.add(0.9, i > 0));
        assert!(bins.error().unwrap() < 1e-12);
        // Ten more with 0.5 of which none is right: off by a half, half of the weight.
        (0..10).for_each(|_| bins.add(0.5, false));
        assert!((bins.error().unwrap() - 0.25).abs() < 1e-12);
        // Certain is in the last bin, not behind it.
        bins.add(1.0, true);
    }

    #[test]
    fn figures_are_those_of_the_definition() {
        // Probabilities 3/4 and 1/4, twice; right once: |0.75 − 0.5|.
        let scores = [3.0_f32.ln(), 0.0, 3.0_f32.ln(), 0.0, 9.0, 1.0, f32::NAN, 0.0];
        let found = probability_error(&scores, &[0, 1, -1, 0], 2, 1.0).unwrap();
        assert_eq!(found.rows, 2);
        assert!((found.ece - 0.25).abs() < 1e-6, "{found:?}");
        let due = -(0.75_f64.ln() + 0.25_f64.ln()) / 2.0;
        assert!((found.nll - due).abs() < 1e-6, "{found:?} {due}");
    }

    #[test]
    fn hard_input_has_a_stated_result() {
        assert_eq!(probability_error(&[], &[], 2, 1.0).unwrap(), ProbabilityError::default());
        assert_eq!(fit_temperature(&[1.0, f32::INFINITY], &[0], 2).unwrap(), None);
        assert_eq!(fit_temperature(&[1.0, 0.0], &[-1], 2).unwrap(), None);
        // Always right: as cold as it gets; always wrong: as warm.
        let ends = [0, 1].map(|truth| fit_temperature(&[1.0, 0.0], &[truth], 2).unwrap().unwrap());
        assert!(ends[0] < 0.1 && ends[1] > 9.9, "{ends:?}");
        let far = probability_error(&[3e38, -3e38], &[1], 2, 1e-3).unwrap();
        assert!(far.nll.is_finite() && far.nll > 1e38 && (far.ece - 1.0).abs() < 1e-12, "{far:?}");
        for (scores, truth, classes, t) in [
            (&[1.0, 0.0][..], &[0][..], 2, 0.0),
            (&[1.0, 0.0], &[0], 2, f32::NAN),
            (&[1.0, 0.0], &[2], 2, 1.0),
            (&[1.0, 0.0], &[0, 0], 2, 1.0),
            (&[1.0, 0.0, 0.0], &[0], 2, 1.0),
            (&[], &[], 0, 1.0),
        ] {
            assert!(
                probability_error(scores, truth, classes, t).is_err(),
                "{scores:?} {truth:?} {t}"
            );
        }
    }
}

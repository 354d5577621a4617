//! Loss of a rendered depth against a measured one, without reserving memory.
//!
//! The metrics crate has the plain mean, and gsplat's loss against sparse points; what is here adds the
//! outlier rule of the data set's own trainer and keeps its memory.

use crate::error::{OptimiseError, expect};

/// Measured depths up to this are no measurement, meters.
const NOTHING: f32 = 0.01;
/// Errors above this many medians are outliers.
const MEDIANS: f32 = 10.0;
/// Largest error that counts where the median is not above 0, meters.
const LARGEST: f32 = 2.0;

/// Which pixels of a measured depth count, beside those that hold a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthOutliers {
    /// All of them.
    Keep,
    /// `|e| < 10 · median(e)`, `e` = measured − rendered with its sign; `|e| < 2 m` where that median is
    /// not above 0. Of an even number the lower median.
    #[default]
    MedianRule,
}

/// What a depth was compared to.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DepthLoss {
    /// Mean of `|rendered − measured|` over the pixels that count; 0 if there is none.
    pub mean: f64,
    /// Pixels that count.
    pub count: usize,
}

/// Memory of [`depth_loss`].
#[derive(Debug, Default)]
pub struct DepthScratch {
    errors: Vec<f32>,
}

/// Mean absolute difference of depths, and `weight` times its derivative with respect to `pred`.
///
/// A pixel counts if its measurement is finite and above 0.01, its mask is not 0, its rendered depth
/// is finite, and the outlier rule keeps it. Pixels that do not count get 0.
///
/// # Shapes
/// `pred`, `truth`, `gradient`: `[H, W]`, units of the scene · `mask`: `[H, W]`, 0 = does not count
///
/// # Errors
/// If lengths differ.
///
/// # Source
/// `3dgs_optimization/examples/simple_trainer.py` of the data set's authors (f942ea7), where `pred` is the
/// accumulated depth `Σ w z`, not divided by alpha.
pub fn depth_loss(
    pred: &[f32],
    truth: &[f32],
    mask: Option<&[u8]>,
    outliers: DepthOutliers,
    weight: f32,
    scratch: &mut DepthScratch,
    gradient: &mut [f32],
) -> Result<DepthLoss, OptimiseError> {
    expect("measured depth", pred.len(), truth.len())?;
    expect("mask", pred.len(), mask.map_or(pred.len(), <[u8]>::len))?;
    expect("gradient of the depth", pred.len(), gradient.len())?;
    let counts = |i: usize| {
        let (t, p) = (truth[i], pred[i]);
        t > NOTHING && t.is_finite() && p.is_finite() && mask.is_none_or(|m| m[i] != 0)
    };
    let limit = match outliers {
        DepthOutliers::Keep => f32::INFINITY,
        DepthOutliers::MedianRule => {
            let errors = &mut scratch.errors;
            errors.clear();
            errors.extend((0..pred.len()).filter(|&i| counts(i)).map(|i| truth[i] - pred[i]));
            if errors.is_empty() {
                gradient.fill(0.0);
                return Ok(DepthLoss::default());
            }
            let middle = (errors.len() - 1) / 2;
            let (_, median, _) = errors.select_nth_unstable_by(middle, f32::total_cmp);
            if *median > 0.0 { MEDIANS * *median } else { LARGEST }
        }
    };
    let kept = |i: usize| counts(i) && (truth[i] - pred[i]).abs() < limit;
    let (mut sum, mut count) = (0.0f64, 0usize);
    for i in 0..pred.len() {
        let on = kept(i);
        let d = pred[i] - truth[i];
        let sign = f32::from(d > 0.0) - f32::from(d < 0.0);
        gradient[i] = if on { sign } else { 0.0 };
        if on {
            sum += f64::from(d.abs());
            count += 1;
        }
    }
    let step = weight / count.max(1) as f32;
    for g in gradient.iter_mut() {
        *g *= step;
    }
    Ok(DepthLoss { mean: sum / count.max(1) as f64, count })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(pred: &[f32], truth: &[f32], mask: Option<&[u8]>) -> (DepthLoss, Vec<f32>) {
        let mut gradient = vec![7.0; pred.len()];
        let rule = DepthOutliers::MedianRule;
        let scratch = &mut DepthScratch::default();
        let loss = depth_loss(pred, truth, mask, rule, 1.0, scratch, &mut gradient).unwrap();
        (loss, gradient)
    }

    /// Errors 1, 2, 3, 25, and one without a measurement: the median of four is 2, so 25 is out.
    #[test]
    fn outliers_by_hand() {
        let (pred, truth) = ([1.0, 1.0, 1.0, 1.0, 1.0], [2.0, 3.0, 4.0, 26.0, 0.005]);
        let (loss, gradient) = run(&pred, &truth, None);
        assert_eq!(loss, DepthLoss { mean: 2.0, count: 3 });
        assert_eq!(gradient, [-1.0 / 3.0, -1.0 / 3.0, -1.0 / 3.0, 0.0, 0.0]);
        // Without the first pixel the median of 2, 3, 25 is 3, and 25 is below 30.
        let (loss, _) = run(&pred, &truth, Some(&[0, 1, 1, 1, 1]));
        assert_eq!(loss, DepthLoss { mean: 10.0, count: 3 });
    }

    /// Rendered too far: the signed median is −1, so errors below 2 m count.
    #[test]
    fn a_median_that_is_not_positive() {
        let (loss, gradient) = run(&[3.0, 3.0, 5.5], &[2.0, 2.5, 2.0], None);
        assert_eq!(loss, DepthLoss { mean: 0.75, count: 2 });
        assert_eq!(gradient, [0.5, 0.5, 0.0]);
    }

    #[test]
    fn nothing_to_compare() {
        let nan = f32::NAN;
        let (loss, gradient) = run(&[1.0, nan, 1.0, 1.0], &[nan, 1.0, f32::INFINITY, 0.0], None);
        assert_eq!(loss, DepthLoss::default());
        assert_eq!(gradient, [0.0; 4]);
        assert_eq!(run(&[], &[], None).0, DepthLoss::default());
    }

    /// Errors 1, 2, 25: the median of three is 2. What is infinite was not measured, however many there are.
    #[test]
    fn what_is_infinite_has_no_say_in_the_median() {
        let far = f32::INFINITY;
        let (loss, gradient) = run(&[1.0; 6], &[2.0, 3.0, 26.0, far, far, far], None);
        assert_eq!(loss, DepthLoss { mean: 1.5, count: 2 });
        assert_eq!(gradient, [-0.5, -0.5, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn limits_are_not_reached_by_what_counts() {
        // 10 is ten times the median 1.
        let (loss, _) = run(&[1.0, 1.0, 1.0], &[2.0, 2.0, 11.0], None);
        assert_eq!(loss, DepthLoss { mean: 1.0, count: 2 });
        // The median is 0: errors below 2 count. Where both are equal the slope is 0.
        let (loss, gradient) = run(&[1.0, 1.0, 1.0, 4.0, 3.9375], &[1.0, 1.0, 2.0, 2.0, 2.0], None);
        assert_eq!(loss, DepthLoss { mean: 2.9375 / 4.0, count: 4 });
        assert_eq!(gradient, [0.0, 0.0, -0.25, 0.0, 0.25]);
        let (loss, _) = run(&[0.5, 0.5], &[0.01, 0.0101], None);
        assert_eq!(loss.count, 1);
    }

    #[test]
    fn without_the_rule_outliers_count_and_the_weight_is_in_the_slope_alone() {
        let (pred, truth) = ([1.0, 5.0, 1.0, 1.0], [2.0, 1.0, 101.0, 3.0]);
        let (mut gradient, mut scratch) = (vec![7.0; 4], DepthScratch::default());
        let keep = DepthOutliers::Keep;
        let mask: &[u8] = &[1, 1, 3, 0];
        let loss =
            depth_loss(&pred, &truth, Some(mask), keep, 6.0, &mut scratch, &mut gradient).unwrap();
        assert_eq!(loss, DepthLoss { mean: 35.0, count: 3 });
        assert_eq!(gradient, [-2.0, 2.0, -2.0, 0.0]);
        assert_eq!(DepthOutliers::default(), DepthOutliers::MedianRule);
        let failed = |truth: &[f32], mask: &[u8], slope: &mut [f32]| {
            let scratch = &mut DepthScratch::default();
            depth_loss(&pred, truth, Some(mask), keep, 1.0, scratch, slope).unwrap_err().to_string()
        };
        let mut four = [0.0; 4];
        assert_eq!(
            failed(&truth[1..], mask, &mut four),
            "measured depth: expected 4 values, got 3"
        );
        assert_eq!(failed(&truth, &mask[1..], &mut four), "mask: expected 4 values, got 3");
        assert_eq!(
            failed(&truth, mask, &mut four[1..]),
            "gradient of the depth: expected 4 values, got 3"
        );
    }
}

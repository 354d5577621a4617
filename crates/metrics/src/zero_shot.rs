use crate::error::{check_rows, check_setting};
use crate::similarity::{CHUNK_ROWS, Scratch, check_channels, chunk_dots, cosine, rows_by_dots};
use crate::{FeatureRows, IGNORE, MetricError, TextRows};
use rayon::prelude::*;

/// When a row gets no class although one scored best. The default never withholds.
///
/// The original's rule, a threshold of 0.1 on `sigmoid(cosine)`, can never fire: a cosine lies in
/// -1..=1, so its sigmoid lies in 0.27..=0.73. Both rules here work on the cosine itself.
///
/// ```
/// use scenesplat_metrics::{UnknownRule, sigmoid_threshold_to_cosine};
///
/// let rule = UnknownRule { min_cosine: Some(sigmoid_threshold_to_cosine(0.55)), min_margin: None };
/// assert!((rule.min_cosine.unwrap() - 0.2007).abs() < 1e-4);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UnknownRule {
    /// Withhold when the best cosine is below this.
    pub min_cosine: Option<f32>,
    /// Withhold when the best cosine leads the second best candidate by less than this.
    pub min_margin: Option<f32>,
}

impl UnknownRule {
    pub(crate) fn check(&self) -> Result<(), MetricError> {
        for (field, value) in [("min_cosine", self.min_cosine), ("min_margin", self.min_margin)] {
            let value = value.unwrap_or_default();
            check_setting(field, value, "a number", !value.is_nan())?;
        }
        Ok(())
    }

    fn withholds(&self, score: f32, margin: f32) -> bool {
        self.min_cosine.is_some_and(|min| score < min)
            || self.min_margin.is_some_and(|min| margin < min)
    }
}

/// The cosine at which `sigmoid(cosine)` reaches `p`: `ln(p / (1 − p))`.
///
/// Turns a threshold of the original into [`UnknownRule::min_cosine`]. At or below 0 it is −∞
/// (never withhold), at or above 1 it is +∞ (always); NaN gives NaN, which
/// [`classify`] refuses.
pub fn sigmoid_threshold_to_cosine(p: f32) -> f32 {
    let p = f64::from(p);
    // Below 0 and above 1 there is no logarithm; at both ends it is infinite.
    let p = p.clamp(0.0, 1.0);
    (p / (1.0 - p)).ln() as f32
}

/// Settings of [`classify`]. The default lets all classes compete and never withholds.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZeroShotOptions {
    /// When a row gets no class.
    pub unknown: UnknownRule,
    /// `[C]`, which classes may be predicted; all if `None`. To let a class compete but leave it
    /// out of averages, see [`ConfusionMatrix::with_excluded`](crate::ConfusionMatrix::with_excluded).
    pub candidates: Option<Vec<bool>>,
}

impl ZeroShotOptions {
    /// The classes that compete, rising.
    pub(crate) fn candidate_classes(&self, num_classes: usize) -> Result<Vec<usize>, MetricError> {
        self.unknown.check()?;
        let Some(mask) = &self.candidates else { return Ok((0..num_classes).collect()) };
        check_rows("candidates", mask.len(), num_classes)?;
        let classes: Vec<usize> = (0..num_classes).filter(|&c| mask[c]).collect();
        check_setting("number of candidates", 0, "at least 1", !classes.is_empty())?;
        Ok(classes)
    }
}

/// What [`classify`] found, one entry per row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ZeroShotLabels {
    /// `[N]`, the class with the highest cosine, or -1.
    pub labels: Vec<i32>,
    /// `[N]`, that cosine, in -1..=1; kept where the label was withheld, 0 for unusable rows.
    pub scores: Vec<f32>,
    /// `[N]`, lead over the second best candidate, at least 0; +∞ if there is only one candidate,
    /// 0 for unusable rows.
    pub margins: Vec<f32>,
    /// Rows without a direction: a NaN, an infinity, or only zeros. Their label is -1.
    pub num_unusable: usize,
    /// Rows whose label was withheld by the [`UnknownRule`].
    pub num_withheld: usize,
}

/// The best matching class of each feature row, by cosine with the class texts.
///
/// `argmax_c F_i · T_c / (‖F_i‖ ‖T_c‖)`, ties to the smallest class id.
///
/// # Shapes
/// - `features`: `[N, D]`, any norm from 1e-45 to 1e38 · `text`: `[C, D]`
///
/// # Errors
/// If the channel counts differ, a setting is NaN, the candidate mask has the wrong length or
/// allows nothing, or rows cannot be read (the first failing piece is named).
///
/// # Source
/// `LangPretrainZeroShotSemSegEval` and `ZeroShotSemSegTester`, SceneSplat be9d5e1. Differs: the
/// score is the cosine, not its sigmoid (same order); the threshold is one that can fire; a row
/// without a direction is -1, where the original picks class 0 or, for NaN, any.
pub fn classify(
    features: &dyn FeatureRows,
    text: TextRows<'_>,
    options: &ZeroShotOptions,
) -> Result<ZeroShotLabels, MetricError> {
    check_channels(features, text)?;
    let candidates = options.candidate_classes(text.num_classes())?;
    let n = features.num_rows();
    let mut found = ZeroShotLabels {
        labels: vec![IGNORE; n],
        scores: vec![0.0; n],
        margins: vec![0.0; n],
        ..ZeroShotLabels::default()
    };
    let chunks = found
        .labels
        .par_chunks_mut(CHUNK_ROWS)
        .zip(found.scores.par_chunks_mut(CHUNK_ROWS))
        .zip(found.margins.par_chunks_mut(CHUNK_ROWS));
    let counts: Vec<Result<(usize, usize), MetricError>> = chunks
        .enumerate()
        .map_init(Scratch::default, |scratch, (chunk, ((labels, scores), margins))| {
            let start = chunk * CHUNK_ROWS;
            let found = chunk_dots(features, text, start..start + labels.len(), scratch)?;
            let (mut unusable, mut withheld) = (0, 0);
            for (i, dots) in found.dots.chunks_exact(text.num_classes()).enumerate() {
                let Some(norm) = found.norms[i] else {
                    unusable += 1;
                    continue;
                };
                let best = best_two(dots, &candidates);
                scores[i] = cosine(best.first, norm);
                margins[i] = match candidates.len() {
                    1 => f32::INFINITY,
                    _ => (f64::from(best.first - best.second) / norm) as f32,
                };
                if options.unknown.withholds(scores[i], margins[i]) {
                    withheld += 1;
                } else {
                    // At most 4096 classes.
                    labels[i] = best.class as i32;
                }
            }
            Ok((unusable, withheld))
        })
        .collect();
    for count in counts {
        let (unusable, withheld) = count?;
        found.num_unusable += unusable;
        found.num_withheld += withheld;
    }
    Ok(found)
}

pub(crate) fn check_temperature(temperature: f32) -> Result<(), MetricError> {
    let fits = temperature > 0.0 && temperature.is_finite();
    check_setting("temperature", temperature, "a finite number above 0", fits)
}

/// How probable each class is to each feature row: the softmax of the cosines with the class texts, divided by
/// `temperature`, over the candidates of `options`; 0 for the others, and in all of an unusable row. The rule
/// that withholds labels is not applied. `[N, C]`, row-major
///
/// # Shapes
/// - `features`: `[N, D]`, any norm from 1e-45 to 1e38 · `text`: `[C, D]`
///
/// # Errors
/// As [`classify`]; also if the temperature is no finite number above 0.
pub fn class_probabilities(
    features: &dyn FeatureRows,
    text: TextRows<'_>,
    options: &ZeroShotOptions,
    temperature: f32,
) -> Result<Vec<f32>, MetricError> {
    check_temperature(temperature)?;
    let candidates = options.candidate_classes(text.num_classes())?;
    rows_by_dots(features, text, |out, dots, norm| {
        let largest = best_two(dots, &candidates).first;
        let rate = 1.0 / (norm * f64::from(temperature));
        let mut sum = 0.0;
        for &class in &candidates {
            out[class] = (f64::from(dots[class] - largest) * rate).exp() as f32;
            sum += out[class];
        }
        candidates.iter().for_each(|&class| out[class] /= sum);
    })
}

struct BestTwo {
    class: usize,
    first: f32,
    second: f32,
}

fn best_two(dots: &[f32], candidates: &[usize]) -> BestTwo {
    let mut best = BestTwo { class: 0, first: f32::NEG_INFINITY, second: f32::NEG_INFINITY };
    for &class in candidates {
        let dot = dots[class];
        if dot > best.first {
            best = BestTwo { class, first: dot, second: best.first };
        } else if dot > best.second {
            best.second = dot;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_go_to_the_smallest_candidate() {
        let best = best_two(&[0.5, 0.7, 0.7, 0.1], &[0, 1, 2, 3]);
        assert_eq!((best.class, best.first, best.second), (1, 0.7, 0.7));
        assert_eq!(best_two(&[0.5, 0.7, 0.7, 0.1], &[0, 2, 3]).class, 2);
    }

    #[test]
    fn sigmoid_thresholds_at_their_ends() {
        assert_eq!(sigmoid_threshold_to_cosine(0.5), 0.0);
        assert_eq!(sigmoid_threshold_to_cosine(0.0), f32::NEG_INFINITY);
        assert_eq!(sigmoid_threshold_to_cosine(1.0), f32::INFINITY);
        assert!(sigmoid_threshold_to_cosine(f32::NAN).is_nan());
        // The original's 0.1 lies far below any cosine.
        assert!(sigmoid_threshold_to_cosine(0.1) < -2.0);
    }
}

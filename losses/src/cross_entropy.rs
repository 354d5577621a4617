//! Cross-entropy of logits.

use crate::IGNORE;
use crate::error::{LossError, check_len, check_smoothing};
use crate::loss::{Loss, LossInput};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::{Matrix, Real, make_rows, read_matrix, rows_per_task};
use crate::vector::{exp_shifted, sum};
use candle_core::{DType, Result, Tensor};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;

const NAME: &str = "cross_entropy";

/// Mean cross-entropy over the labeled rows.
///
/// `Σᵢ lᵢ / Σᵢ w[yᵢ]` over rows whose label `yᵢ` is not [`IGNORE`], where with smoothing s
/// `lᵢ = (1 − s) w[yᵢ] (−log p[yᵢ]) + s/C Σ_c w[c] (−log p[c])`; `None` when no row is labeled, or
/// the labels present have no weight. [`LossInput::valid`] is not read: it is about target features.
///
/// # Source
/// `CrossEntropyLoss` in `pointcept/models/losses/misc.py`, SceneSplat be9d5e1, which is PyTorch's.
/// Differs: NaN for a batch without labels is `None`; a logit that is not finite is an error that
/// names it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CrossEntropy {
    /// Share of the target that is spread over all classes, in `0..1`.
    pub label_smoothing: f64,
    /// Weight of each class, finite, ≥ 0; all 1 if `None`. `[C]`
    pub class_weights: Option<Vec<f64>>,
}

impl Loss for CrossEntropy {
    fn name(&self) -> &str {
        NAME
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let label = input.needs_label(NAME)?;
        cross_entropy(input.pred, label, self.label_smoothing, self.class_weights.as_deref())
    }
    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a label with a weight".to_owned()
    }
    fn settings(&self) -> String {
        let weights = if self.class_weights.is_some() { ", weighted classes" } else { "" };
        format!("label smoothing {}{weights}", self.label_smoothing)
    }
}

/// [`CrossEntropy`] as a function.
///
/// # Shapes
/// `logits`: `[N, C]` · `label`: `[N]`, -1 or 0..C · `class_weights`: `[C]` · returns a scalar ≥ 0,
/// f32, or f64 if the logits are
///
/// # Errors
/// If shapes do not fit, a label is out of range, a setting is, or a logit of a labeled row is not
/// finite.
pub fn cross_entropy(
    logits: &Tensor,
    label: &[i32],
    label_smoothing: f64,
    class_weights: Option<&[f64]>,
) -> Result<Option<Tensor>> {
    let (rows, classes) = logits.dims2()?;
    check_labels(NAME, rows, classes, label)?;
    let target = Target::new(classes, label_smoothing, class_weights)?;
    let counted = label.iter().filter(|l| **l != IGNORE);
    let weight: f64 = counted.map(|l| target.weight(*l as usize)).sum();
    if weight == 0.0 {
        return Ok(None);
    }
    let (total, log_sums) = match logits.dtype() {
        DType::F64 => sum_rows::<f64>(logits, label, &target),
        _ => sum_rows::<f32>(logits, label, &target),
    }?;
    let factor = 1.0 / weight;
    let backward = CrossEntropyBackward { label: label.to_vec(), log_sums, target, factor };
    scalar_loss(logits, total * factor, backward).map(Some)
}

/// Checks that there is a label for each row, and that it is -1 or a class.
pub(crate) fn check_labels(
    loss: &'static str,
    rows: usize,
    classes: usize,
    label: &[i32],
) -> std::result::Result<(), LossError> {
    check_len(loss, "label", rows, label.len())?;
    let bad = |l: &i32| *l < IGNORE || (*l >= 0 && *l as usize >= classes);
    match label.iter().position(bad) {
        Some(row) => Err(LossError::Label { loss, row, value: label[row], classes }),
        None => Ok(()),
    }
}

/// What the probabilities should be.
struct Target {
    classes: usize,
    smoothing: f64,
    weights: Option<Vec<f64>>,
    /// Sum of the weights.
    total: f64,
}

impl Target {
    fn new(
        classes: usize,
        smoothing: f64,
        weights: Option<&[f64]>,
    ) -> std::result::Result<Self, LossError> {
        check_smoothing(NAME, smoothing, weights)?;
        if let Some(given) = weights.map(<[f64]>::len).filter(|given| *given != classes) {
            let value = format!("{given} weights for {classes} classes");
            let (setting, expected) = ("class_weights", "one for each class");
            return Err(LossError::Setting { loss: NAME, setting, value, expected });
        }
        let total = weights.map_or(classes as f64, |w| w.iter().sum());
        Ok(Self { classes, smoothing, weights: weights.map(<[f64]>::to_vec), total })
    }

    fn weight(&self, class: usize) -> f64 {
        self.weights.as_ref().map_or(1.0, |w| w[class])
    }

    /// `s/C`
    fn spread(&self) -> f64 {
        self.smoothing / self.classes as f64
    }

    /// The loss of a row, from its logits and the logarithm of their exponentials' sum.
    fn loss<T: Real>(&self, logits: &[T], log_sum: f64, label: usize) -> f64 {
        let hit = self.weight(label) * (log_sum - logits[label].wide());
        if self.smoothing == 0.0 {
            return hit;
        }
        let costs = logits.iter().enumerate();
        let all: f64 = costs.map(|(c, z)| self.weight(c) * (log_sum - z.wide())).sum();
        (1.0 - self.smoothing) * hit + self.spread() * all
    }
}

fn sum_rows<T: Real>(logits: &Tensor, label: &[i32], target: &Target) -> Result<(f64, Vec<f64>)> {
    read_matrix(NAME, "pred", logits, |logits| {
        let task = rows_per_task(logits.columns);
        let mut log_sums = vec![0.0; logits.rows];
        let parts: Vec<_> = log_sums
            .par_chunks_mut(task)
            .enumerate()
            .map_init(Scratch::<T>::default, |scratch, (i, log_sums)| {
                let mut total = 0.0;
                for (row, log_sum) in (i * task..).zip(log_sums) {
                    if label[row] != IGNORE {
                        let logits = log_sum_exp(NAME, logits, row, scratch, log_sum)?;
                        total += target.loss(logits, *log_sum, label[row] as usize);
                    }
                }
                Ok::<f64, LossError>(total)
            })
            .collect();
        let mut total = 0.0;
        for part in parts {
            total += part?;
        }
        Ok((total, log_sums))
    })
}

/// A row's values and exponentials, used again for each row.
#[derive(Default)]
pub(crate) struct Scratch<T> {
    values: Vec<T>,
    /// `exp(logit − largest)`
    pub exponentials: Vec<f64>,
}

/// The logarithm of the sum of the exponentials of a row's logits; gives back the row.
pub(crate) fn log_sum_exp<'s, T: Real>(
    loss: &'static str,
    logits: &'s Matrix<'_>,
    row: usize,
    scratch: &'s mut Scratch<T>,
    log_sum: &mut f64,
) -> std::result::Result<&'s [T], LossError> {
    let values = logits.read(row..row + 1, &mut scratch.values);
    scratch.exponentials.resize(values.len(), 0.0);
    let exponentials = &mut scratch.exponentials;
    let (sum, least, largest) = compiled(|| {
        let (mut least, mut largest) = (values[0], values[0]);
        for v in values {
            least = if *v < least { *v } else { least };
            largest = if *v > largest { *v } else { largest };
        }
        exp_shifted(values, largest.wide(), exponentials);
        (sum(exponentials), least.wide(), largest.wide())
    });
    *log_sum = largest + sum.ln();
    // A NaN makes the sum NaN, +∞ too; −∞ would only be seen in the least.
    if (!log_sum.is_finite() || !least.is_finite())
        && let Some(error) = logits.not_finite(loss, "pred", row)
    {
        return Err(error);
    }
    Ok(values)
}

struct CrossEntropyBackward {
    label: Vec<i32>,
    log_sums: Vec<f64>,
    target: Target,
    factor: f64,
}

impl Backward for CrossEntropyBackward {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient<T: Real>(&self, logits: &Tensor, factor: f64) -> Result<Tensor> {
        let factor = factor * self.factor;
        read_matrix(NAME, "pred", logits, |logits_matrix| {
            make_rows::<T>(logits, |first, out| {
                let classes = logits_matrix.columns;
                let mut scratch = Vec::new();
                let mut p = vec![0.0; classes];
                for (row, out) in (first..).zip(out.chunks_exact_mut(classes)) {
                    if self.label[row] != IGNORE {
                        let z = logits_matrix.read::<T>(row..row + 1, &mut scratch);
                        compiled(|| exp_shifted(z, self.log_sums[row], &mut p));
                        self.row(&p, self.label[row] as usize, factor, out);
                    }
                }
            })
        })
    }
}

impl CrossEntropyBackward {
    /// The gradient of a row from its probabilities.
    fn row<T: Real>(&self, p: &[f64], label: usize, factor: f64, out: &mut [T]) {
        let target = &self.target;
        let hit = (1.0 - target.smoothing) * target.weight(label);
        let spread = target.spread();
        let scale = hit + spread * target.total;
        if target.smoothing == 0.0 {
            compiled(|| {
                for (out, p) in out.iter_mut().zip(p) {
                    *out = T::narrow(factor * scale * p);
                }
            });
        } else {
            for (c, (out, p)) in out.iter_mut().zip(p).enumerate() {
                *out = T::narrow(factor * (scale * p - spread * target.weight(c)));
            }
        }
        // p − 1 before rounding: what is left of a sure row.
        let smooth = spread * target.weight(label);
        out[label] = T::narrow(factor * (scale * p[label] - hit - smooth));
    }
}

//! The Lovász extension of the Jaccard loss.

use crate::IGNORE;
use crate::cross_entropy::{Scratch, check_labels, log_sum_exp};
use crate::error::LossError;
use crate::loss::{Loss, LossInput};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::{Real, make_rows, read_matrix};
use crate::vector::{dot, exp_shifted};
use candle_core::{DType, Result, Tensor};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;

const NAME: &str = "lovasz_softmax";

/// Rows whose errors lie together: a class's errors of these rows are neighbors in memory.
const BLOCK: usize = 64;

/// Mean over the classes present of the Lovász extension of `1 − IoU`, on softmax probabilities.
///
/// For each class c among the labels: the errors `e = |1[y = c] − p_c|` of all labeled rows are
/// sorted descending, and weighted by what each adds to the Jaccard loss; `None` when no row is
/// labeled. The gradient is exact; where errors are equal it is that of the order of their rows.
/// [`LossInput::valid`] is not read: it is about target features.
///
/// Takes `N·C` numbers of memory between forward and backward pass, C counting classes present.
///
/// # Source
/// `LovaszLoss` in `pointcept/models/losses/lovasz.py`, SceneSplat be9d5e1, mode multiclass, after
/// Berman, Rannen Triki and Blaschko (CVPR 2018). Differs: a batch without labels gives `None` where
/// the original gives an empty tensor; the weights come from the counts, not from differences of a
/// running quotient; a logit that is not finite is an error that names it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LovaszSoftmax;

impl Loss for LovaszSoftmax {
    fn name(&self) -> &str {
        NAME
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        lovasz_softmax(input.pred, input.needs_label(NAME)?)
    }
    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a label".to_owned()
    }
}

/// [`LovaszSoftmax`] as a function.
///
/// # Shapes
/// `logits`: `[N, C]` · `label`: `[N]`, -1 or 0..C · returns a scalar in `0..=1`, f32, or f64 if the
/// logits are
///
/// # Errors
/// If shapes do not fit, a label is out of range, or a logit of a labeled row is not finite.
pub fn lovasz_softmax(logits: &Tensor, label: &[i32]) -> Result<Option<Tensor>> {
    match logits.dtype() {
        DType::F64 => typed::<f64>(logits, label),
        _ => typed::<f32>(logits, label),
    }
}

fn typed<T: Real>(logits: &Tensor, label: &[i32]) -> Result<Option<Tensor>> {
    let (rows, classes) = logits.dims2()?;
    check_labels(NAME, rows, classes, label)?;
    let labelled: Vec<u32> = (0..rows).filter(|&r| label[r] != IGNORE).map(|r| r as u32).collect();
    if labelled.is_empty() {
        return Ok(None);
    }
    let label: Vec<u32> = labelled.iter().map(|&r| label[r as usize] as u32).collect();
    let mut count = vec![0; classes];
    label.iter().for_each(|l| count[*l as usize] += 1);
    let present: Vec<u32> = (0..classes as u32).filter(|&c| count[c as usize] > 0).collect();

    let (errors, log_sums) = errors::<T>(logits, &labelled, &label, &present)?;
    let want_gradient = logits.track_op();
    let per_class: Vec<(f64, Vec<T>)> = (0..present.len())
        .into_par_iter()
        .map_init(Vec::new, |keys, i| {
            let class = present[i];
            let gather = |at: usize| errors[(at / BLOCK * present.len() + i) * BLOCK + at % BLOCK];
            let members = count[class as usize];
            one_class(&label, class, members, gather, want_gradient, keys)
        })
        .collect();
    drop(errors);
    let factor = 1.0 / present.len() as f64;
    let value = factor * per_class.iter().map(|(loss, _)| loss).sum::<f64>();
    let weights = per_class.into_iter().map(|(_, weights)| weights).collect();
    let backward = LovaszBackward { labelled, present, log_sums, weights, factor };
    scalar_loss(logits, value, backward).map(Some)
}

/// `|1[y = c] − p_c|` of labeled rows and classes present, `[blocks of rows][class][row of the
/// block]`, and the logarithm of each row's sum of exponentials.
fn errors<T: Real>(
    logits: &Tensor,
    labelled: &[u32],
    label: &[u32],
    present: &[u32],
) -> Result<(Vec<T>, Vec<f64>)> {
    let blocks = labelled.len().div_ceil(BLOCK);
    let stride = BLOCK * present.len();
    let mut errors = vec![T::default(); blocks * stride];
    let mut log_sums = vec![0.0; labelled.len()];
    read_matrix(NAME, "pred", logits, |logits| {
        let tasks = errors.par_chunks_mut(stride).zip(log_sums.par_chunks_mut(BLOCK));
        let failed: Vec<Option<LossError>> = tasks
            .enumerate()
            .map_init(Scratch::<T>::default, |scratch, (block, (errors, log_sums))| {
                for (i, log_sum) in log_sums.iter_mut().enumerate() {
                    let at = block * BLOCK + i;
                    let row = labelled[at] as usize;
                    if let Err(error) = log_sum_exp(NAME, logits, row, scratch, log_sum) {
                        return Some(error);
                    }
                    let p = &scratch.exponentials;
                    let total = compiled(|| crate::vector::sum(p));
                    let own = label[at] as usize;
                    for (&class, error) in present.iter().zip(errors[i..].iter_mut().step_by(BLOCK))
                    {
                        let class = class as usize;
                        let p = p[class] / total;
                        *error = T::narrow(if class == own { (1.0 - p).max(0.0) } else { p });
                    }
                }
                None
            })
            .collect();
        failed.into_iter().flatten().next().map_or(Ok(()), |error| Err(error.into()))
    })?;
    Ok((errors, log_sums))
}

/// The loss of a class, and the weight of each row's error in it, negative in rows of the class,
/// where the error falls as the probability rises.
fn one_class<T: Real>(
    label: &[u32],
    class: u32,
    members: usize,
    error: impl Fn(usize) -> T,
    want_weights: bool,
    keys: &mut Vec<T::Key>,
) -> (f64, Vec<T>) {
    // Once all rows of the class are passed, the rest adds nothing: the loss is 1 already. So other
    // rows with smaller errors than any of the class need no sorting.
    let own = (0..label.len()).filter(|&at| label[at] == class).map(&error);
    let least = own.fold(T::narrow(f64::INFINITY), |a, b| if b < a { b } else { a });
    keys.clear();
    keys.extend((0..label.len()).filter_map(|at| {
        let e = error(at);
        (label[at] == class || e >= least).then(|| e.key(at as u32))
    }));
    keys.sort_unstable();
    let mut weights = if want_weights { vec![T::default(); label.len()] } else { Vec::new() };
    // Rows of the class still to come, and the union so far.
    let (mut to_come, mut union) = (members as f64, members as f64);
    let mut loss = 0.0;
    for &key in keys.iter() {
        let (error, at) = T::of_key(key);
        let own = label[at as usize] == class;
        let weight = if own {
            to_come -= 1.0;
            1.0 / union
        } else {
            union += 1.0;
            to_come / ((union - 1.0) * union)
        };
        loss += error.wide() * weight;
        if want_weights {
            weights[at as usize] = T::narrow(if own { -weight } else { weight });
        }
    }
    (loss, weights)
}

struct LovaszBackward<T> {
    labelled: Vec<u32>,
    present: Vec<u32>,
    log_sums: Vec<f64>,
    /// Of each class present: of the probability of each labeled row.
    weights: Vec<Vec<T>>,
    factor: f64,
}

impl<W: Real> Backward for LovaszBackward<W> {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient<T: Real>(&self, logits: &Tensor, factor: f64) -> Result<Tensor> {
        let factor = factor * self.factor;
        read_matrix(NAME, "pred", logits, |logits_matrix| {
            make_rows::<T>(logits, |first, out| {
                let classes = logits_matrix.columns;
                let mut scratch = Vec::new();
                let (mut p, mut q) = (vec![0.0; classes], vec![0.0; classes]);
                let end = first + out.len() / classes;
                let start = self.labelled.partition_point(|r| (*r as usize) < first);
                for at in start..self.labelled.len() {
                    let row = self.labelled[at] as usize;
                    if row >= end {
                        break;
                    }
                    for (weights, class) in self.weights.iter().zip(&self.present) {
                        q[*class as usize] = weights[at].wide();
                    }
                    let z = logits_matrix.read::<T>(row..row + 1, &mut scratch);
                    let out = &mut out[(row - first) * classes..][..classes];
                    compiled(|| {
                        exp_shifted(z, self.log_sums[at], &mut p);
                        let mean = dot(&p, &q);
                        for ((out, p), q) in out.iter_mut().zip(&p).zip(&q) {
                            *out = T::narrow(factor * p * (q - mean));
                        }
                    });
                }
            })
        })
    }
}

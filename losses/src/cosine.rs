//! Cosine distance to target features.

use crate::error::LossError;
use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, sum_rows};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::{Real, make_rows, read_matrix};
use crate::vector::{dots, norm};
use candle_core::{DType, Result, Tensor};
use scenesplat_kernels::simd::compiled;

const NAME: &str = "cosine";

/// Norms below this count as this, as in PyTorch.
const EPS: f64 = 1e-8;

/// Mean cosine distance between predicted and target features, over the valid rows.
///
/// `1/|V| · Σ_{i∈V} (1 − pᵢ·tᵢ / (max(‖pᵢ‖, ε) max(‖tᵢ‖, ε)))` with ε = 1e-8; `None` when `V` is
/// empty. A zero row, predicted or target, costs 1.
///
/// # Source
/// `CosineSimilarity` in `pointcept/models/losses/misc.py`, SceneSplat be9d5e1. Differs: an empty
/// `V` is `None`, not 0; sums are f64, so no norm over- or underflows; a value that is not finite is
/// an error that names it. The same: at a zero predicted row the gradient is the one that the ε
/// gives, `−t / (ε ‖t‖ |V|)`, which is large.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CosineLoss {
    /// Mean over the valid rows, or sum.
    pub reduction: Reduction,
}

impl Loss for CosineLoss {
    fn name(&self) -> &str {
        NAME
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let target = input.target.ok_or(LossError::Missing { loss: NAME, field: "target" })?;
        cosine(input.pred, target, input.valid, self.reduction)
    }
    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a target".to_owned()
    }
}

/// [`CosineLoss`] as a function.
///
/// # Shapes
/// `pred`, `target`: `[N, D]`, any norm; the target gets no gradient · `valid`: `[N]` · returns a
/// scalar in `0..=2` (times the number of valid rows for a sum), f32, or f64 if `pred` is
///
/// # Errors
/// If shapes differ, or a value of a valid row is not finite.
pub fn cosine(
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    match pred.dtype() {
        DType::F64 => typed::<f64>(pred, target, valid, reduction),
        _ => typed::<f32>(pred, target, valid, reduction),
    }
}

/// What the gradient of a row needs: `(t/‖t‖ − along · p/‖p‖) / ‖p‖`.
#[derive(Clone, Copy, Default)]
struct Kept {
    /// `1/‖p‖`; 0 if the row does not count.
    inverse: f64,
    /// `1/‖t‖`
    target_inverse: f64,
    /// Their cosine; 0 where the norm of `p` counts as ε, a constant.
    along: f64,
    /// What the row counts.
    weight: f64,
}

fn typed<T: Real>(
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    let (total, kept, count) = sum_rows(NAME, pred, target, valid, |_, p, t| row::<T>(p, t))?;
    if count == 0 {
        return Ok(None);
    }
    let factor = reduction.factor(count);
    let backward = CosineBackward { target: target.detach(), kept, factor };
    scalar_loss(pred, total * factor, backward).map(Some)
}

/// `−Σ wᵢ cos(pᵢ, tᵢ)`; rows of weight 0 are not read.
///
/// # Shapes
/// `pred`, `target`: `[N, D]` · `weights`: `[N]`, finite
pub(crate) fn weighted_cosines(
    pred: &Tensor,
    target: &Tensor,
    weights: &[f64],
) -> Result<Option<Tensor>> {
    match pred.dtype() {
        DType::F64 => weighted::<f64>(pred, target, weights),
        _ => weighted::<f32>(pred, target, weights),
    }
}

fn weighted<T: Real>(pred: &Tensor, target: &Tensor, weights: &[f64]) -> Result<Option<Tensor>> {
    let counts: Vec<bool> = weights.iter().map(|w| *w != 0.0).collect();
    let (total, kept, count) = sum_rows(NAME, pred, target, Some(&counts), |i, p, t| {
        let (distance, kept) = row::<T>(p, t);
        (weights[i] * (distance - 1.0), Kept { weight: weights[i], ..kept })
    })?;
    if count == 0 {
        return Ok(None);
    }
    let backward = CosineBackward { target: target.detach(), kept, factor: 1.0 };
    scalar_loss(pred, total, backward).map(Some)
}

fn row<T: Real>(p: &[T], t: &[T]) -> (f64, Kept) {
    let [pp, tt, pt] = compiled(|| dots(p, t));
    let (p_norm, t_norm) = (pp.sqrt(), tt.sqrt());
    let (p_norm, t_norm, cosine) = if pp.is_finite() && tt.is_finite() {
        (p_norm.max(EPS), t_norm.max(EPS), pt / p_norm.max(EPS) / t_norm.max(EPS))
    } else {
        // Only f64 gets here with finite values: squares beyond 10³⁰⁸.
        let (p_norm, t_norm) = (norm(p).max(EPS), norm(t).max(EPS));
        let products = p.iter().zip(t).map(|(p, t)| (p.wide() / p_norm) * (t.wide() / t_norm));
        (p_norm, t_norm, products.sum())
    };
    let along = if p_norm > EPS { cosine } else { 0.0 };
    let (inverse, target_inverse) = (1.0 / p_norm, 1.0 / t_norm);
    (1.0 - cosine, Kept { inverse, target_inverse, along, weight: 1.0 })
}

struct CosineBackward {
    target: Tensor,
    kept: Vec<Kept>,
    factor: f64,
}

impl Backward for CosineBackward {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        match pred.dtype() {
            DType::F64 => self.typed::<f64>(pred, factor),
            _ => self.typed::<f32>(pred, factor),
        }
    }
}

impl CosineBackward {
    fn typed<T: Real>(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        let factor = factor * self.factor;
        read_matrix(NAME, "pred", pred, |p| {
            read_matrix(NAME, "target", &self.target, |t| {
                make_rows::<T>(pred, |first, out| {
                    let (mut p_scratch, mut t_scratch) = (Vec::new(), Vec::new());
                    for (row, out) in (first..).zip(out.chunks_exact_mut(p.columns)) {
                        let kept = self.kept[row];
                        if kept.inverse == 0.0 {
                            continue;
                        }
                        let p = p.read::<T>(row..row + 1, &mut p_scratch);
                        let t = t.read::<T>(row..row + 1, &mut t_scratch);
                        let outer = -factor * kept.weight * kept.inverse;
                        let along = kept.along * kept.inverse;
                        compiled(|| {
                            for ((out, p), t) in out.iter_mut().zip(p).zip(t) {
                                let inner = t.wide() * kept.target_inverse - p.wide() * along;
                                *out = T::narrow(outer * inner);
                            }
                        });
                    }
                })
            })
        })
    }
}

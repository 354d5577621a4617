//! Cosine distance to target features.

use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, RowLoss, valid_rows, weighted_rows};
use crate::values::Real;
use crate::vector::{dots, norm};
use candle_core::{Result, Tensor};

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
        cosine(input.pred, input.needs_target(NAME)?, input.valid, self.reduction)
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
    valid_rows(CosineDistance { offset: 0.0 }, pred, target, valid, reduction)
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
    let weights = weights.to_vec();
    weighted_rows(CosineDistance { offset: 1.0 }, pred, target, weights, Reduction::Sum)
}

/// `1 − cos(p, t) − offset`
struct CosineDistance {
    offset: f64,
}

/// What the gradient of a row needs: `(t/‖t‖ − along · p/‖p‖) / ‖p‖`.
#[derive(Clone, Copy, Default)]
struct Kept {
    /// `1/‖p‖`
    inverse: f64,
    /// `1/‖t‖`
    target_inverse: f64,
    /// Their cosine; 0 where the norm of `p` counts as ε, a constant.
    along: f64,
}

impl RowLoss for CosineDistance {
    const NAME: &'static str = NAME;
    type Kept = Kept;

    #[inline(always)]
    fn value<T: Real>(&self, p: &[T], t: &[T]) -> (f64, Kept) {
        let [pp, tt, pt] = dots(p, t);
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
        let kept = Kept { inverse: 1.0 / p_norm, target_inverse: 1.0 / t_norm, along };
        (1.0 - cosine - self.offset, kept)
    }

    #[inline(always)]
    fn gradient<T: Real>(&self, (p, t): (&[T], &[T]), kept: Kept, factor: f64, out: &mut [T]) {
        let outer = -factor * kept.inverse;
        let along = kept.along * kept.inverse;
        for ((out, p), t) in out.iter_mut().zip(p).zip(t) {
            *out = T::narrow(outer * (t.wide() * kept.target_inverse - p.wide() * along));
        }
    }
}

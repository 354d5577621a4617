//! Squared distance to target features.

use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, RowLoss, valid_rows};
use crate::values::Real;
use crate::vector::sum_of_differences;
use candle_core::{Result, Tensor};

const NAME: &str = "l2";

/// Mean squared Euclidean distance between predicted and target features, over the valid rows.
///
/// `1/|V| · Σ_{i∈V} Σ_d (pᵢ_d − tᵢ_d)²`: summed over channels, so it does not shrink with the width;
/// `None` when `V` is empty. Between unit rows it is twice the cosine distance.
///
/// # Source
/// `L2Loss` in `pointcept/models/losses/misc.py`, SceneSplat be9d5e1. Differs: an empty `V` is
/// `None`, not 0; sums are f64; a value that is not finite is an error that names it. A loss beyond
/// f32 (distances above 10¹⁹) is infinite, with the right gradient.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct L2Loss {
    /// Mean over the valid rows, or sum.
    pub reduction: Reduction,
}

impl Loss for L2Loss {
    fn name(&self) -> &str {
        NAME
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        l2(input.pred, input.needs_target(NAME)?, input.valid, self.reduction)
    }
    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a target".to_owned()
    }
}

/// [`L2Loss`] as a function.
///
/// # Shapes
/// `pred`, `target`: `[N, D]`; the target gets no gradient · `valid`: `[N]` · returns a scalar ≥ 0,
/// f32, or f64 if `pred` is
///
/// # Errors
/// If shapes differ, or a value of a valid row is not finite.
pub fn l2(
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    valid_rows(SquaredDistance, pred, target, valid, reduction)
}

struct SquaredDistance;

impl RowLoss for SquaredDistance {
    const NAME: &'static str = NAME;
    type Kept = ();

    #[inline(always)]
    fn value<T: Real>(&self, p: &[T], t: &[T]) -> (f64, ()) {
        (sum_of_differences(p, t, |d| d * d), ())
    }

    #[inline(always)]
    fn gradient<T: Real>(&self, (p, t): (&[T], &[T]), (): (), factor: f64, out: &mut [T]) {
        let factor = 2.0 * factor;
        for ((out, p), t) in out.iter_mut().zip(p).zip(t) {
            *out = T::narrow(factor * (p.wide() - t.wide()));
        }
    }
}

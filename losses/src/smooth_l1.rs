//! Distance to target features that is squared near the target and straight far from it.

use crate::error::check_positive;
use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, RowLoss, valid_rows};
use crate::values::Real;
use crate::vector::sum_of_differences;
use candle_core::{Result, Tensor};

const NAME: &str = "smooth_l1";

/// Mean smooth L1 distance between predicted and target features, over the valid rows.
///
/// `1/|V| · Σ_{i∈V} Σ_d h(pᵢ_d − tᵢ_d)` with `h(x) = x² / 2β` where `|x| < β`, else `|x| − β/2`; `None`
/// when `V` is empty. Summed over channels, as [`L2Loss`](crate::L2Loss) is: PyTorch's mean over channels
/// too is this, divided by the width.
///
/// Channels of unit rows differ by at most 2, and by hundredths if the rows are wide: a `beta` of 1 is half
/// of `L2Loss` there. Near 1/√D it begins to spare channels that are far off.
///
/// # Source
/// `torch.nn.SmoothL1Loss`. Differs: the sum over channels; sums are f64; a value that is not finite is an
/// error that names it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothL1Loss {
    /// Where it becomes straight, above 0.
    pub beta: f64,
    /// Mean over the valid rows, or sum.
    pub reduction: Reduction,
}

impl Default for SmoothL1Loss {
    fn default() -> Self {
        Self { beta: 1.0, reduction: Reduction::Mean }
    }
}

impl Loss for SmoothL1Loss {
    fn name(&self) -> &str {
        NAME
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        smooth_l1(input.pred, input.needs_target(NAME)?, input.valid, self.beta, self.reduction)
    }
    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a target".to_owned()
    }
    fn settings(&self) -> String {
        format!("beta {}", self.beta)
    }
}

/// [`SmoothL1Loss`] as a function.
///
/// # Shapes
/// `pred`, `target`: `[N, D]`; the target gets no gradient · `valid`: `[N]` · returns a scalar ≥ 0,
/// f32, or f64 if `pred` is
///
/// # Errors
/// If `beta` is not a finite number above 0, shapes differ, or a value of a valid row is not finite.
pub fn smooth_l1(
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    beta: f64,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    check_positive(NAME, "beta", beta)?;
    valid_rows(SmoothDistance { beta }, pred, target, valid, reduction)
}

struct SmoothDistance {
    beta: f64,
}

impl RowLoss for SmoothDistance {
    const NAME: &'static str = NAME;
    type Kept = ();

    #[inline(always)]
    fn value<T: Real>(&self, p: &[T], t: &[T]) -> (f64, ()) {
        let beta = self.beta;
        // A select, not a branch: both sides are cheap.
        let h = |x: f64| {
            let x = x.abs();
            if x < beta { 0.5 * x * (x / beta) } else { x - 0.5 * beta }
        };
        (sum_of_differences(p, t, h), ())
    }

    #[inline(always)]
    fn gradient<T: Real>(&self, (p, t): (&[T], &[T]), (): (), factor: f64, out: &mut [T]) {
        for ((out, p), t) in out.iter_mut().zip(p).zip(t) {
            let x = p.wide() - t.wide();
            *out = T::narrow(factor * (x / self.beta).clamp(-1.0, 1.0));
        }
    }
}

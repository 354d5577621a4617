//! Squared distance to target features.

use crate::error::LossError;
use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, difference_gradient, sum_rows};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::Real;
use crate::vector::sum_of_differences;
use candle_core::{DType, Result, Tensor};
use scenesplat_kernels::simd::compiled;

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
        let target = input.target.ok_or(LossError::Missing { loss: NAME, field: "target" })?;
        l2(input.pred, target, input.valid, self.reduction)
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
    match pred.dtype() {
        DType::F64 => typed::<f64>(pred, target, valid, reduction),
        _ => typed::<f32>(pred, target, valid, reduction),
    }
}

fn typed<T: Real>(
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    let row = |_: usize, p: &[T], t: &[T]| (compiled(|| sum_of_differences(p, t, |d| d * d)), ());
    let (total, _, count) = sum_rows(NAME, pred, target, valid, row)?;
    if count == 0 {
        return Ok(None);
    }
    let factor = reduction.factor(count);
    let valid = valid.map(<[bool]>::to_vec);
    let backward = L2Backward { target: target.detach(), valid, factor };
    scalar_loss(pred, total * factor, backward).map(Some)
}

struct L2Backward {
    target: Tensor,
    valid: Option<Vec<bool>>,
    factor: f64,
}

impl Backward for L2Backward {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        let factor = 2.0 * factor * self.factor;
        let slope = |x: f64| factor * x;
        let valid = self.valid.as_deref();
        match pred.dtype() {
            DType::F64 => difference_gradient::<f64>(NAME, pred, &self.target, valid, slope),
            _ => difference_gradient::<f32>(NAME, pred, &self.target, valid, slope),
        }
    }
}

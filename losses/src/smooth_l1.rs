//! Distance to target features that is squared near the target and straight far from it.

use crate::error::LossError;
use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, difference_gradient, sum_rows};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::Real;
use crate::vector::sum_of_differences;
use candle_core::{DType, Result, Tensor};
use scenesplat_kernels::simd::compiled;

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
        let target = input.target.ok_or(LossError::Missing { loss: NAME, field: "target" })?;
        smooth_l1(input.pred, target, input.valid, self.beta, self.reduction)
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
    if !(beta.is_finite() && beta > 0.0) {
        let (value, expected) = (beta.to_string(), "a finite number above 0");
        return Err(LossError::Setting { loss: NAME, setting: "beta", value, expected }.into());
    }
    match pred.dtype() {
        DType::F64 => typed::<f64>(pred, target, valid, beta, reduction),
        _ => typed::<f32>(pred, target, valid, beta, reduction),
    }
}

fn typed<T: Real>(
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    beta: f64,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    // The short branch is a select: both sides are cheap.
    let h = |x: f64| {
        let x = x.abs();
        if x < beta { 0.5 * x * (x / beta) } else { x - 0.5 * beta }
    };
    let row = |_: usize, p: &[T], t: &[T]| (compiled(|| sum_of_differences(p, t, h)), ());
    let (total, _, count) = sum_rows(NAME, pred, target, valid, row)?;
    if count == 0 {
        return Ok(None);
    }
    let factor = reduction.factor(count);
    let valid = valid.map(<[bool]>::to_vec);
    let backward = SmoothL1Backward { target: target.detach(), valid, beta, factor };
    scalar_loss(pred, total * factor, backward).map(Some)
}

struct SmoothL1Backward {
    target: Tensor,
    valid: Option<Vec<bool>>,
    beta: f64,
    factor: f64,
}

impl Backward for SmoothL1Backward {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        let (factor, beta) = (factor * self.factor, self.beta);
        let slope = |x: f64| factor * (x / beta).clamp(-1.0, 1.0);
        let valid = self.valid.as_deref();
        match pred.dtype() {
            DType::F64 => difference_gradient::<f64>(NAME, pred, &self.target, valid, slope),
            _ => difference_gradient::<f32>(NAME, pred, &self.target, valid, slope),
        }
    }
}

//! iBOT as the original computes it.

use crate::cosine::weighted_cosines;
use crate::error::{LossError, check_len};
use candle_core::{Result, Tensor};

const NAME: &str = "masked_cosine";

/// `−Σ wᵢ cos(studentᵢ, teacherᵢ)` over masked Gaussians; `None` if no weight differs from 0.
///
/// Weights are the caller's: the original has 1 ÷ the number of masked patches (or Gaussians) of the
/// scene for each of its masked Gaussians, so that a value grows with scenes and views. Zero rows cost
/// 0; at a zero row of the student the gradient is the one of ε = 1e-8, as in PyTorch.
///
/// # Shapes
/// `student`, `teacher`: `[M, D]`, any norm; the teacher gets no gradient · `weights`: `[M]`
///
/// # Errors
/// If shapes do not fit, a weight is not finite, or a value of a row with a weight is not.
///
/// # Source
/// `CosinePatchLoss.forward_masked` of SceneSplat be9d5e1. Differs: weights there are rounded to f16;
/// nothing masked is an error there.
pub fn masked_cosine(
    student: &Tensor,
    teacher: &Tensor,
    weights: &[f64],
) -> Result<Option<Tensor>> {
    check_weights(NAME, student, weights)?;
    weighted_cosines(student, teacher, weights)
}

/// Checks that each row has a finite weight.
pub(super) fn check_weights(loss: &'static str, rows: &Tensor, weights: &[f64]) -> Result<()> {
    check_len(loss, "weights", rows.dims().first().copied().unwrap_or(0), weights.len())?;
    match weights.iter().position(|w| !w.is_finite()) {
        None => Ok(()),
        Some(row) => {
            let (field, column, value) = ("weights", 0, weights[row]);
            Err(LossError::NotFinite { loss, field, row, column, value }.into())
        }
    }
}

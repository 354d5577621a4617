//! Cross entropy with a teacher's distribution over prototypes.

use super::masked_cosine::check_weights;
use super::stored::{Views, check_teacher, stored_loss};
use crate::error::check_positive;
use crate::rows::{Reduction, RowLoss, weighted_rows};
use crate::values::Real;
use crate::vector::exp_shifted;
use candle_core::{Result, Tensor};

const MASKED: &str = "masked_cross_entropy";
const VIEWS: &str = "view_cross_entropy";

/// `−Σ wᵢ Σₖ teacherᵢₖ · log softmax(studentᵢ/τ)ₖ` over masked Gaussians; `None` if no weight differs
/// from 0.
///
/// # Shapes
/// `student`: `[M, K]`, logits · `teacher`: `[M, K]`, probabilities ([`Centering`](super::Centering),
/// [`sinkhorn_knopp`](super::sinkhorn_knopp)), without gradient · `weights`: `[M]`
///
/// # Errors
/// If `temperature` is not a finite number above 0, shapes do not fit, or a value of a row with a weight
/// is not finite.
///
/// # Source
/// `iBOTPatchLoss.forward_masked` of SceneSplat be9d5e1 (τ = 0.1), which the released model does not use.
pub fn masked_cross_entropy(
    student: &Tensor,
    teacher: &Tensor,
    weights: &[f64],
    temperature: f64,
) -> Result<Option<Tensor>> {
    check_positive(MASKED, "temperature", temperature)?;
    check_weights(MASKED, student, weights)?;
    let loss = MaskedCrossEntropy { temperature };
    weighted_rows(loss, student, teacher, weights.to_vec(), Reduction::Sum)
}

/// `softmax(row/τ)` into `out`, and the logarithm of its divisor relative to the largest logit, which
/// comes second, divided by τ.
fn softmax<T: Real>(row: &[T], temperature: f64, out: &mut [f64]) -> (f64, f64) {
    out.iter_mut().zip(row).for_each(|(z, v)| *z = v.wide() / temperature);
    let largest = out.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let logits = out.to_vec();
    exp_shifted(&logits, largest, out);
    let sum: f64 = out.iter().sum();
    out.iter_mut().for_each(|p| *p /= sum);
    (sum.ln(), largest)
}

/// Cross entropy of a row, and the mass of its target, which need not be exactly 1.
fn row<T: Real>(student: &[T], teacher: &[T], temperature: f64) -> (f64, f64) {
    let mut p = vec![0.0; student.len()];
    let (log_sum, largest) = softmax(student, temperature, &mut p);
    let (mut cost, mut mass) = (0.0, 0.0);
    for (s, t) in student.iter().zip(teacher) {
        cost += t.wide() * (largest - s.wide() / temperature + log_sum);
        mass += t.wide();
    }
    (cost, mass)
}

struct MaskedCrossEntropy {
    temperature: f64,
}

impl RowLoss for MaskedCrossEntropy {
    const NAME: &'static str = MASKED;
    /// The mass of the target.
    type Kept = f64;

    #[inline(always)]
    fn value<T: Real>(&self, student: &[T], teacher: &[T]) -> (f64, f64) {
        row(student, teacher, self.temperature)
    }

    #[inline(always)]
    fn gradient<T: Real>(&self, (s, t): (&[T], &[T]), mass: f64, factor: f64, out: &mut [T]) {
        let mut p = vec![0.0; s.len()];
        softmax(s, self.temperature, &mut p);
        let slope = factor / self.temperature;
        for ((out, p), t) in out.iter_mut().zip(&p).zip(t) {
            *out = T::narrow(slope * (p * mass - t.wide()));
        }
    }
}

/// `Σ` over views of teacher and student of the mean over scenes of the cross entropy of
/// `softmax(student/τ)` with the teacher's distribution; `None` for no scenes.
///
/// `same_view` says whether the teacher's view `t` is compared with the student's view `t`, too: the
/// original does, DINO does not.
///
/// # Shapes
/// `student`: `[S, B, K]`, logits · `teacher`: `[T, B, K]`, probabilities, `1 ≤ T ≤ S`
///
/// # Errors
/// If `temperature` is not a finite number above 0, shapes do not fit, or a value is not finite.
///
/// # Source
/// `DINOLoss` of SceneSplat be9d5e1 (τ = 0.1), which the released model does not use.
pub fn view_cross_entropy(
    student: &Tensor,
    teacher: &Tensor,
    temperature: f64,
    same_view: bool,
) -> Result<Option<Tensor>> {
    check_positive(VIEWS, "temperature", temperature)?;
    let s = Views::read(VIEWS, "student", student, 3)?;
    let t = Views::read(VIEWS, "teacher", teacher, 3)?;
    check_teacher(VIEWS, &s, &t)?;
    let pairs = t.views * s.views - if same_view { 0 } else { t.views };
    if s.scenes == 0 || s.width == 0 || pairs == 0 {
        return Ok(None);
    }
    let scenes = s.scenes as f64;
    let mut gradient = vec![0.0; s.values.len()];
    let (mut total, mut p) = (0.0, vec![0.0; s.width]);
    for view in 0..s.views {
        for scene in 0..s.scenes {
            let own = s.row(view, scene);
            softmax(own, temperature, &mut p);
            let at = (view * s.scenes + scene) * s.width;
            for other in (0..t.views).filter(|other| same_view || *other != view) {
                let target = t.row(other, scene);
                let (cost, mass) = row(own, target, temperature);
                total += cost / scenes;
                let out = &mut gradient[at..at + s.width];
                for ((g, p), t) in out.iter_mut().zip(&p).zip(target) {
                    *g += (p * mass - t) / (temperature * scenes);
                }
            }
        }
    }
    stored_loss(VIEWS, student, total, gradient).map(Some)
}

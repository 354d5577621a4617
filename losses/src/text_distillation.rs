//! A teacher's answers over the texts of the classes, for a student to give too.

use crate::contrastive::TextColumns;
use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, RowLoss, valid_rows};
use crate::values::Real;
use crate::vector::{exp_shifted, sum};
use candle_core::{Result, Tensor};

const NAME: &str = "text_distillation";

/// Kullback–Leibler divergence of the student's answers from the teacher's.
///
/// A row's answer is the softmax over the classes of `cos(row, textᵢ) / τ`; the loss is
/// `1/|V| · Σ_{i∈V} Σ_c q_ic (log q_ic − log p_ic)` with `q` of the target row and `p` of the predicted one.
/// Texts of a language model are much alike, so that rows which are near the teacher's may still be nearest to
/// another text; this term asks for the same answer. It needs no label. The gradient is not multiplied
/// with τ², as some do: the weight of the term can say so.
///
/// # Shapes
/// `pred`, `target`: `[N, D]`, rows of unit length; the target gets no gradient · `valid`: `[N]` · texts: C
/// rows of width D
///
/// # Source
/// Hinton, Vinyals, Dean, "Distilling the Knowledge in a Neural Network", 2015, with texts for classes. Not
/// part of the original system.
#[derive(Debug, Clone)]
pub struct TextDistillation {
    /// Texts of the classes.
    pub texts: TextColumns,
    /// τ, above 0; the smaller, the more the nearest texts decide.
    pub temperature: f64,
    /// Mean over the valid rows, or sum.
    pub reduction: Reduction,
}

impl TextDistillation {
    /// With temperature 0.05.
    pub fn new(texts: TextColumns) -> Self {
        Self { texts, temperature: 0.05, reduction: Reduction::Mean }
    }
}

impl Loss for TextDistillation {
    fn name(&self) -> &str {
        NAME
    }

    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let target = input.needs_target(NAME)?.detach();
        let student = self.texts.logits(NAME, "pred", input.pred, self.temperature)?;
        let teacher = self.texts.logits(NAME, "target", &target, self.temperature)?;
        let teacher = teacher.to_dtype(student.dtype())?;
        valid_rows(Divergence, &student, &teacher, input.valid, self.reduction)
    }

    fn off_reason(&self, _: &LossInput<'_>) -> String {
        "no row has a target".to_owned()
    }

    fn settings(&self) -> String {
        format!("temperature {}, {} texts", self.temperature, self.texts.len())
    }
}

/// Logarithms of the sums of exponentials of a row's logits and of its target's.
#[derive(Clone, Copy, Default)]
struct Kept {
    student: f64,
    teacher: f64,
}

struct Divergence;

impl RowLoss for Divergence {
    const NAME: &'static str = NAME;
    type Kept = Kept;

    #[inline(always)]
    fn value<T: Real>(&self, p: &[T], q: &[T]) -> (f64, Kept) {
        let (student, teacher) = (log_sum(p), log_sum(q));
        let term = |(p, q): (&T, &T)| {
            let log_q = q.wide() - teacher;
            log_q.exp() * (log_q - (p.wide() - student))
        };
        // Rounding may leave a little less than nothing of equal answers.
        let value: f64 = p.iter().zip(q).map(term).sum();
        (if value < 0.0 { 0.0 } else { value }, Kept { student, teacher })
    }

    /// `p − q`
    #[inline(always)]
    fn gradient<T: Real>(&self, (p, q): (&[T], &[T]), kept: Kept, factor: f64, out: &mut [T]) {
        for ((out, p), q) in out.iter_mut().zip(p).zip(q) {
            let (p, q) = (p.wide() - kept.student, q.wide() - kept.teacher);
            *out = T::narrow(factor * (p.exp() - q.exp()));
        }
    }
}

/// `log Σ eˣ`; NaN if a value is not finite.
#[inline(always)]
fn log_sum<T: Real>(x: &[T]) -> f64 {
    let largest = x.iter().map(|v| v.wide()).fold(f64::NEG_INFINITY, f64::max);
    let mut terms = vec![0.0; x.len()];
    exp_shifted(x, largest, &mut terms);
    if x.iter().all(|v| v.wide().is_finite()) { largest + sum(&terms).ln() } else { f64::NAN }
}

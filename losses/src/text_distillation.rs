//! A teacher's answers over the texts of the classes, for a student to give too.

use crate::contrastive::TextColumns;
use crate::error::LossError;
use crate::loss::{Loss, LossInput};
use crate::rows::{Reduction, sum_rows};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::{Real, make_rows, read_matrix};
use crate::vector::{exp_shifted, sum};
use candle_core::{DType, Result, Tensor};
use scenesplat_kernels::simd::compiled;

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

    fn logits(&self, rows: &Tensor, field: &'static str) -> Result<Tensor> {
        let dtype = if rows.dtype() == DType::F64 { DType::F64 } else { DType::F32 };
        let (n, width) = rows.dims2()?;
        if width != self.texts.width() {
            let expected = format!("[N, {}]", self.texts.width());
            let got = format!("[{n}, {width}]");
            return Err(LossError::Shape { loss: NAME, field, expected, got }.into());
        }
        let texts = self.texts.columns().to_dtype(dtype)?.to_device(rows.device())?;
        rows.to_dtype(dtype)?.matmul(&texts)? * (1.0 / self.temperature)
    }
}

impl Loss for TextDistillation {
    fn name(&self) -> &str {
        NAME
    }

    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        let target = input.target.ok_or(LossError::Missing { loss: NAME, field: "target" })?;
        let student = self.logits(input.pred, "pred")?;
        let teacher = self.logits(&target.detach(), "target")?.to_dtype(student.dtype())?;
        match student.dtype() {
            DType::F64 => divergence::<f64>(&student, &teacher, input.valid, self.reduction),
            _ => divergence::<f32>(&student, &teacher, input.valid, self.reduction),
        }
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

fn divergence<T: Real>(
    student: &Tensor,
    teacher: &Tensor,
    valid: Option<&[bool]>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    let (total, kept, count) = sum_rows(NAME, student, teacher, valid, |_, s, t| row::<T>(s, t))?;
    if count == 0 {
        return Ok(None);
    }
    let valid = valid.map(<[bool]>::to_vec);
    let factor = reduction.factor(count);
    let backward = DivergenceBackward { teacher: teacher.detach(), valid, kept, factor };
    scalar_loss(student, total * factor, backward).map(Some)
}

fn row<T: Real>(p: &[T], q: &[T]) -> (f64, Kept) {
    let (student, teacher) = (log_sum(p), log_sum(q));
    let term = |(p, q): (&T, &T)| {
        let log_q = q.wide() - teacher;
        log_q.exp() * (log_q - (p.wide() - student))
    };
    // Rounding may leave a little less than nothing of equal answers.
    let value: f64 = p.iter().zip(q).map(term).sum();
    (if value < 0.0 { 0.0 } else { value }, Kept { student, teacher })
}

/// `log Σ eˣ`; NaN if a value is not finite.
fn log_sum<T: Real>(x: &[T]) -> f64 {
    let largest = x.iter().map(|v| v.wide()).fold(f64::NEG_INFINITY, f64::max);
    let mut terms = vec![0.0; x.len()];
    compiled(|| exp_shifted(x, largest, &mut terms));
    if x.iter().all(|v| v.wide().is_finite()) { largest + sum(&terms).ln() } else { f64::NAN }
}

struct DivergenceBackward {
    teacher: Tensor,
    valid: Option<Vec<bool>>,
    kept: Vec<Kept>,
    factor: f64,
}

impl Backward for DivergenceBackward {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient(&self, student: &Tensor, factor: f64) -> Result<Tensor> {
        match student.dtype() {
            DType::F64 => self.typed::<f64>(student, factor),
            _ => self.typed::<f32>(student, factor),
        }
    }
}

impl DivergenceBackward {
    /// `p − q`.
    fn typed<T: Real>(&self, student: &Tensor, factor: f64) -> Result<Tensor> {
        let factor = factor * self.factor;
        read_matrix(NAME, "pred", student, |p| {
            read_matrix(NAME, "target", &self.teacher, |q| {
                make_rows::<T>(student, |first, out| {
                    let (mut p_scratch, mut q_scratch) = (Vec::new(), Vec::new());
                    for (row, out) in (first..).zip(out.chunks_exact_mut(p.columns)) {
                        if self.valid.as_ref().is_some_and(|v| !v[row]) {
                            continue;
                        }
                        let kept = self.kept[row];
                        let p = p.read::<T>(row..row + 1, &mut p_scratch);
                        let q = q.read::<T>(row..row + 1, &mut q_scratch);
                        for ((out, p), q) in out.iter_mut().zip(p).zip(q) {
                            let (p, q) = (p.wide() - kept.student, q.wide() - kept.teacher);
                            *out = T::narrow(factor * (p.exp() - q.exp()));
                        }
                    }
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    const TEXTS: [[f64; 2]; 3] = [[1.0, 0.0], [0.0, 1.0], [-0.8, 0.6]];

    fn loss(temperature: f64) -> TextDistillation {
        let texts = TextColumns::new(&[1.0, 0.0, 0.0, 1.0, -0.8, 0.6], 2).unwrap();
        TextDistillation { temperature, ..TextDistillation::new(texts) }
    }

    fn value(
        loss: &TextDistillation,
        pred: &Tensor,
        target: &Tensor,
        valid: Option<&[bool]>,
    ) -> Result<Option<Tensor>> {
        let target = Some(target);
        loss.forward(&LossInput { pred, target, label: None, valid, progress: 0.0, seed: 0 })
    }

    /// The formula, without any care for range.
    fn by_hand(pred: &[[f64; 2]], target: &[[f64; 2]], valid: &[bool], temperature: f64) -> f64 {
        let answer = |row: &[f64; 2]| {
            let e = TEXTS.map(|t| ((t[0] * row[0] + t[1] * row[1]) / temperature).exp());
            e.map(|v| v / e.iter().sum::<f64>())
        };
        let rows = pred.iter().zip(target).zip(valid).filter(|(_, v)| **v);
        let terms = rows.clone().map(|((p, q), _)| {
            let (p, q) = (answer(p), answer(q));
            (0..3).map(|c| q[c] * (q[c] / p[c]).ln()).sum::<f64>()
        });
        terms.sum::<f64>() / rows.count() as f64
    }

    const PRED: [[f64; 2]; 4] = [[0.6, 0.8], [-1.0, 0.0], [0.0, -1.0], [0.8, 0.6]];
    const TARGET: [[f64; 2]; 4] = [[1.0, 0.0], [-0.6, 0.8], [0.6, 0.8], [0.8, 0.6]];
    const VALID: [bool; 4] = [true, true, false, true];

    #[test]
    fn by_hand_and_against_central_differences() {
        let target = Tensor::new(&TARGET, &Device::Cpu).unwrap();
        for temperature in [1.0, 0.3] {
            let term = loss(temperature);
            let at = |rows: &[[f64; 2]; 4]| {
                let pred = Tensor::new(rows, &Device::Cpu).unwrap();
                let found = value(&term, &pred, &target, Some(&VALID)).unwrap().unwrap();
                found.to_scalar::<f64>().unwrap()
            };
            assert!((at(&PRED) - by_hand(&PRED, &TARGET, &VALID, temperature)).abs() < 1e-6);
            let pred = Var::new(&PRED, &Device::Cpu).unwrap();
            let found = value(&term, &pred, &target, Some(&VALID)).unwrap().unwrap();
            let grads = found.backward().unwrap();
            let grads = grads.get(&pred).unwrap().to_vec2::<f64>().unwrap();
            for r in 0..4 {
                for c in 0..2 {
                    let moved = |step: f64| {
                        let mut moved = PRED;
                        moved[r][c] += step;
                        at(&moved)
                    };
                    let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                    assert!((grads[r][c] - expected).abs() < 1e-7, "{r} {c}");
                }
            }
        }
    }

    #[test]
    fn sharp_answers_stay_finite_and_right() {
        // One row each, right and wrong: beyond what exp can hold in f32.
        let rows = |rows: [[f32; 2]; 1]| Tensor::new(&rows, &Device::Cpu).unwrap();
        let term = loss(1e-4);
        let found = |p, q| {
            let found = value(&term, &rows(p), &rows(q), None).unwrap().unwrap();
            found.to_scalar::<f32>().unwrap()
        };
        assert_eq!(found([[1.0, 0.0]], [[1.0, 0.0]]), 0.0);
        // The teacher is sure of the first text, the student of the second: 1/τ.
        assert!((found([[0.0, 1.0]], [[1.0, 0.0]]) / 1e4 - 1.0).abs() < 1e-5);
        let var = Var::new(&[[0.0_f32, 1.0]], &Device::Cpu).unwrap();
        let loss = value(&term, &var, &rows([[1.0, 0.0]]), None).unwrap().unwrap();
        let gradient = loss.backward().unwrap().get(&var).unwrap().to_vec2::<f32>().unwrap();
        // Away from the second text, to the first, each 1/τ.
        assert!((gradient[0][0] / -1e4 - 1.0).abs() < 1e-5, "{gradient:?}");
        assert!((gradient[0][1] / 1e4 - 1.0).abs() < 1e-5, "{gradient:?}");
    }

    #[test]
    fn what_is_missing_or_not_finite() {
        let rows = |rows: [[f32; 2]; 2]| Tensor::new(&rows, &Device::Cpu).unwrap();
        let good = rows([[1.0, 0.0], [0.0, 1.0]]);
        let term = loss(0.1);
        assert!(value(&term, &good, &good, Some(&[false, false])).unwrap().is_none());
        let bad = rows([[1.0, 0.0], [f32::NAN, 1.0]]);
        // Not read where it does not count.
        assert!(value(&term, &good, &bad, Some(&[true, false])).unwrap().is_some());
        for (pred, target, field) in [(&bad, &good, "pred"), (&good, &bad, "target")] {
            let error = value(&term, pred, target, None).unwrap_err().to_string();
            assert!(error.contains(NAME) && error.contains(field), "{error}");
        }
        let wide = Tensor::zeros((2, 3), DType::F32, &Device::Cpu).unwrap();
        assert!(value(&term, &wide, &wide, None).is_err());
        let none = LossInput {
            pred: &good,
            target: None,
            label: None,
            valid: None,
            progress: 0.0,
            seed: 0,
        };
        assert!(term.forward(&none).is_err());
    }
}

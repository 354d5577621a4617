//! What losses that compare rows with target rows share.

use crate::error::{LossError, check_len};
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::{Matrix, Real, make_rows, read_matrix, rows_per_task};
use candle_core::{DType, Result, Tensor};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;
use serde::{Deserialize, Serialize};

/// How terms of rows (or of classes) become one number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduction {
    /// Divided by the number of those that count.
    #[default]
    Mean,
    /// Added up.
    Sum,
}

impl Reduction {
    /// What a sum over `count` terms is multiplied with.
    pub(crate) fn factor(self, count: usize) -> f64 {
        match self {
            Self::Mean => 1.0 / count as f64,
            Self::Sum => 1.0,
        }
    }
}

/// A loss that adds up a term for each pair of a predicted row and its target row.
///
/// Both functions run [compiled](scenesplat_kernels::simd::compiled) for the CPU; they must be inlined.
pub(crate) trait RowLoss: Send + Sync + 'static {
    /// Name of the loss in messages.
    const NAME: &'static str;
    /// What the gradient of a row needs beside its values.
    type Kept: Copy + Default + Send + Sync;
    /// The term of a row.
    fn value<T: Real>(&self, pred: &[T], target: &[T]) -> (f64, Self::Kept);
    /// `factor` times the gradient of the term to the predicted row, into `out`.
    fn gradient<T: Real>(&self, rows: (&[T], &[T]), kept: Self::Kept, factor: f64, out: &mut [T]);
}

/// The reduced sum of a loss over the valid rows; `None` if there is none.
pub(crate) fn valid_rows<L: RowLoss>(
    loss: L,
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    let rows = pred.dims().first().copied().unwrap_or(0);
    let weights = match valid {
        None => vec![1.0; rows],
        Some(valid) => {
            check_len(L::NAME, "valid", rows, valid.len())?;
            valid.iter().map(|v| f64::from(u8::from(*v))).collect()
        }
    };
    weighted_rows(loss, pred, target, weights, reduction)
}

/// The reduced sum of `weightᵢ · termᵢ`; rows of weight 0 are not read and do not count. `None` if no row
/// counts.
///
/// # Shapes
/// `pred`, `target`: `[N, D]`; the target gets no gradient · `weights`: `[N]`, finite
pub(crate) fn weighted_rows<L: RowLoss>(
    loss: L,
    pred: &Tensor,
    target: &Tensor,
    weights: Vec<f64>,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    check_target(L::NAME, pred, target)?;
    let (total, kept) = match pred.dtype() {
        DType::F64 => sum_rows::<f64, L>(&loss, pred, target, &weights),
        _ => sum_rows::<f32, L>(&loss, pred, target, &weights),
    }?;
    let count = weights.iter().filter(|w| **w != 0.0).count();
    if count == 0 {
        return Ok(None);
    }
    let factor = reduction.factor(count);
    let backward = RowsBackward { loss, target: target.detach(), weights, kept, factor };
    scalar_loss(pred, total * factor, backward).map(Some)
}

/// Checks that the target has the shape of the predictions.
pub(crate) fn check_target(loss: &'static str, pred: &Tensor, target: &Tensor) -> Result<()> {
    if pred.dims() == target.dims() {
        return Ok(());
    }
    let expected = format!("{:?}", pred.dims());
    Err(LossError::shape(loss, "target", expected, target.dims()).into())
}

/// The weighted sum, and what each row keeps.
fn sum_rows<T: Real, L: RowLoss>(
    loss: &L,
    pred: &Tensor,
    target: &Tensor,
    weights: &[f64],
) -> Result<(f64, Vec<L::Kept>)> {
    read_matrix(L::NAME, "pred", pred, |p| {
        read_matrix(L::NAME, "target", target, |t| {
            let task = rows_per_task(p.columns);
            let mut kept = vec![L::Kept::default(); p.rows];
            let parts: Vec<_> = kept
                .par_chunks_mut(task)
                .enumerate()
                .map_init(Default::default, |scratch, (i, kept)| {
                    sum_task::<T, L>(loss, (p, t), weights, i * task, kept, scratch)
                })
                .collect();
            let mut total = 0.0;
            for part in parts {
                total += part?;
            }
            Ok((total, kept))
        })
    })
}

/// A result that is not finite is an error where a value of the row is not finite.
fn sum_task<T: Real, L: RowLoss>(
    loss: &L,
    (p, t): (&Matrix<'_>, &Matrix<'_>),
    weights: &[f64],
    first: usize,
    kept: &mut [L::Kept],
    (p_scratch, t_scratch): &mut (Vec<T>, Vec<T>),
) -> std::result::Result<f64, LossError> {
    let mut total = 0.0;
    for (row, keep) in (first..).zip(kept).filter(|(row, _)| weights[*row] != 0.0) {
        let (p_row, t_row) = (p.read(row..row + 1, p_scratch), t.read(row..row + 1, t_scratch));
        let value;
        (value, *keep) = compiled(|| loss.value(p_row, t_row));
        let value = weights[row] * value;
        if !value.is_finite() {
            let bad = p.not_finite(L::NAME, "pred", row);
            if let Some(error) = bad.or_else(|| t.not_finite(L::NAME, "target", row)) {
                return Err(error);
            }
        }
        total += value;
    }
    Ok(total)
}

struct RowsBackward<L: RowLoss> {
    loss: L,
    target: Tensor,
    weights: Vec<f64>,
    kept: Vec<L::Kept>,
    factor: f64,
}

impl<L: RowLoss> Backward for RowsBackward<L> {
    fn name(&self) -> &'static str {
        L::NAME
    }
    fn gradient<T: Real>(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        let factor = factor * self.factor;
        read_matrix(L::NAME, "pred", pred, |p| {
            read_matrix(L::NAME, "target", &self.target, |t| {
                make_rows::<T>(pred, |first, out| {
                    let (mut p_scratch, mut t_scratch) = (Vec::new(), Vec::new());
                    for (row, out) in (first..).zip(out.chunks_exact_mut(p.columns)) {
                        if self.weights[row] == 0.0 {
                            continue;
                        }
                        let p = p.read::<T>(row..row + 1, &mut p_scratch);
                        let t = t.read::<T>(row..row + 1, &mut t_scratch);
                        let factor = factor * self.weights[row];
                        compiled(|| self.loss.gradient((p, t), self.kept[row], factor, out));
                    }
                })
            })
        })
    }
}

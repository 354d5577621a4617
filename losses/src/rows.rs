//! What losses that compare rows with target rows share.

use crate::error::{LossError, check_len};
use crate::values::{Matrix, Real, make_rows, read_matrix, rows_per_task};
use candle_core::{Result, Tensor};
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

/// Checks that there is a target row for each row of the predictions.
pub(crate) fn check_target(
    loss: &'static str,
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
) -> Result<()> {
    if pred.dims() != target.dims() {
        let (expected, got) = (format!("{:?}", pred.dims()), format!("{:?}", target.dims()));
        return Err(LossError::Shape { loss, field: "target", expected, got }.into());
    }
    if let Some(valid) = valid {
        check_len(loss, "valid", pred.dim(0)?, valid.len())?;
    }
    Ok(())
}

/// Sum over the rows that count of what `row_loss` gives for a row's number, its values and its target; what it keeps of
/// each row; and the number of rows that count.
///
/// A result that is not finite is an error where a value of the row is not finite.
pub(crate) fn sum_rows<T: Real, K: Copy + Default + Send + Sync>(
    loss: &'static str,
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    row_loss: impl Fn(usize, &[T], &[T]) -> (f64, K) + Sync,
) -> Result<(f64, Vec<K>, usize)> {
    check_target(loss, pred, target, valid)?;
    read_matrix(loss, "pred", pred, |p| {
        read_matrix(loss, "target", target, |t| {
            let task = rows_per_task(p.columns);
            let mut kept = vec![K::default(); p.rows];
            let parts: Vec<_> = kept
                .par_chunks_mut(task)
                .enumerate()
                .map_init(Default::default, |scratch, (i, kept)| {
                    sum_task(loss, (p, t), valid, i * task, kept, scratch, &row_loss)
                })
                .collect();
            let mut total = 0.0;
            for part in parts {
                total += part?;
            }
            let count = valid.map_or(p.rows, |v| v.iter().filter(|v| **v).count());
            Ok((total, kept, count))
        })
    })
}

fn sum_task<T: Real, K>(
    loss: &'static str,
    (p, t): (&Matrix<'_>, &Matrix<'_>),
    valid: Option<&[bool]>,
    first: usize,
    kept: &mut [K],
    (p_scratch, t_scratch): &mut (Vec<T>, Vec<T>),
    row_loss: impl Fn(usize, &[T], &[T]) -> (f64, K),
) -> std::result::Result<f64, LossError> {
    let mut total = 0.0;
    for (row, keep) in (first..).zip(kept) {
        if valid.is_some_and(|v| !v[row]) {
            continue;
        }
        let (p_row, t_row) = (p.read(row..row + 1, p_scratch), t.read(row..row + 1, t_scratch));
        let value;
        (value, *keep) = row_loss(row, p_row, t_row);
        if !value.is_finite() {
            let bad = p.not_finite(loss, "pred", row);
            if let Some(error) = bad.or_else(|| t.not_finite(loss, "target", row)) {
                return Err(error);
            }
        }
        total += value;
    }
    Ok(total)
}

/// The gradient of a loss that sums a function of `p − t` over rows that count and their channels:
/// `slope(p − t)`, zeros in the other rows.
pub(crate) fn difference_gradient<T: Real>(
    loss: &'static str,
    pred: &Tensor,
    target: &Tensor,
    valid: Option<&[bool]>,
    slope: impl Fn(f64) -> f64 + Sync,
) -> Result<Tensor> {
    read_matrix(loss, "pred", pred, |p| {
        read_matrix(loss, "target", target, |t| {
            make_rows::<T>(pred, |first, out| {
                let (mut p_scratch, mut t_scratch) = (Vec::new(), Vec::new());
                for (row, out) in (first..).zip(out.chunks_exact_mut(p.columns)) {
                    if valid.is_some_and(|v| !v[row]) {
                        continue;
                    }
                    let p = p.read::<T>(row..row + 1, &mut p_scratch);
                    let t = t.read::<T>(row..row + 1, &mut t_scratch);
                    compiled(|| {
                        for ((out, p), t) in out.iter_mut().zip(p).zip(t) {
                            *out = T::narrow(slope(p.wide() - t.wide()));
                        }
                    });
                }
            })
        })
    })
}

//! The loss between the sums of halves, and its gradient.

use super::{ClassHalves, NAME};
use crate::error::{LossError, check_positive};
use crate::rows::Reduction;
use crate::scalar_op::{Backward, scalar_loss};
use crate::values::{Matrix, Real, make_rows, read_matrix};
use crate::vector::{dot, norm};
use candle_core::{DType, Result, Tensor};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled;

/// Norms below this count as this, as in PyTorch.
const EPS: f64 = 1e-12;
/// Rows of one partial sum.
const TASK: usize = 1024;
/// The half of a row that is in none.
const NONE: u32 = u32::MAX;

/// [`AggregatedContrastive`](super::AggregatedContrastive) of given halves; `None` without any class.
///
/// # Shapes
/// `pred`: `[N, D]`; rows in no half get no gradient · returns a scalar ≥ 0, f32, or f64 if `pred`
/// is
///
/// # Errors
/// If the temperature is not above 0, a half is empty, a row does not exist or stands in two halves,
/// or a value of a row in a half is not finite.
pub fn aggregated_contrastive(
    pred: &Tensor,
    classes: &[ClassHalves],
    temperature: f64,
    reduction: Reduction,
) -> Result<Option<Tensor>> {
    check_positive(NAME, "temperature", temperature)?;
    let half_of_row = half_of_row(pred.dims2()?.0, classes).map_err(|value| {
        let (setting, expected) = ("rows of a class", "existing rows, each once");
        LossError::Setting { loss: NAME, setting, value, expected }
    })?;
    if classes.is_empty() {
        return Ok(None);
    }
    let sums = match pred.dtype() {
        DType::F64 => sums::<f64>(pred, classes),
        _ => sums::<f32>(pred, classes),
    }?;
    let (value, gradients) = contrast(&sums, temperature, reduction);
    scalar_loss(pred, value, SumsBackward { half_of_row, gradients }).map(Some)
}

/// Number of the half that each row is in: `2·class`, `2·class + 1`, or [`NONE`]. Or what is wrong.
fn half_of_row(rows: usize, classes: &[ClassHalves]) -> std::result::Result<Vec<u32>, String> {
    let mut of = vec![NONE; rows];
    for (class, c) in classes.iter().enumerate() {
        for (half, members) in [&c.first, &c.second].into_iter().enumerate() {
            if members.is_empty() {
                return Err(format!("an empty half of class {}", c.label));
            }
            for &row in members {
                match of.get_mut(row as usize) {
                    Some(free) if *free == NONE => *free = (2 * class + half) as u32,
                    Some(_) => return Err(format!("row {row} twice")),
                    None => return Err(format!("row {row} of {rows}")),
                }
            }
        }
    }
    Ok(of)
}

/// Sum of the rows of each half, the two halves of a class behind each other.
fn sums<T: Real>(pred: &Tensor, classes: &[ClassHalves]) -> Result<Vec<Vec<f64>>> {
    read_matrix(NAME, "pred", pred, |p| {
        let halves = classes.iter().flat_map(|c| [&c.first, &c.second]).enumerate();
        let tasks: Vec<(usize, &[u32])> =
            halves.flat_map(|(half, rows)| rows.chunks(TASK).map(move |r| (half, r))).collect();
        let parts: Vec<_> =
            tasks.par_iter().map_init(Vec::new, |s, (_, rows)| sum::<T>(p, rows, s)).collect();
        let mut sums = vec![vec![0.0; p.columns]; 2 * classes.len()];
        for ((half, rows), part) in tasks.iter().zip(&parts) {
            sums[*half].iter_mut().zip(part).for_each(|(s, p)| *s += p);
            if part.iter().any(|v| !v.is_finite()) {
                let bad = rows.iter().find_map(|r| p.not_finite(NAME, "pred", *r as usize));
                if let Some(error) = bad {
                    return Err(error.into());
                }
            }
        }
        Ok(sums)
    })
}

fn sum<T: Real>(pred: &Matrix<'_>, rows: &[u32], scratch: &mut Vec<T>) -> Vec<f64> {
    let mut sum = vec![0.0; pred.columns];
    for &row in rows {
        let values = pred.read(row as usize..row as usize + 1, scratch);
        compiled(|| sum.iter_mut().zip(values).for_each(|(s, v)| *s += v.wide()));
    }
    sum
}

/// A sum at unit length, and what it was divided by.
struct Unit {
    direction: Vec<f64>,
    norm: f64,
}

impl Unit {
    fn new(sum: &[f64]) -> Self {
        let norm = norm(sum).max(EPS);
        Self { direction: sum.iter().map(|v| v / norm).collect(), norm }
    }

    /// The gradient of the sum from that of the unit vector.
    fn gradient(&self, grad: &[f64]) -> Vec<f64> {
        // Below the floor the divisor is a constant.
        let along = if self.norm > EPS { compiled(|| dot(&self.direction, grad)) } else { 0.0 };
        let pairs = grad.iter().zip(&self.direction);
        pairs.map(|(g, u)| (g - along * u) / self.norm).collect()
    }
}

/// The loss, and its gradient to each sum.
fn contrast(sums: &[Vec<f64>], temperature: f64, reduction: Reduction) -> (f64, Vec<Vec<f64>>) {
    let units: Vec<Unit> = sums.par_iter().map(|s| Unit::new(s)).collect();
    let n = sums.len() / 2;
    let (a, b) = (|i: usize| &units[2 * i].direction, |i: usize| &units[2 * i + 1].direction);
    let logits: Vec<f64> = (0..n * n)
        .into_par_iter()
        .with_min_len(16)
        .map(|at| compiled(|| dot(a(at / n), b(at % n))) / temperature)
        .collect();
    let row = |i: usize| (0..n).map(move |j| i * n + j);
    let column = |j: usize| (0..n).map(move |i| i * n + j);
    let log_sum = |at: &mut dyn Iterator<Item = usize>| -> f64 {
        let values: Vec<f64> = at.map(|at| logits[at]).collect();
        let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        largest + values.iter().map(|v| (v - largest).exp()).sum::<f64>().ln()
    };
    let of_rows: Vec<f64> = (0..n).map(|i| log_sum(&mut row(i))).collect();
    let of_columns: Vec<f64> = (0..n).map(|j| log_sum(&mut column(j))).collect();
    let factor = 0.5 * reduction.factor(n);
    let costs =
        (0..n).map(|i| (of_rows[i] - logits[i * n + i]) + (of_columns[i] - logits[i * n + i]));
    let value = factor * costs.sum::<f64>();

    let grad = |i: usize, j: usize| {
        let z = logits[i * n + j];
        let hit = if i == j { 2.0 } else { 0.0 };
        factor * ((z - of_rows[i]).exp() + (z - of_columns[j]).exp() - hit) / temperature
    };
    let gradients = (0..2 * n).into_par_iter().map(|half| {
        let i = half / 2;
        let mut gradient = vec![0.0; sums[half].len()];
        for j in 0..n {
            let (factor, other) =
                if half % 2 == 0 { (grad(i, j), b(j)) } else { (grad(j, i), a(j)) };
            compiled(|| gradient.iter_mut().zip(other).for_each(|(g, o)| *g += factor * o));
        }
        units[half].gradient(&gradient)
    });
    (value, gradients.collect())
}

struct SumsBackward {
    half_of_row: Vec<u32>,
    /// Of the sum of each half; every row of it has the same.
    gradients: Vec<Vec<f64>>,
}

impl Backward for SumsBackward {
    fn name(&self) -> &'static str {
        NAME
    }
    fn gradient<T: Real>(&self, pred: &Tensor, factor: f64) -> Result<Tensor> {
        let scaled = |g: &Vec<f64>| g.iter().map(|v| T::narrow(factor * v)).collect();
        let scaled: Vec<Vec<T>> = self.gradients.iter().map(scaled).collect();
        let columns = pred.dim(1)?;
        make_rows::<T>(pred, |first, out| {
            for (out, half) in out.chunks_exact_mut(columns).zip(&self.half_of_row[first..]) {
                if *half != NONE {
                    out.copy_from_slice(&scaled[*half as usize]);
                }
            }
        })
    }
}

//! A teacher's logits as distributions that no prototype can take over.

use super::stored::finite_values;
use crate::error::{LossError, check_positive};
use candle_core::{DType, Result, Tensor};

const CENTERING: &str = "centering";
const SINKHORN: &str = "sinkhorn_knopp";

fn logits(loss: &'static str, tensor: &Tensor) -> Result<(Vec<f64>, usize, usize)> {
    let &[rows, width] = tensor.dims() else {
        return Err(LossError::shape(loss, "logits", "[N, K]", tensor.dims()).into());
    };
    Ok((finite_values(loss, "logits", tensor, width)?, rows, width))
}

/// `ln Σ exp(v)`; −∞ for nothing.
fn log_sum_exp(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = values.clone().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + values.map(|v| (v - largest).exp()).sum::<f64>().ln()
}

/// A running mean of logits, subtracted before the softmax.
///
/// # Source
/// DINO (arXiv:2104.14294), section 3.1.
#[derive(Debug, Clone, PartialEq)]
pub struct Centering {
    /// The mean. `[K]`
    pub center: Vec<f64>,
    /// Share of it that stays at an [`update`](Self::update), in 0..=1.
    pub momentum: f64,
}

impl Centering {
    /// Starts at zero.
    pub fn new(prototypes: usize, momentum: f64) -> Self {
        Self { center: vec![0.0; prototypes], momentum }
    }

    /// `softmax((logits − center)/τ)`, without gradient, in f32, or f64 if the logits are.
    ///
    /// # Shapes
    /// `logits`: `[N, K]` · returns `[N, K]`; rows add up to 1
    ///
    /// # Errors
    /// If the width differs, a logit is not finite, or `temperature` is not a finite number above 0.
    pub fn targets(&self, logits_of_teacher: &Tensor, temperature: f64) -> Result<Tensor> {
        check_positive(CENTERING, "temperature", temperature)?;
        let (mut values, rows, width) = self.read(logits_of_teacher)?;
        for row in values.chunks_exact_mut(width.max(1)) {
            row.iter_mut().zip(&self.center).for_each(|(v, c)| *v = (*v - c) / temperature);
            let sum = log_sum_exp(row.iter().copied());
            row.iter_mut().for_each(|v| *v = (*v - sum).exp());
        }
        store(values, (rows, width), logits_of_teacher)
    }

    /// Moves the center to the mean of these logits, by `1 − momentum`; no rows change nothing.
    ///
    /// # Errors
    /// If the width differs or a logit is not finite.
    pub fn update(&mut self, logits_of_teacher: &Tensor) -> Result<()> {
        let (values, rows, width) = self.read(logits_of_teacher)?;
        if rows == 0 {
            return Ok(());
        }
        for (k, center) in self.center.iter_mut().enumerate() {
            let sum: f64 = values.iter().skip(k).step_by(width).sum();
            *center = self.momentum * *center + (1.0 - self.momentum) * sum / rows as f64;
        }
        Ok(())
    }

    fn read(&self, tensor: &Tensor) -> Result<(Vec<f64>, usize, usize)> {
        let (values, rows, width) = logits(CENTERING, tensor)?;
        if width == self.center.len() {
            return Ok((values, rows, width));
        }
        let expected = format!("[N, {}]", self.center.len());
        Err(LossError::shape(CENTERING, "logits", expected, tensor.dims()).into())
    }
}

/// Distributions over prototypes in which each prototype gets about the same share of all rows.
///
/// `exp(logits/τ)` is scaled in turn so that prototypes, then rows have equal sums, `iterations` times;
/// rows add up to 1. In logarithms and f64, so that neither large logits nor a small τ make it 0 or
/// infinite. No rows give no rows. Without gradient, in f32, or f64 if the logits are.
///
/// # Shapes
/// `logits`: `[N, K]` · returns `[N, K]`
///
/// # Errors
/// If a logit is not finite, or `temperature` is not a finite number above 0.
///
/// # Source
/// Sinkhorn–Knopp as in SwAV (arXiv:2006.09882) and DINOv2; three iterations are usual.
pub fn sinkhorn_knopp(
    logits_of_teacher: &Tensor,
    temperature: f64,
    iterations: usize,
) -> Result<Tensor> {
    check_positive(SINKHORN, "temperature", temperature)?;
    let (mut values, rows, width) = logits(SINKHORN, logits_of_teacher)?;
    values.iter_mut().for_each(|v| *v /= temperature);
    for _ in 0..iterations {
        normalize_columns(&mut values, width);
        normalize_rows(&mut values, width);
    }
    normalize_rows(&mut values, width);
    values.iter_mut().for_each(|v| *v = v.exp());
    store(values, (rows, width), logits_of_teacher)
}

/// Row by row, since a walk down each column would read the whole table once for each of them.
fn normalize_columns(logs: &mut [f64], width: usize) {
    let width = width.max(1);
    let mut largest = vec![f64::NEG_INFINITY; width];
    for row in logs.chunks_exact(width) {
        largest.iter_mut().zip(row).for_each(|(m, v)| *m = m.max(*v));
    }
    let mut sums = vec![0.0; width];
    for row in logs.chunks_exact(width) {
        let terms = row.iter().zip(&largest).map(|(v, m)| (v - m).exp());
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    let sums: Vec<f64> = sums.iter().zip(&largest).map(|(sum, m)| m + sum.ln()).collect();
    for row in logs.chunks_exact_mut(width) {
        row.iter_mut().zip(&sums).for_each(|(v, sum)| *v -= sum);
    }
}

fn normalize_rows(logs: &mut [f64], width: usize) {
    for row in logs.chunks_exact_mut(width.max(1)) {
        let sum = log_sum_exp(row.iter().copied());
        row.iter_mut().for_each(|v| *v -= sum);
    }
}

fn store(values: Vec<f64>, shape: (usize, usize), like: &Tensor) -> Result<Tensor> {
    let dtype = if like.dtype() == DType::F64 { DType::F64 } else { DType::F32 };
    Tensor::from_vec(values, shape, like.device())?.to_dtype(dtype)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    fn table(values: &[f64], width: usize) -> Tensor {
        Tensor::from_vec(values.to_vec(), (values.len() / width, width), &Device::Cpu).unwrap()
    }

    #[test]
    fn centering_is_the_softmax_of_what_is_left() {
        let mut centering = Centering::new(2, 0.75);
        let logits = table(&[4.0, 0.0, 0.0, 0.0], 2);
        centering.update(&logits).unwrap();
        assert_eq!(centering.center, [0.5, 0.0]);
        let got = centering.targets(&logits, 0.5).unwrap().to_vec2::<f64>().unwrap();
        let want = |z: f64| 1.0 / (1.0 + (-z).exp());
        assert!((got[0][0] - want(7.0)).abs() < 1e-15 && (got[1][0] - want(-1.0)).abs() < 1e-15);
        centering.update(&table(&[], 2).reshape((0, 2)).unwrap()).unwrap();
        assert_eq!(centering.center, [0.5, 0.0]);
        assert!(centering.update(&table(&[1.0, 2.0, 3.0], 3)).is_err());
        let error = centering.targets(&table(&[0.0, f64::NAN], 2), 1.0).unwrap_err().to_string();
        assert!(error.contains("logits[0, 1] is NaN"), "{error}");
    }

    #[test]
    fn sinkhorn_spreads_what_one_prototype_would_take() {
        // All rows prefer the first prototype, by 10, 8, 6, 4 at τ = 0.5; equal shares take 7 off each.
        let logits = table(&[5.0, 0.0, 4.0, 0.0, 3.0, 0.0, 2.0, 0.0], 2);
        let got = sinkhorn_knopp(&logits, 0.5, 50).unwrap().to_vec2::<f64>().unwrap();
        for (row, z) in got.iter().zip([3.0, 1.0, -1.0, -3.0]) {
            let want = 1.0 / (1.0 + f64::exp(-z));
            assert!((row[0] - want).abs() < 1e-12 && (row[0] + row[1] - 1.0).abs() < 1e-12);
        }
        // Three iterations are on the way: the first prototype still lacks some of its half.
        let soon = sinkhorn_knopp(&logits, 0.5, 3).unwrap().to_vec2::<f64>().unwrap();
        let share: f64 = soon.iter().map(|row| row[0]).sum();
        assert!((share - 1.786_211_106_450_65).abs() < 1e-12, "{share}");
        // No iteration is the softmax.
        let plain = sinkhorn_knopp(&logits, 1.0, 0).unwrap().to_vec2::<f64>().unwrap();
        assert!((plain[3][0] - 1.0 / (1.0 + (-2f64).exp())).abs() < 1e-15);
    }

    #[test]
    fn sinkhorn_of_hard_input() {
        let none = table(&[], 3).reshape((0, 3)).unwrap();
        assert_eq!(sinkhorn_knopp(&none, 0.1, 3).unwrap().dims(), [0, 3]);
        // One row: equal shares of it, whatever it says. Two equal rows: the same.
        for rows in [1, 2] {
            let values = [1e6, -1e6, 0.0].repeat(rows);
            let got = sinkhorn_knopp(&table(&values, 3), 1e-3, 3).unwrap();
            for row in got.to_vec2::<f64>().unwrap() {
                assert!(row.iter().all(|p| (p - 1.0 / 3.0).abs() < 1e-6), "{row:?}");
            }
        }
        assert!(sinkhorn_knopp(&table(&[1.0], 1), 0.0, 3).is_err());
        assert!(sinkhorn_knopp(&table(&[f64::INFINITY], 1), 1.0, 3).is_err());
    }
}

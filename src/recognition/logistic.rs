//! Logistic regression by Newton's method.

use crate::cholesky;
use serde::{Deserialize, Serialize};

/// Steps; the loss is convex, and after a few nothing moves.
const STEPS: usize = 20;

/// What the square of each weight of a standardized input costs.
const PENALTY: f64 = 1e-3;

/// Log odds that are a sum over the inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Logistic {
    factors: Vec<f64>,
    bias: f64,
}

impl Logistic {
    /// Even odds.
    pub(super) fn zero(width: usize) -> Self {
        Self { factors: vec![0.0; width], bias: 0.0 }
    }

    pub(super) fn width(&self) -> usize {
        self.factors.len()
    }

    /// Of one input, in a fixed order: the same bits everywhere.
    pub(super) fn log_odds(&self, inputs: impl Iterator<Item = f64>) -> f64 {
        self.factors.iter().zip(inputs).fold(self.bias, |sum, (f, x)| sum + f * x)
    }

    /// Fits inputs, whether it is so, and what each counts for (1 together).
    pub(super) fn fit(examples: &[(Vec<f64>, bool, f64)]) -> Self {
        let width = examples[0].0.len();
        let total: f64 = examples.iter().map(|e| e.2).sum();
        let over = |of: &dyn Fn(&[f64], usize) -> f64| -> Vec<f64> {
            let sum = |i| examples.iter().map(|(x, _, w)| w * of(x, i)).sum::<f64>() / total;
            (0..width).map(sum).collect()
        };
        let mean = over(&|x, i| x[i]);
        let spread: Vec<f64> =
            over(&|x, i| (x[i] - mean[i]).powi(2)).iter().map(|v| v.sqrt().max(1e-9)).collect();
        // The last is the bias.
        let mut weights = vec![0.0; width + 1];
        let mut input = vec![1.0; width + 1];
        for _ in 0..STEPS {
            let mut gradient: Vec<f64> = weights.iter().map(|w| PENALTY * w).collect();
            let mut curvature = vec![0.0; (width + 1) * (width + 1)];
            gradient[width] = 0.0;
            for (i, row) in curvature.chunks_exact_mut(width + 1).enumerate() {
                row[i] = if i < width { PENALTY } else { 1e-9 };
            }
            for (x, is_so, weight) in examples {
                for i in 0..width {
                    input[i] = (x[i] - mean[i]) / spread[i];
                }
                let odds: f64 = input.iter().zip(&weights).map(|(x, w)| x * w).sum();
                let p = 1.0 / (1.0 + (-odds.clamp(-30.0, 30.0)).exp());
                let (off, bend) =
                    (weight * (p - f64::from(u8::from(*is_so))), weight * p * (1.0 - p));
                for i in 0..=width {
                    gradient[i] += off * input[i];
                    let scaled = bend * input[i];
                    let row = &mut curvature[i * (width + 1)..][..=i];
                    row.iter_mut().zip(&input).for_each(|(c, x)| *c += scaled * x);
                }
            }
            let step = solved(&curvature, &gradient);
            weights.iter_mut().zip(step).for_each(|(w, s)| *w -= s);
        }
        let factors: Vec<f64> = weights.iter().zip(&spread).map(|(w, s)| w / s).collect();
        let shift: f64 = factors.iter().zip(&mean).map(|(f, m)| f * m).sum();
        Self { factors, bias: weights[width] - shift }
    }
}

/// Solves A·x = b for a positive definite A, of which the lower half is given.
fn solved(a: &[f64], b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let a = cholesky::factor(a, n);
    let mut x = b.to_vec();
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| a[i * n + k] * x[k]).sum();
        x[i] = (x[i] - dot) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| a[k * n + i] * x[k]).sum();
        x[i] = (x[i] - dot) / a[i * n + i];
    }
    x
}

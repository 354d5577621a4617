//! Stochastic depth.

use crate::{Mode, ops};
use candle_core::{Result, Tensor};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Drops a branch for each *row* with probability `rate` and scales the rest by `1 / (1 − rate)`.
///
/// Per row, not per scene: that is how the original behaves on rows that are points.
#[derive(Debug, Clone, Copy)]
pub struct DropPath {
    /// In `0..1`.
    pub rate: f64,
}

impl DropPath {
    /// The branch, with dropped rows, plus the rows that skip it. `[N, C]`; nothing is dropped in
    /// evaluation or at rate 0.
    ///
    /// # Errors
    /// If candle fails.
    pub fn forward_residual(
        self,
        x: &Tensor,
        residual: &Tensor,
        mode: Mode,
        rng: &mut ChaCha8Rng,
    ) -> Result<Tensor> {
        if mode == Mode::Eval || self.rate <= 0.0 {
            return ops::add_scaled_rows(x, None, residual);
        }
        let keep = 1.0 - self.rate;
        let n = x.dim(0)?;
        let factor = (1.0 / keep) as f32;
        let mask: Vec<f32> =
            (0..n).map(|_| if rng.random::<f64>() < keep { factor } else { 0.0 }).collect();
        ops::add_scaled_rows(x, Some(Arc::new(mask)), residual)
    }

    /// Takes the random numbers that `n` rows take in training.
    pub(crate) fn skip(self, n: usize, rng: &mut ChaCha8Rng) {
        if self.rate > 0.0 {
            (0..n).for_each(|_| _ = rng.random::<f64>());
        }
    }
}

//! Stochastic depth.

use crate::Mode;
use candle_core::{Result, Tensor};
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Drops a branch for each *row* with probability `rate` and scales the rest by `1 / (1 − rate)`.
///
/// Per row, not per scene: that is how the original behaves on rows that are points.
#[derive(Debug, Clone, Copy)]
pub struct DropPath {
    /// In `0..1`.
    pub rate: f64,
}

impl DropPath {
    /// `[N, C] → [N, C]`; the identity in evaluation or at rate 0.
    ///
    /// # Errors
    /// If candle fails.
    pub fn forward(self, x: &Tensor, mode: Mode, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        if mode == Mode::Eval || self.rate <= 0.0 {
            return Ok(x.clone());
        }
        let keep = 1.0 - self.rate;
        let n = x.dim(0)?;
        let factor = (1.0 / keep) as f32;
        let mask: Vec<f32> =
            (0..n).map(|_| if rng.random::<f64>() < keep { factor } else { 0.0 }).collect();
        x.broadcast_mul(&Tensor::from_vec(mask, (n, 1), x.device())?)
    }
}

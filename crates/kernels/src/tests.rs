//! What the unit tests share.

use crate::gemm::bf16::{round, widen};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Values in −1..1.
pub(crate) fn random(len: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// Each value rounded to bf16.
pub(crate) fn rounded(values: &[f32]) -> Vec<f32> {
    values.iter().map(|x| widen(round(*x))).collect()
}

/// Largest difference; NaN if one is.
pub(crate) fn max_error(got: &[f32], want: &[f64]) -> f64 {
    assert_eq!(got.len(), want.len());
    let errors = got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).abs());
    errors.fold(0.0, |m: f64, e| if e.is_nan() { e } else { m.max(e) })
}

/// Runs on a pool of so many threads.
pub(crate) fn on_threads<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run)
}

//! Inputs and comparisons.

use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;

/// Numbers of rows that every kernel is tested with.
pub const ROWS: [usize; 7] = [0, 1, 2, 1023, 1024, 1025, 4321];

pub fn random(len: usize, seed: u64) -> Vec<f32> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// A permutation.
pub fn shuffled(n: usize, seed: u64) -> Vec<u32> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<u32> = (0..n as u32).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order
}

/// Equal bits, but for NaN.
pub fn assert_same(got: &[f32], want: &[f32], what: &str) {
    assert_eq!(got.len(), want.len(), "{what}: length");
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        let same = g.to_bits() == w.to_bits() || g.is_nan() && w.is_nan();
        assert!(same, "{what}: value {i} is {g}, {w} expected");
    }
}

/// Within `bound` of the expected value, absolute below 1 and relative above; NaN and infinities where they
/// are expected.
pub fn assert_near(got: &[f32], want: &[f32], bound: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}: length");
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        let error = (f64::from(*g) - f64::from(*w)).abs();
        let near = error <= bound * f64::from(w.abs()).max(1.0);
        let same = g == w || g.is_nan() && w.is_nan();
        assert!(near || same, "{what}: value {i} is {g}, {w} expected");
    }
}

/// Downloads f32 values.
pub fn values<L: Launcher>(l: &L, buffer: &L::Buffer, len: usize) -> Result<Vec<f32>, L::Error> {
    l.download_values(buffer, len)
}

/// Makes tests of functions that run kernels; they need a grid.
macro_rules! on_grid {
    ($($test:ident)*) => {
        mod tests {
            $(#[test]
            fn $test() {
                if crate::is_there() {
                    super::$test();
                }
            })*
        }
    };
}
pub(crate) use on_grid;

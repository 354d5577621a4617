//! Every kernel on the emulated grid, against the CPU kernels.
#![allow(clippy::unwrap_used, missing_docs)]

mod faults;
mod grid_sample;
mod labels;
mod norms;
mod patch_attention;
mod rasterize;
mod rows;
mod segment;
mod serialization;
mod sparse_conv;

use rand::{Rng, SeedableRng};
use scenesplat_device::Launcher;
use scenesplat_device::emulator::{self, Emulator, EmulatorError};

/// Numbers of rows that every kernel is tested with.
const ROWS: [usize; 7] = [0, 1, 2, 1023, 1024, 1025, 4321];

/// Runs operations with threads and blocks in order and in two shuffled orders; the bits must be equal.
fn in_any_order<T: PartialEq + std::fmt::Debug>(
    run: impl Fn(&Emulator) -> Result<T, EmulatorError>,
) -> T {
    let first = run(&Emulator::new(0)).unwrap();
    for seed in [1, 0x5eed] {
        let other = run(&Emulator::new(seed)).unwrap();
        assert!(first == other, "another schedule of threads gives another result");
    }
    first
}

/// As [`in_any_order`] for values in f32, of which NaN equals itself.
fn bits_in_any_order(run: impl Fn(&Emulator) -> Result<Vec<f32>, EmulatorError>) -> Vec<f32> {
    let bits = in_any_order(|l| Ok(run(l)?.iter().map(|v| v.to_bits()).collect::<Vec<_>>()));
    bits.into_iter().map(f32::from_bits).collect()
}

fn random(len: usize, seed: u64) -> Vec<f32> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// A permutation.
fn shuffled(n: usize, seed: u64) -> Vec<u32> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut order: Vec<u32> = (0..n as u32).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order
}

/// Equal bits, but for NaN.
fn assert_same(got: &[f32], want: &[f32], what: &str) {
    assert_eq!(got.len(), want.len(), "{what}: length");
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        let same = g.to_bits() == w.to_bits() || g.is_nan() && w.is_nan();
        assert!(same, "{what}: value {i} is {g}, {w} expected");
    }
}

/// Within `bound` of the expected value, absolute below 1 and relative above; NaN and infinities where they
/// are expected.
fn assert_near(got: &[f32], want: &[f32], bound: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}: length");
    for (i, (g, w)) in got.iter().zip(want).enumerate() {
        let error = (f64::from(*g) - f64::from(*w)).abs();
        let near = error <= bound * f64::from(w.abs()).max(1.0);
        let same = g == w || g.is_nan() && w.is_nan();
        assert!(near || same, "{what}: value {i} is {g}, {w} expected");
    }
}

/// Downloads f32 values.
fn values(l: &Emulator, buffer: &emulator::Buffer, len: usize) -> Result<Vec<f32>, EmulatorError> {
    l.download_values(buffer, len)
}

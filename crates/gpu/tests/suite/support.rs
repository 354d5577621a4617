//! The device of all tests, random values, and comparisons.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_gpu::ops::{Rows, Stored};
use scenesplat_gpu::{Choice, Gpu};
use std::sync::OnceLock;

/// The device; `None` says why on the terminal, which CI takes for a failure.
pub fn gpu() -> Option<Gpu> {
    static GPU: OnceLock<Result<Gpu, String>> = OnceLock::new();
    let open = || match Gpu::open(&Choice::Best) {
        Ok(gpu) => {
            println!("graphics processor: {}, {}", gpu.info(), gpu.info().driver);
            Ok(gpu)
        }
        Err(error) => Err(error.to_string()),
    };
    match GPU.get_or_init(open) {
        Ok(gpu) => Some(gpu.clone()),
        Err(error) => {
            println!("skipped: {error}");
            None
        }
    }
}

/// The sizes of numbers that the device can store, each with the relative error that its rounding makes.
pub fn stored(gpu: &Gpu) -> Vec<(Stored, f64)> {
    let mut all = vec![(Stored::F32, 1e-6)];
    if gpu.has_f16() {
        all.push((Stored::F16, 1e-3));
    }
    all
}

/// Values in −1..1 that a 16-bit number holds exactly, so that both sizes have the same input.
pub fn random(len: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| half::f16::from_f32(rng.random_range(-1.0..1.0)).to_f32()).collect()
}

/// Rows on the device.
pub fn rows(gpu: &Gpu, values: &[f32], channels: usize, stored: Stored) -> Rows {
    Rows::upload(gpu, values, channels, stored).unwrap()
}

/// Values of rows.
pub fn values(gpu: &Gpu, rows: &Rows) -> Vec<f32> {
    rows.read(&mut gpu.commands()).unwrap()
}

/// Checks every value against f64: the error is at most `limit` of the largest value.
pub fn close(what: &str, got: &[f32], want: &[f64], limit: f64) {
    assert_eq!(got.len(), want.len(), "{what}: length");
    let largest = want.iter().fold(1.0, |m: f64, w| m.max(w.abs()));
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        let error = (f64::from(*got) - want).abs() / largest;
        assert!(error <= limit, "{what}: value {i} is {got}, not {want} (error {error:e})");
    }
}

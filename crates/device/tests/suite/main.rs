//! Every kernel on the emulated grid, against the CPU kernels; and whether every text compiles for graphics processors.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

mod faults;
mod grid_sample;
mod labels;
mod norms;
#[cfg(feature = "cuda")]
mod nvrtc;
mod patch_attention;
mod rasterize;
mod rows;
mod segment;
mod serialization;
mod sparse_conv;

#[path = "../support/mod.rs"]
mod support;

use scenesplat_device::emulator::{self, Emulator, EmulatorError};
use support::{ROWS, assert_near, assert_same, random, shuffled, values};

use emulator::{Buffer, is_there};
use {Emulator as Grid, EmulatorError as GridError};

/// Threads and blocks in one order of many.
fn grid(seed: u64) -> &'static Emulator {
    Box::leak(Box::new(Emulator::new(seed)))
}

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

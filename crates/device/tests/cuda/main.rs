//! Every kernel on a graphics processor, against the CPU kernels: the comparisons of the emulation, which run where
//! `SCENESPLAT_TEST_DEVICE` is `cuda`.
#![cfg(feature = "cuda")]
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

#[path = "../emulation/grid_sample.rs"]
mod grid_sample;
#[path = "../emulation/labels.rs"]
mod labels;
#[path = "../emulation/norms.rs"]
mod norms;
#[path = "../emulation/patch_attention.rs"]
mod patch_attention;
#[path = "../emulation/rasterize.rs"]
mod rasterize;
#[path = "../emulation/rows.rs"]
mod rows;
#[path = "../emulation/segment.rs"]
mod segment;
#[path = "../emulation/serialization.rs"]
mod serialization;
#[path = "../emulation/sparse_conv.rs"]
mod sparse_conv;
#[path = "../support/mod.rs"]
mod support;

use cudarc::driver::CudaContext;
use scenesplat_device::cuda::{CudaBuffer as Buffer, CudaError as GridError, CudaLauncher as Grid};
use scenesplat_device::nvrtc::Cache;
use std::sync::OnceLock;
use support::{ROWS, assert_near, assert_same, random, shuffled, values};

/// The processor; kernels are loaded once.
fn grid(_order: u64) -> &'static Grid {
    static OPENED: OnceLock<Grid> = OnceLock::new();
    OPENED.get_or_init(|| {
        let context = CudaContext::new(0).unwrap();
        Grid::new(context.default_stream(), Cache::of_user()).unwrap()
    })
}

/// Whether the tests shall run on it.
fn is_there() -> bool {
    let named = std::env::var("SCENESPLAT_TEST_DEVICE").is_ok_and(|name| name.starts_with("cuda"));
    if !named {
        println!("not run: SCENESPLAT_TEST_DEVICE is not cuda");
    }
    named
}

/// Runs operations three times; the bits must be equal.
fn in_any_order<T: PartialEq + std::fmt::Debug>(run: impl Fn(&Grid) -> Result<T, GridError>) -> T {
    let first = run(grid(0)).unwrap();
    for _ in 0..2 {
        let other = run(grid(0)).unwrap();
        assert!(first == other, "another run gives another result");
    }
    first
}

/// As [`in_any_order`] for values in f32, of which NaN equals itself.
fn bits_in_any_order(run: impl Fn(&Grid) -> Result<Vec<f32>, GridError>) -> Vec<f32> {
    let bits = in_any_order(|l| Ok(run(l)?.iter().map(|v| v.to_bits()).collect::<Vec<_>>()));
    bits.into_iter().map(f32::from_bits).collect()
}

//! Every kernel on a graphics processor, against the CPU kernels: the comparisons of the suite, which run where
//! `SCENESPLAT_TEST_DEVICE` is `cuda`. A program of its own: the suite's modules run on one kind of grid.
#![cfg(feature = "cuda")]
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

#[path = "../suite/grid_sample.rs"]
mod grid_sample;
#[path = "../suite/labels.rs"]
mod labels;
#[path = "../suite/norms.rs"]
mod norms;
#[path = "../suite/patch_attention.rs"]
mod patch_attention;
#[path = "../suite/rasterize.rs"]
mod rasterize;
#[path = "../suite/rows.rs"]
mod rows;
#[path = "../suite/segment.rs"]
mod segment;
#[path = "../suite/serialization.rs"]
mod serialization;
#[path = "../suite/sparse_conv.rs"]
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

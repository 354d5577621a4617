//! Kernels on a graphics processor (in CI a software one) against formulas in f64 and the CPU's kernels.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod attention;
mod cloud;
mod clouds;
mod curves;
mod grid_sample;
mod kernel_map;
mod norms;
mod pooling;
mod products;
mod radix_sort;
mod scan;
mod support;
mod translation;

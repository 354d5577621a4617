//! Grid sampling and neighbors against slow versions, and arguments that contradict each other.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod grid_sample;
mod neighbors;
mod soundness;

//! Networks, their operations and their files.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod candle_kernels;
mod golden;
mod gpu;
mod gradients;
mod networks;
mod support;
mod weights;

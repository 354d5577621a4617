//! Networks and their operations, but for goldens, gradients and weights; one program, for linking takes longer than compiling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../support/device.rs"]
mod support_device;
#[path = "../support/emulated.rs"]
mod support_emulated;

mod determinism;
mod emulated;
mod litept;
mod lpips;
mod point_networks;
mod precision;
mod rasterize;
mod recompute;
mod shortcuts;

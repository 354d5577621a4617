//! The gradient of every operation, layer and module against central differences.
//!
//! The networks compute in f32, where differences drown in rounding. So each part has a second,
//! slow version here in f64, from its formula: the part's output must agree with it, and the part's
//! gradient with the differences of it, for every element of the inputs and of all parameters.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../support/device.rs"]
mod support_device;
#[path = "../support/emulated.rs"]
mod support_emulated;

mod check;
mod emulated;
mod layers;
mod modules;
mod ops;
mod slow;

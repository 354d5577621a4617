//! Agreement with numbers that the original implementation computed.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../support/device.rs"]
mod support_device;
#[path = "../support/emulated.rs"]
mod support_emulated;

#[path = "../support/mod.rs"]
mod support;

mod convolution;
mod emulated;
mod full_size;
mod modules;
mod padding;
mod serialization;
mod tiny_networks;

//! Agreement with numbers that the original losses computed: values, gradients and hard cases.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../../../models/tests/support/mod.rs"]
#[allow(dead_code, reason = "the networks' tests use the rest")]
mod support;
#[path = "../../../models/tests/support/device.rs"]
mod support_device;

mod classes;
mod features;
mod self_supervised;

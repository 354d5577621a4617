//! The forward pass against golden files, hostile input and itself.
#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]
#![allow(clippy::panic, reason = "as above")]

#[path = "../support/mod.rs"]
mod support;

mod goldens;
mod hazards;
mod properties;
mod reference;
mod scenes;

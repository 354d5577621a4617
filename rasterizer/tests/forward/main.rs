//! The forward pass against golden files, hostile input and itself.
#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

#[path = "../support/mod.rs"]
mod support;

mod goldens;

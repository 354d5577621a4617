//! Gradients against goldens, an f64 reference and central differences.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

#[path = "../support/mod.rs"]
mod support;

mod edges;
mod goldens;
mod reference;
mod small_scene;
mod workspace;

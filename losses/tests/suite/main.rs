//! The losses: reference numbers, gradients, hard input, objectives.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod cases;
mod support;

mod golden;
mod gradients;
mod hard_input;
mod objective;
mod self_supervised;

//! Metrics of labels, votes and pictures; one program, for linking takes longer than compiling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

#[path = "../support/mod.rs"]
mod support;

mod confusion;
mod image;
mod image_frames;
mod oracle;
mod votes;
mod zero_shot;

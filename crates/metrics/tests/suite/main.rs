//! Tests of the public interface: reference numbers, labels, votes and images.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod confusion;
mod golden;
mod image;
mod image_frames;
mod oracle;
mod reference;
mod support;
mod votes;
mod zero_shot;

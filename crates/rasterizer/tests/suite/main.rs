//! Rendering, gradients, lifting and plans against goldens, f64 references and hostile input.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set itself up should stop"
)]

mod backward;
mod forward;
mod lifting;
mod plan;
mod soundness;
mod support;

//! LitePT against its formulas in f64: outputs, gradients, names and numbers of parameters.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::missing_panics_doc,
    reason = "a test may fail loudly"
)]

mod behaviour;
pub mod numerics;
mod published;
mod reference;
mod scenes;

//! Experiments from files, and pages in a browser's terms.
#![recursion_limit = "256"]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

mod augmentation;
mod distillation;
mod measured;
mod models;
mod page;
mod paper;
mod runs;
mod settings;

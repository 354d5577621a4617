//! Against reference numbers, and against f64 by hand.
#![allow(clippy::unwrap_used, reason = "a test that cannot set itself up should stop")]

mod adam;
mod losses;
mod objects;
mod pieces;
mod settings;
mod support;
mod training;
mod transparent;

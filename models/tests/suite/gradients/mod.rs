//! The gradient of every operation, layer and module against central differences.
//!
//! The networks compute in f32, where differences drown in rounding. So each part has a second,
//! slow version here in f64, from its formula: the part's output must agree with it, and the part's
//! gradient with the differences of it, for every element of the inputs and of all parameters.

mod check;
mod emulated;
mod layers;
mod modules;
mod ops;
pub mod slow;

//! LitePT against its formulas in f64: outputs, gradients, names and numbers of parameters.

mod behaviour;
pub mod numerics;
mod published;
pub mod reference;
pub mod scenes;

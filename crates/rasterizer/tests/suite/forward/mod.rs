//! The forward pass against golden files, the f64 reference, hostile input and itself.

mod goldens;
mod hazards;
mod properties;
mod reference;

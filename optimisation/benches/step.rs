//! Parts of a training step.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]
fn main() {}

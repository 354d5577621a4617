//! Benchmarks of the losses.
fn main() {}

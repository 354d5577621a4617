//! The crate `cudarc` under its own name, loading CUDA's libraries while the program runs: see `Cargo.toml`.
pub use real::*;

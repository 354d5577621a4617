//! The crate `float8` in another version under its own name: see `Cargo.toml`.
pub use real::*;

//! The library for a browser: bytes of a scene file in, labels, objects, phrases and files out, with the network that comes
//! with the program.
//!
//! [`Engine`] is what a page asks; it is plain Rust and works anywhere. For `wasm32` its functions are exported as numbers and
//! addresses (`exports.rs`), and `page/src/app/engine.ts` is their other side. No threads, no files, no requests.

mod engine;
#[cfg(target_family = "wasm")]
mod exports;
mod labelling;
mod remarks;

pub use engine::{Engine, EngineError, MOST_GAUSSIANS};
pub use labelling::{Labelled, Stage};

//! Networks in ONNX files, run by ONNX Runtime: a library that is loaded when it is asked for, never linked or fetched.
//!
//! [`OnnxClicks`] answers clicks for the [mask generator](crate::masks), [`OnnxEncoder`] makes vectors of pictures. What such
//! a file computes is its own matter: names, shapes and types of its inputs and outputs are checked, and what does not
//! fit is refused by name. That results are the same bits for any number of threads is not promised for them.

mod clicks;
mod encoder;
mod model;
mod runtime;
#[cfg(test)]
mod tests;

pub use clicks::{OnnxClicks, OnnxSeen};
pub use encoder::OnnxEncoder;
pub use runtime::OnnxRuntime;

//! SigLIP and SigLIP 2 of fixed resolution: pictures and texts as vectors that can be compared.

mod config;
mod image;
#[cfg(test)]
mod tests;
mod text;
mod tower;

#[cfg(feature = "onnx")]
pub(crate) use config::Preprocessor;
pub use image::{Resizing, SiglipImageEncoder};
pub use text::SiglipTextEncoder;

const HELP: &str =
    "give the folder of a SigLIP or SigLIP 2 model of fixed resolution, with its weights whole";

/// Whether a tensor belongs to texts alone.
fn is_text(name: &str) -> bool {
    name.starts_with("text_model.") || name.starts_with("logit_")
}

/// Whether a tensor belongs to pictures alone.
fn is_vision(name: &str) -> bool {
    name.starts_with("vision_model.")
}

//! What a network is trained for: a model, its losses, and where the targets come from.

mod input;
mod language_pretraining;
mod semantic_segmentation;

pub use input::{bad_values, point_cloud};
pub use language_pretraining::{LanguagePretraining, TargetSource};
pub use semantic_segmentation::SemanticSegmentation;

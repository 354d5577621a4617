//! What a network is trained for: a [`TrainingTask`] says what a batch asks of it; network and losses
//! are those of a [`Learner`], and both together are a [`TaskModule`].

pub mod autoencoder;
mod distillation;
mod input;
mod language_pretraining;
mod learner;
pub mod self_supervised;
mod semantic_segmentation;
mod task_module;

pub use distillation::Distillation;
pub use input::{bad_values, point_cloud};
pub use language_pretraining::{LanguagePretraining, TargetSource};
pub use learner::{Learner, RowTargets};
pub use semantic_segmentation::SemanticSegmentation;
pub use task_module::{TaskModule, TrainingTask};

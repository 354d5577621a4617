//! Self-supervised training: a network learns from scenes without labels.

mod centers;
mod config;
mod heads;
mod matched_terms;
mod matching;
mod module;
mod reconstruct;
mod step;
mod teacher;
mod terms;

pub use config::{
    Balance, Compat, DinoTerm, Export, GaussianHeads, IbotCrossEntropyTerm, IbotTerm,
    LanguageAlignmentTerm, MaskedGaussiansTerm, Prototypes, SelfDistillationTerm,
    SelfSupervisedConfig, SimDinoRowsTerm, SimDinoTerm, TermConfig,
};
pub use module::{SelfSupervised, is_head};
pub use reconstruct::Reconstructor;

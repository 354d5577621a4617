//! Experiments from files: `scenesplat train` and what it is made of.

mod check;
mod compression;
pub mod config;
pub mod curves;
pub mod data;
mod error;
pub mod export;
pub mod furniture;
pub mod identity;
mod limited;
mod limits;
pub mod lr_search;
mod measured;
mod module;
mod record;
mod run;
pub mod sweep;
pub mod teacher;
mod trial;

pub use config::ExperimentConfig;
pub use error::ExperimentError;
pub use export::exported_checkpoint;
pub use identity::{MAY_CHANGE, identity};
pub use limits::LimitsConfig;
pub use lr_search::{LrReport, search_lr};
pub use run::{MakeConsole, RunOptions, RunReport, train, train_together, train_with};
pub use trial::{TrialReport, try_out};

/// A JSON schema of experiments' files, for editors. A test makes it of what the program takes.
pub const SCHEMA: &str = include_str!("train.schema.json");

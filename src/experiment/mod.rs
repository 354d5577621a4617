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
mod measured;
mod record;
mod run;
pub mod teacher;

pub use config::ExperimentConfig;
pub use error::ExperimentError;
pub use export::exported_checkpoint;
pub use identity::{MAY_CHANGE, identity};
pub use run::{RunOptions, RunReport, train, train_together, train_with};

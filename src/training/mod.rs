//! Training from a file: `scenesplat train` and what it is made of.

pub mod config;
pub mod curves;
pub mod data;
pub mod export;
pub mod identity;
mod record;
mod run;

pub use config::ExperimentConfig;
pub use identity::{MAY_CHANGE, identity};
pub use run::{RunOptions, RunReport, train};

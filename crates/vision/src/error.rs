//! What can go wrong with pictures and image networks.

use scenesplat_scene::{SceneError, printable};
use std::path::PathBuf;

/// Why an image network gives no answer. Every variant says where, what and how to mend it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VisionError {
    /// A file that cannot be read.
    #[error(transparent)]
    File(#[from] SceneError),
    /// A weight file that is none.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
    /// A file of a model that is not what it should be.
    #[error("{}: {problem} ({help})", printable(path))]
    Model {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What would be right.
        help: &'static str,
    },
    /// Sizes that make no network.
    #[error("{field} is {value}: {help}")]
    Config {
        /// Which setting.
        field: &'static str,
        /// Its value.
        value: String,
        /// What is possible.
        help: &'static str,
    },
    /// A picture, point or text that cannot be used.
    #[error("{what}: {problem}")]
    Input {
        /// What it is.
        what: &'static str,
        /// What is wrong with it.
        problem: String,
    },
}

impl VisionError {
    pub(crate) fn input(what: &'static str, problem: impl Into<String>) -> Self {
        Self::Input { what, problem: problem.into() }
    }

    pub(crate) fn config(
        field: &'static str,
        value: impl std::fmt::Display,
        help: &'static str,
    ) -> Self {
        Self::Config { field, value: value.to_string(), help }
    }
}

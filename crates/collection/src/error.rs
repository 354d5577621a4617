//! Errors of collecting labels.

use scenesplat_rasterizer::RasterError;
use scenesplat_rasterizer::lifting::LiftError;
use scenesplat_scene::{SceneError, printable_text};
use std::path::{Path, PathBuf};

/// Why labels could not be collected. Every variant says where, what and how to fix it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CollectError {
    /// A file or folder that cannot be used.
    #[error("{}: {} ({help})", path.display(), printable_text(problem))]
    File {
        /// Which one.
        path: PathBuf,
        /// What is wrong, with the place and the value.
        problem: String,
        /// What the user can do.
        help: String,
    },
    /// Arguments that do not fit together, or a setting out of range.
    #[error("{field}: {problem}")]
    Argument {
        /// Which argument or setting.
        field: &'static str,
        /// What is wrong, with the value.
        problem: String,
    },
    /// A segmenter or an encoder failed.
    #[error("{name} failed")]
    Model {
        /// Which one, as its `name` says.
        name: String,
        /// Why.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Features could not be fused.
    #[error(transparent)]
    Lift(#[from] LiftError),
    /// A file could not be read.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The renderer refused a view.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

impl CollectError {
    pub(crate) fn file(path: &Path, problem: impl Into<String>, help: impl Into<String>) -> Self {
        Self::File { path: path.to_owned(), problem: problem.into(), help: help.into() }
    }

    pub(crate) fn argument(field: &'static str, problem: impl Into<String>) -> Self {
        Self::Argument { field, problem: problem.into() }
    }
}

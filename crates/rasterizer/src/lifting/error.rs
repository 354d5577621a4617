//! Errors of lifting and of its input.

use crate::RasterError;
use scenesplat_scene::SceneError;
use std::path::{Path, PathBuf};

/// Why labels could not be lifted. Every variant says where, what and how to fix it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LiftError {
    /// A file of segments or features that cannot be used.
    #[error("{}: {problem} ({help})", path.display())]
    File {
        /// Which file or folder.
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
    /// The file that holds what does not fit into memory could not be made, written or read.
    #[error("{}: {action}", folder.display())]
    Spool {
        /// Where the file is.
        folder: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// A scene or an array could not be read or written.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The renderer refused a view or the Gaussians.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// The caller asked to stop.
    #[error("stopped; nothing was written")]
    Stopped,
}

impl LiftError {
    pub(crate) fn file(path: &Path, problem: impl Into<String>, help: impl Into<String>) -> Self {
        Self::File { path: path.to_owned(), problem: problem.into(), help: help.into() }
    }

    pub(crate) fn argument(field: &'static str, problem: impl Into<String>) -> Self {
        Self::Argument { field, problem: problem.into() }
    }

    pub(crate) fn spool(
        folder: &Path,
        action: &'static str,
    ) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let folder = folder.to_owned();
        move |source| Self::Spool { folder, action, source }
    }
}

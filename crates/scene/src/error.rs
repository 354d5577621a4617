//! Errors of this crate.

use crate::printable::{printable, printable_text, shown};
use std::path::{Path, PathBuf};

/// What can go wrong with a scene or its files. Every variant says where, what and how to fix it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The file could not be opened, read or written.
    #[error("{}: {action}", shown(path))]
    Io {
        /// Which file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// The file does not follow its format.
    #[error("{}: {}{}", shown(path), printable_text(problem), hint(help))]
    Format {
        /// Which file.
        path: PathBuf,
        /// What is wrong, with the element, property or offset.
        problem: String,
        /// What the user can do, may be empty.
        help: String,
    },
    /// A value that no policy can repair.
    #[error(
        "{}: element {element}, field {}: {} is not allowed{}",
        shown(path),
        printable(field),
        printable(value),
        hint(help)
    )]
    Value {
        /// Which file.
        path: PathBuf,
        /// Row in the file.
        element: usize,
        /// Which field.
        field: String,
        /// The offending value as text.
        value: String,
        /// What the user can do.
        help: String,
    },
    /// An array with the wrong number of rows.
    #[error("{field}: expected {expected} rows, got {got}")]
    RowCount {
        /// Which array.
        field: &'static str,
        /// Rows expected.
        expected: usize,
        /// Rows found.
        got: usize,
    },
    /// A row index beyond the scene.
    #[error("row {row} is out of range for a scene of {rows} Gaussians")]
    RowOutOfRange {
        /// The index.
        row: usize,
        /// Number of rows.
        rows: usize,
    },
    /// Memory for what a file holds is not to be had.
    #[error(
        "{}: {bytes} bytes of memory for it are not to be had (close other programs, or raise the limit)",
        shown(path)
    )]
    OutOfMemory {
        /// Which file.
        path: PathBuf,
        /// Bytes that were asked for.
        bytes: usize,
    },
    /// The user asked to stop; nothing was written.
    #[error("stopped; nothing was written")]
    Stopped,
    /// A list of classes, or the table of their text vectors, that cannot be used.
    #[error("{}{}", printable_text(problem), hint(help))]
    Classes {
        /// What is wrong.
        problem: String,
        /// What the user can do, may be empty.
        help: String,
    },
    /// A file or folder that could not be written.
    #[error(transparent)]
    Write(#[from] crate::WriteError),
    /// No class of that name.
    #[error("no class is called {query:?}; nearest: {}", printable(&nearest.join(", ")))]
    UnknownClass {
        /// What was asked for.
        query: String,
        /// The most similar names, best first.
        nearest: Vec<String>,
    },
    /// Several classes fit the name equally well.
    #[error("{query:?} may mean any of: {} (write the name exactly)", printable(&candidates.join(", ")))]
    AmbiguousClass {
        /// What was asked for.
        query: String,
        /// The names that fit.
        candidates: Vec<String>,
    },
}

impl SceneError {
    /// A [`SceneError::Format`] for `path`.
    pub(crate) fn format(
        path: &Path,
        problem: impl Into<String>,
        help: impl Into<String>,
    ) -> SceneError {
        SceneError::Format { path: path.to_owned(), problem: problem.into(), help: help.into() }
    }

    /// Turns an I/O error into a [`SceneError::Io`] for `path`; made for `map_err`.
    pub(crate) fn io(
        path: &Path,
        action: &'static str,
    ) -> impl FnOnce(std::io::Error) -> SceneError + use<> {
        let path = path.to_owned();
        move |source| SceneError::Io { path, action, source }
    }
}

fn hint(help: &str) -> String {
    if help.is_empty() { String::new() } else { format!(" ({})", printable_text(help)) }
}

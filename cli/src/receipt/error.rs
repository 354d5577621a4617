//! What can go wrong with a receipt.

use scenesplat::scene::SceneError;
use std::path::PathBuf;

/// Why a receipt could not be made or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReceiptError {
    /// A file could not be read or written.
    #[error("{}: {action}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// It is no file that can be read.
    #[error(transparent)]
    Input(#[from] SceneError),
    /// The report could not be put into JSON.
    #[error("the receipt cannot be written as JSON")]
    Json(#[from] serde_json::Error),
}

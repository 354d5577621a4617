//! Why there is no page.

use super::MOST_NAMES;
use crate::inference::EncodeError;
use crate::labels::LabelError;
use crate::language_codes::CodeError;
use scenesplat_scene::WriteError;
use scenesplat_text::PhraseError;

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// There is nothing to show.
    #[error("the scene has no Gaussian with a place: there is nothing to show")]
    Empty,
    /// An array does not have one value per Gaussian.
    #[error("{field}: expected {expected} rows, one a Gaussian, got {got}")]
    Rows {
        /// Which array.
        field: &'static str,
        /// Gaussians of the scene.
        expected: usize,
        /// Rows found.
        got: usize,
    },
    /// More than the page can number.
    #[error("{count} {what}, a page holds at most {MOST_NAMES}")]
    TooMany {
        /// What there are too many of.
        what: &'static str,
        /// How many.
        count: usize,
    },
    /// The program was built with a broken file.
    #[error("the program is damaged: {0}")]
    Damaged(String),
    /// Codes cannot be made of the features.
    #[error(transparent)]
    Codes(#[from] CodeError),
    /// Features that went to a file could not be read.
    #[error(transparent)]
    Features(#[from] EncodeError),
    /// Texts of another network.
    #[error(transparent)]
    Labels(#[from] LabelError),
    /// The phrase table is broken.
    #[error(transparent)]
    Phrases(#[from] PhraseError),
    /// The page could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// No address to serve the page at.
    #[error("127.0.0.1:{port}: no page can be served there; another port (0 for any free one)")]
    Bind {
        /// The port that was asked for.
        port: u16,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// The system gives no random numbers for the address of a served page.
    #[error("the system gives no random numbers; a page is not served without a secret address")]
    Random,
    /// Browsers could not be waited for.
    #[error("browsers can no longer be waited for")]
    Accept {
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

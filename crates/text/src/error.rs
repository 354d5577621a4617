//! What can go wrong with phrases.

use scenesplat_scene::SceneError;
use std::path::PathBuf;

/// Why a phrase has no vector. Every variant says where, what, and what helps.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhraseError {
    /// A file that cannot be read.
    #[error(transparent)]
    File(#[from] SceneError),
    /// A file of the encoder's folder that is not what it should be.
    #[error("{}: {problem} ({help})", path.display())]
    Model {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What would be right.
        help: &'static str,
    },
    /// A text that says nothing.
    #[error("the phrase {text:?} {problem}")]
    Phrase {
        /// The text, shortened.
        text: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A text whose words change what its names mean in a way that has no answer here.
    #[error("{text:?} {problem}")]
    Meaning {
        /// The text, shortened.
        text: String,
        /// What it says, and what to ask instead.
        problem: String,
    },
    /// None of the words of a text is known.
    #[error(
        "none of the words of {text:?} is known: the phrase table holds {known} English words and phrases (a \
         sentence encoder reads any)"
    )]
    Unknown {
        /// The text, shortened.
        text: String,
        /// Rows of the table.
        known: usize,
    },
    /// Rows that a bridge cannot be fitted to.
    #[error("{problem}")]
    Bridge {
        /// What is wrong with them.
        problem: String,
    },
    /// A phrase table that does not hold together.
    #[error("the phrase table {problem}")]
    Table {
        /// What is wrong with it.
        problem: String,
    },
}

impl PhraseError {
    pub(crate) fn no_word(text: &str) -> Self {
        let problem = "holds no word: say what to look for, such as \"red chair\"";
        Self::Phrase { text: shortened(text), problem }
    }
}

/// A text as messages show it: of more than 60 characters the first 60.
pub fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

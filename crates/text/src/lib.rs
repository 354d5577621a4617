//! Phrases as vectors, on plain slices.
//!
//! | what | needs |
//! |---|---|
//! | [`TextEncoder`] | a folder with a BERT sentence encoder (all-MiniLM-L6-v2): reads any phrase |
//! | [`PhraseTable`] | nothing: household words and phrases as that encoder reads them, 96 numbers each |
//! | [`Bridge`] | vectors of another model for some names: guesses its vector of any phrase |
//!
//! All of it is English. What a vector is near to is a statement about words, not about any scene.

mod bridge;
mod encoder;
mod error;
mod phrases;

pub use bridge::Bridge;
pub use encoder::{Encoded, TextEncoder, Truncated};
pub use error::PhraseError;
pub use phrases::{PhraseTable, Understood, normalized};

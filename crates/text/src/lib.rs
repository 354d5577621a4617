//! Phrases as vectors, on plain slices.
//!
//! | what | needs |
//! |---|---|
//! | [`TextEncoder`] | a folder with a BERT sentence encoder (all-MiniLM-L6-v2): reads any phrase |
//! | [`PhraseTable`] | nothing: household words and phrases as that encoder reads them, 96 numbers each |
//! | [`Phrase`] | nothing: whether a phrase names what is looked for, denies it, or says where it stands |
//! | [`PhraseReader`] | the classes of synthetic rooms: the class that a phrase is nearest to, and the [`Query`] for it |
//! | [`Bridge`], [`guess`](fn@guess) | vectors of another model for some names: guesses its vector of any phrase |
//!
//! All of it is English. What a vector is near to is a statement about words, not about any scene.

mod ask;
mod bridge;
mod encoder;
mod error;
mod grammar;
mod guess;
mod phrases;
mod query;
mod reader;

pub use ask::{AskError, Asked, Known};
pub use bridge::Bridge;
pub use encoder::{Encoded, TextEncoder, Truncated};
pub use error::{PhraseError, shortened};
pub use grammar::{
    Denied, Phrase, Placed, Remaining, denial_words, foreign_names, is_other_thing, named_labels,
    place_words, purposes,
};
pub use guess::{Guess, USUAL_COSINE, guess};
pub use phrases::{PhraseTable, Understood, normalized};
pub use query::Query;
pub use reader::{ALIKE, LEAD, NearClass, PhraseReader, Reading, SURE, Verdict};

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>() as f32
}

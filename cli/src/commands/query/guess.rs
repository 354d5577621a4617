//! A phrase that a text table does not have: its vector guessed by those it has.

use crate::error::WrongUse;
use crate::session::Session;
use anyhow::Result;
use scenesplat::phrases::{PhraseError, TextEncoder, guess};
use scenesplat::query::Query;
use scenesplat::scene::TextTable;

/// Guesses the vector of a phrase; says and notes that it is a guess, and what it is near to.
pub fn guessed(
    session: &Session<'_>,
    text: &str,
    table: &TextTable,
    encoder: &TextEncoder,
) -> Result<Query> {
    let guess = guess(encoder, table, text).map_err(|error| match error {
        PhraseError::Bridge { problem } => {
            anyhow::Error::from(WrongUse(format!("--text: {problem}")))
        }
        PhraseError::Phrase { .. } => WrongUse(error.to_string()).into(),
        other => other.into(),
    })?;
    let near = guess.nearest.iter().map(|(name, cosine)| format!("{name} {cosine:.2}"));
    let mut how = format!("nearest known names: {}", near.collect::<Vec<_>>().join(", "));
    if !guess.same.is_empty() {
        how += &format!(
            "; as near as the phrase itself would be, and no rivals: {}",
            guess.same.join(", ")
        );
    }
    let about = format!(
        "APPROXIMATE: {text:?} is not in --text; its vector is guessed by the {} names that are ({how})",
        table.len()
    );
    session.receipt.setting("guessed", text, &how);
    session.warn_loudly(about);
    Ok(guess.query)
}

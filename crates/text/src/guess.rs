//! Phrases for networks with a text table of another model.

use crate::{Bridge, PhraseError, Query, TextEncoder, dot};
use scenesplat_scene::TextTable;

/// Known names listed in a message.
const TOLD: usize = 5;

/// Cosine, about the middle of the table, that a guess has to the right vector: the median over 291 labels of SigLIP2,
/// each guessed by the others (`docs/text.md`).
pub const USUAL_COSINE: f32 = 0.57;

/// A query whose vector is a guess.
#[derive(Debug, Clone, PartialEq)]
pub struct Guess {
    /// What to look for.
    pub query: Query,
    /// The names of the table that are nearest to the guess, with their cosine about the middle of the table.
    pub nearest: Vec<(String, f32)>,
    /// Names at least as near to the guess as the right vector usually is: they are not rivals.
    pub same: Vec<String>,
}

/// Guesses the vector of a phrase that a text table of another model does not have, by the names that it has: a
/// [`Bridge`] from the encoder's vectors of these names to the table's.
///
/// # Errors
/// If the table has fewer than 100 rows, or the phrase cannot be encoded.
pub fn guess(encoder: &TextEncoder, table: &TextTable, text: &str) -> Result<Guess, PhraseError> {
    let names = encoder.encode(&table.names)?;
    let bridge = Bridge::fit(&names.values, names.dim, &table.values, table.dim)?;
    let vector = bridge.apply(&encoder.encode(&[text])?.values)?;
    let center = bridge.center();
    let about = |row: &[f32]| -> Vec<f32> { row.iter().zip(&center).map(|(v, c)| v - c).collect() };
    let own = about(&vector);
    let length = |row: &[f32]| dot(row, row).sqrt().max(f32::MIN_POSITIVE);
    let mut nearest: Vec<(usize, f32)> = (table.values.chunks_exact(table.dim).enumerate())
        .map(|(i, row)| {
            let row = about(row);
            (i, dot(&row, &own) / (length(&row) * length(&own)))
        })
        .collect();
    nearest.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let is_same = |i: usize| nearest.iter().any(|&(n, cosine)| n == i && cosine >= USUAL_COSINE);
    let mut rivals = TextTable { names: Vec::new(), dim: table.dim, values: Vec::new() };
    for (i, row) in table.values.chunks_exact(table.dim).enumerate().filter(|(i, _)| !is_same(*i)) {
        rivals.names.push(table.names[i].clone());
        rivals.values.extend_from_slice(row);
    }
    let query = Query::of_vector(text, vector, Some(&rivals))
        .map_err(|error| PhraseError::Bridge { problem: error.to_string() })?;
    let name = |&(i, cosine): &(usize, f32)| (table.names[i].clone(), cosine);
    let same = nearest.iter().filter(|(_, cosine)| *cosine >= USUAL_COSINE);
    let same = same.map(|&(i, _)| table.names[i].clone()).collect();
    Ok(Guess { query, nearest: nearest.iter().take(TOLD).map(name).collect(), same })
}

//! A table of household phrases as a sentence encoder reads them, small enough for a program to carry.

mod build;
mod file;
mod spelling;
mod understand;
mod words;

use crate::PhraseError;
use scenesplat_kernels::normalize::normalize_rows;
use spelling::KnownWords;
pub(crate) use spelling::distance;
use std::sync::OnceLock;
pub use understand::Understood;
pub(crate) use understand::{told, took};
pub use words::normalized;
pub(crate) use words::{bases, normalized_words};

/// The phrases of the table inside the library, one a line, sorted by bytes, as [`normalized`] gives them.
const PHRASES: &str = include_str!("../../assets/phrases.txt");
/// Their vectors; a browser's library comes without them.
#[cfg(not(target_family = "wasm"))]
const VECTORS: &[u8] = include_bytes!("../../assets/phrases.safetensors");
#[cfg(target_family = "wasm")]
const VECTORS: &[u8] = &[];

/// Numbers that are kept of a vector.
pub(crate) const KEPT: usize = 96;

/// Phrases with the vectors that a sentence encoder gives them: centered by their mean, the 96 leading principal
/// components, each row in bytes with one scale.
///
/// Vectors of [`row`](Self::row), [`understand`](Self::understand) and [`project`](Self::project) are in one space:
/// their cosine says how much alike phrases are.
#[derive(Debug)]
pub struct PhraseTable {
    /// Sorted.
    phrases: Vec<String>,
    /// `[N, KEPT]`
    rows: Vec<i8>,
    /// `[N]`
    scales: Vec<f32>,
    /// Of the encoder's vectors. `[width]`
    mean: Vec<f32>,
    /// Orthonormal. `[KEPT, width]`
    basis: Vec<f32>,
    words: KnownWords,
}

impl PhraseTable {
    /// The table inside the library: of all-MiniLM-L6-v2, see `assets/NOTICE` for where its phrases come from.
    ///
    /// # Errors
    /// If the library was built with a broken file.
    pub fn embedded() -> Result<&'static Self, PhraseError> {
        static TABLE: OnceLock<Result<PhraseTable, String>> = OnceLock::new();
        let table = TABLE.get_or_init(|| {
            let phrases = PHRASES.lines().map(str::to_owned).collect();
            Self::from_bytes(phrases, VECTORS).map_err(|error| error.to_string())
        });
        table.as_ref().map_err(|problem| PhraseError::Table { problem: problem.clone() })
    }

    /// Bytes of the table inside the library.
    pub fn embedded_bytes() -> usize {
        PHRASES.len() + VECTORS.len()
    }

    /// The phrases of the table inside the library, one a line, sorted.
    pub fn embedded_phrases() -> &'static str {
        PHRASES.trim_end()
    }

    /// Number of phrases.
    pub fn len(&self) -> usize {
        self.phrases.len()
    }

    /// Whether it holds no phrase.
    pub fn is_empty(&self) -> bool {
        self.phrases.is_empty()
    }

    /// The phrases, sorted.
    pub fn phrases(&self) -> &[String] {
        &self.phrases
    }

    /// Length of the vectors that it gives.
    pub fn dim(&self) -> usize {
        KEPT
    }

    /// Length of the vectors of its encoder.
    pub fn encoder_dim(&self) -> usize {
        self.mean.len()
    }

    /// The unit vector of a phrase that is there as it stands; forms of words count as the word ("chairs").
    pub fn row(&self, phrase: &str) -> Option<Vec<f32>> {
        let words = words::normalized_words(phrase);
        self.find(&words).map(|index| self.unit_row(index))
    }

    /// A vector of the table's encoder in the space of the table, unit length.
    ///
    /// # Errors
    /// If it has another length, or no direction there.
    pub fn project(&self, vector: &[f32]) -> Result<Vec<f32>, PhraseError> {
        if vector.len() != self.encoder_dim() {
            let (has, asked) = (vector.len(), self.encoder_dim());
            let problem =
                format!("is of an encoder with {asked} numbers a phrase, this one gives {has}");
            return Err(PhraseError::Table { problem });
        }
        let mut row: Vec<f32> = self.coordinates(vector).iter().map(|v| *v as f32).collect();
        normalize_rows(&mut row, KEPT);
        if row.iter().all(|v| *v == 0.0) || row.iter().any(|v| !v.is_finite()) {
            let problem = "has no direction for a vector that is its mean".to_owned();
            return Err(PhraseError::Table { problem });
        }
        Ok(row)
    }

    /// Coordinates of an encoder's vector. `[KEPT]`
    fn coordinates(&self, vector: &[f32]) -> Vec<f64> {
        let centred = || vector.iter().zip(&self.mean).map(|(v, m)| f64::from(*v) - f64::from(*m));
        let along = |axis: &[f32]| axis.iter().zip(centred()).map(|(a, v)| f64::from(*a) * v).sum();
        self.basis.chunks_exact(self.mean.len()).map(along).collect()
    }

    /// Where a phrase of these words is.
    fn find(&self, words: &[String]) -> Option<usize> {
        words::spellings(words).find_map(|phrase| self.phrases.binary_search(&phrase).ok())
    }

    fn unit_row(&self, index: usize) -> Vec<f32> {
        let scale = self.scales[index];
        let row = &self.rows[index * KEPT..][..KEPT];
        let mut row: Vec<f32> = row.iter().map(|v| f32::from(*v) * scale).collect();
        normalize_rows(&mut row, KEPT);
        row
    }
}

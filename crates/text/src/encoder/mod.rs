//! A sentence encoder: BERT, mean over the tokens, unit length.

mod attention;
mod config;
mod layer;
#[cfg_attr(target_family = "wasm", path = "no_tokens.rs")]
mod tokens;
mod weights;

use crate::PhraseError;
use crate::error::shortened;
use config::{Config, MODEL};
use layer::Layer;
use scenesplat_kernels::normalize::normalize_rows;
use scenesplat_kernels::{layer_norm, normalize};
use std::path::{Path, PathBuf};
use tokens::Tokens;
use weights::WeightFile;

/// Tokens that are computed at once; more phrases go through one after the other, with the same bits.
const TOKENS_AT_ONCE: usize = 4096;

/// A BERT sentence encoder, such as all-MiniLM-L6-v2: any phrase to a vector of unit length.
///
/// A phrase becomes word pieces between `[CLS]` and `[SEP]`; the encoder's last states of all of them are averaged and
/// the mean is divided by its length. Phrases are never padded: the rows of all go through the products together,
/// each attends to its own, and a phrase has the same bits alone and among others.
///
/// The padding that `tokenizer.json` of published models asks for is not used: without an attention mask it would
/// turn every vector away (median cosine to the right one 0.28) and nothing would fail.
///
/// # Source
/// `BertModel` of transformers, `Pooling` and `Normalize` of sentence-transformers.
pub struct TextEncoder {
    folder: PathBuf,
    config: Config,
    tokens: Tokens,
    /// `[vocabulary, width]`
    words: Vec<f32>,
    /// Of each position, with the first token type added. `[positions, width]`
    positions: Vec<f32>,
    norm: (Vec<f32>, Vec<f32>),
    layers: Vec<Layer>,
}

impl std::fmt::Debug for TextEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TextEncoder")
            .field("folder", &self.folder)
            .field("config", &self.config)
            .finish()
    }
}

/// What an encoder made of some phrases.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoded {
    /// Length of a vector.
    pub dim: usize,
    /// Vectors of unit length. `[N, dim]`
    pub values: Vec<f32>,
    /// Phrases of which only the beginning was read.
    pub truncated: Vec<Truncated>,
}

/// A phrase that was longer than an encoder reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Truncated {
    /// Which phrase.
    pub phrase: usize,
    /// Its tokens, with the two around it.
    pub tokens: usize,
    /// Those that were read.
    pub read: usize,
}

impl TextEncoder {
    /// Reads a folder as sentence-transformers writes it: `config.json`, `tokenizer.json`, `model.safetensors` (f32,
    /// f16 or bf16) and, where they are, `sentence_bert_config.json` and `1_Pooling/config.json`.
    ///
    /// # Errors
    /// If a file is missing or damaged, a tensor is missing, has another shape or belongs to another network, or the
    /// folder describes another kind of model; the message names file and tensor.
    pub fn open(folder: &Path) -> Result<Self, PhraseError> {
        let config = Config::read(folder)?;
        let tokens = Tokens::read(folder, &config)?;
        let mut file = WeightFile::read(&folder.join(MODEL))?;
        let width = config.hidden_size;
        let words = file.take("embeddings.word_embeddings.weight", &[config.vocab_size, width])?;
        let mut positions = file.take(
            "embeddings.position_embeddings.weight",
            &[config.max_position_embeddings, width],
        )?;
        let types =
            file.take("embeddings.token_type_embeddings.weight", &[config.type_vocab_size, width])?;
        for row in positions.chunks_exact_mut(width) {
            row.iter_mut().zip(&types).for_each(|(p, t)| *p += t);
        }
        let norm = file.norm("embeddings.LayerNorm", width)?;
        let layers = (0..config.num_hidden_layers).map(|i| Layer::take(&mut file, i, &config));
        let layers = layers.collect::<Result<_, _>>()?;
        file.finish()?;
        Ok(Self { folder: folder.to_owned(), config, tokens, words, positions, norm, layers })
    }

    /// Length of a vector.
    pub fn dim(&self) -> usize {
        self.config.hidden_size
    }

    /// The most tokens of a phrase that are read, with the two around it.
    pub fn max_tokens(&self) -> usize {
        self.tokens.most()
    }

    /// Where it was read from.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The vectors of some phrases; one that is longer than [`max_tokens`](Self::max_tokens) is read to there, and named
    /// in what is returned.
    ///
    /// # Errors
    /// If a phrase holds no word or nothing but characters that the encoder does not know, or the weights give it no
    /// direction.
    pub fn encode<S: AsRef<str>>(&self, phrases: &[S]) -> Result<Encoded, PhraseError> {
        let width = self.dim();
        let mut encoded = Encoded { dim: width, values: Vec::new(), truncated: Vec::new() };
        let mut waiting: Vec<Vec<u32>> = Vec::new();
        for (index, phrase) in phrases.iter().enumerate() {
            let ids = self.tokens.of(phrase.as_ref())?;
            if let Some(tokens) = ids.longer {
                let read = ids.ids.len();
                encoded.truncated.push(Truncated { phrase: index, tokens, read });
            }
            waiting.push(ids.ids);
            if waiting.iter().map(Vec::len).sum::<usize>() >= TOKENS_AT_ONCE {
                encoded.values.extend(self.run(&std::mem::take(&mut waiting)));
            }
        }
        encoded.values.extend(self.run(&waiting));
        for (row, phrase) in encoded.values.chunks_exact(width).zip(phrases) {
            if !(normalize::norm(row) - 1.0).abs().le(&1e-3) {
                let problem = "has no vector: the weights of the encoder give it no direction";
                return Err(PhraseError::Phrase { text: shortened(phrase.as_ref()), problem });
            }
        }
        Ok(encoded)
    }

    /// Unit rows of phrases given by their tokens.
    fn run(&self, phrases: &[Vec<u32>]) -> Vec<f32> {
        let width = self.dim();
        let lengths: Vec<usize> = phrases.iter().map(Vec::len).collect();
        let mut x = Vec::with_capacity(lengths.iter().sum::<usize>() * width);
        for ids in phrases {
            for (&id, position) in ids.iter().zip(self.positions.chunks_exact(width)) {
                let word = &self.words[id as usize * width..][..width];
                x.extend(word.iter().zip(position).map(|(w, p)| w + p));
            }
        }
        let mut normed = vec![0.0; x.len()];
        let eps = self.config.layer_norm_eps;
        layer_norm::forward(&x, None, &self.norm.0, &self.norm.1, eps, &mut normed);
        for layer in &self.layers {
            layer.forward(&mut normed, &lengths);
        }
        let mut rows = Vec::with_capacity(phrases.len() * width);
        let mut from = 0;
        for length in lengths {
            let tokens = &normed[from * width..][..length * width];
            let mean = |c: usize| {
                let sum: f64 = tokens.iter().skip(c).step_by(width).map(|v| f64::from(*v)).sum();
                (sum / length as f64) as f32
            };
            rows.extend((0..width).map(mean));
            from += length;
        }
        normalize_rows(&mut rows, width);
        rows
    }
}

//! Texts as vectors beside those of pictures.

use super::config::{Config, Tower};
use super::tower::Layers;
use super::{HELP, is_vision};
use crate::VisionError;
use crate::layers::{Linear, Norm, add, to_directions};
use crate::weights::Weights;
use scenesplat_kernels::Precision;
use scenesplat_scene::input_file::{MAX_TEXT_BYTES, read_file};
use std::path::Path;
use tokenizers::{Encoding, Tokenizer, TruncationParams};

/// Texts that go through the layers together.
const AT_ONCE: usize = 32;

/// SigLIP's text tower: any text to a vector of unit length, comparable with those of
/// [`SiglipImageEncoder`](super::SiglipImageEncoder).
///
/// A text always has as many tokens as there are positions: longer ones are cut (the tokenizer's own end stays), shorter
/// ones are filled with `<pad>`, which the others see as it was seen in training; the vector is that of the last
/// position. Texts are lower-cased first, as they were in SigLIP 2's training, unless
/// [`with_lowercase`](Self::with_lowercase) says otherwise: SceneSplat's own text tables were made without.
///
/// # Source
/// `SiglipTextModel` of transformers.
pub struct SiglipTextEncoder {
    tower: Tower,
    tokens: Tokens,
    /// `[vocabulary, width]`
    words: Vec<f32>,
    /// `[positions, width]`
    position: Vec<f32>,
    layers: Layers,
    last_norm: Norm,
    head: Linear,
    scale: f32,
    bias: f32,
}

impl std::fmt::Debug for SiglipTextEncoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SiglipTextEncoder").field("tower", &self.tower).finish_non_exhaustive()
    }
}

/// The tokenizer, with SigLIP's own padding instead of what its file declares.
struct Tokens {
    tokenizer: Tokenizer,
    pad: u32,
    length: usize,
    lowercase: bool,
}

impl Tokens {
    fn read(folder: &Path, tower: &Tower) -> Result<Self, VisionError> {
        let path = folder.join("tokenizer.json");
        let bad = |problem: String| VisionError::Model {
            path: path.clone(),
            problem,
            help: "give the tokenizer.json of the same model",
        };
        let mut tokenizer = Tokenizer::from_bytes(read_file(&path, MAX_TEXT_BYTES)?)
            .map_err(|error| bad(format!("is no tokenizer: {error}")))?;
        tokenizer.with_padding(None);
        let length = tower.max_position_embeddings;
        let truncation = TruncationParams { max_length: length, ..TruncationParams::default() };
        tokenizer.with_truncation(Some(truncation)).map_err(|error| bad(error.to_string()))?;
        let last = tokenizer.get_vocab(true).into_values().max().unwrap_or(0);
        if last as usize >= tower.vocab_size {
            let rows = tower.vocab_size;
            return Err(bad(format!(
                "has a piece number {last}, config.json names {rows} of them"
            )));
        }
        // Neither the end (1) nor any number of config.json: the vector is read at a padded position, so this changes
        // every text.
        let pad = tokenizer.token_to_id("<pad>").or_else(|| tokenizer.token_to_id("</s>"));
        let pad = pad.ok_or_else(|| bad("has no <pad>".to_owned()))?;
        Ok(Self { tokenizer, pad, length, lowercase: true })
    }

    /// The pieces of a text, at most as many as there are positions.
    fn pieces(&self, text: &str) -> Result<Encoding, VisionError> {
        let bad = |problem: String| VisionError::input("text", format!("{text:?} {problem}"));
        if text.trim().is_empty() {
            return Err(bad("says nothing".to_owned()));
        }
        let lower = self.lowercase.then(|| text.to_lowercase());
        let encoding = self.tokenizer.encode(lower.as_deref().unwrap_or(text), true);
        encoding.map_err(|e| bad(format!("cannot be cut into pieces: {e}")))
    }

    /// As many as there are positions.
    fn of(&self, text: &str) -> Result<Vec<u32>, VisionError> {
        let mut ids = self.pieces(text)?.get_ids().to_vec();
        ids.resize(self.length, self.pad);
        Ok(ids)
    }
}

impl SiglipTextEncoder {
    /// Reads the text tower of a folder: `config.json`, `tokenizer.json` and weights as `.safetensors` or `.bin`. The
    /// picture tower may be missing and is not read. The words of SigLIP 2 alone are 786 MB in memory.
    ///
    /// # Errors
    /// As [`SiglipImageEncoder::load`](super::SiglipImageEncoder::load), and if the tokenizer is none or of another model.
    pub fn load(folder: &Path, precision: Precision) -> Result<Self, VisionError> {
        let tower = Config::read(folder)?.text_config;
        let tokens = Tokens::read(folder, &tower)?;
        let mut weights = Weights::open(folder, precision, HELP)?;
        let name = |part: &str| format!("text_model.{part}");
        let width = tower.hidden_size;
        let out = tower.projection_size.unwrap_or(width);
        let encoder = Self {
            words: weights
                .take(&name("embeddings.token_embedding.weight"), &[tower.vocab_size, width])?,
            position: weights.take(
                &name("embeddings.position_embedding.weight"),
                &[tower.max_position_embeddings, width],
            )?,
            layers: Layers::take(&mut weights, &name("encoder"), &tower, precision)?,
            last_norm: weights.norm(&name("final_layer_norm"), width, tower.layer_norm_eps)?,
            head: weights.linear(&name("head"), width, out)?,
            scale: weights.take("logit_scale", &[1])?[0],
            bias: weights.take("logit_bias", &[1])?[0],
            tokens,
            tower,
        };
        weights.ignore(|name| is_vision(name) || name.ends_with("position_ids"));
        weights.finish()?;
        Ok(encoder)
    }

    /// Whether texts are lower-cased first.
    pub fn with_lowercase(mut self, lowercase: bool) -> Self {
        self.tokens.lowercase = lowercase;
        self
    }

    /// Length of a vector.
    pub fn width(&self) -> usize {
        self.head.bias.len()
    }

    /// The numbers of a text's pieces, as many as there are positions.
    ///
    /// # Errors
    /// If the text says nothing.
    pub fn token_ids(&self, text: &str) -> Result<Vec<u32>, VisionError> {
        self.tokens.of(text)
    }

    /// Whether a text has more pieces than there are positions, so that its end is not read.
    ///
    /// # Errors
    /// If the text says nothing.
    pub fn is_cut(&self, text: &str) -> Result<bool, VisionError> {
        Ok(!self.tokens.pieces(text)?.get_overflowing().is_empty())
    }

    /// How likely a picture shows a text, by the cosine of their vectors: each text for itself, not one among all.
    ///
    /// `1 / (1 + e^−(e^scale · cosine + bias))`
    pub fn probability(&self, cosine: f32) -> f32 {
        1.0 / (1.0 + (-(self.scale.exp() * cosine + self.bias)).exp())
    }

    /// The vectors of some texts, of unit length. `[texts, width]`
    ///
    /// # Errors
    /// If a text says nothing or the weights give it no direction.
    pub fn encode<S: AsRef<str>>(&self, texts: &[S]) -> Result<Vec<f32>, VisionError> {
        let ids: Vec<Vec<u32>> =
            texts.iter().map(|text| self.tokens.of(text.as_ref())).collect::<Result<_, _>>()?;
        let mut rows: Vec<f32> = ids.chunks(AT_ONCE).flat_map(|ids| self.forward(ids)).collect();
        to_directions(&mut rows, self.width()).map_err(|index| {
            let (text, problem) = (
                texts[index].as_ref(),
                "has no vector: the weights of the encoder give it no direction",
            );
            VisionError::input("text", format!("{text:?} {problem}"))
        })?;
        Ok(rows)
    }

    /// Pieces of texts → rows of any length.
    pub(super) fn forward(&self, texts: &[Vec<u32>]) -> Vec<f32> {
        let width = self.tower.hidden_size;
        let length = self.tokens.length;
        let mut x = Vec::with_capacity(texts.len() * length * width);
        for id in texts.iter().flatten() {
            x.extend(&self.words[*id as usize * width..][..width]);
        }
        x.chunks_exact_mut(self.position.len()).for_each(|x| add(x, &self.position));
        let x = self.layers.forward(x, length);
        let last: Vec<f32> = x
            .chunks_exact(length * width)
            .flat_map(|x| x[(length - 1) * width..].iter().copied())
            .collect();
        self.head.forward(&self.last_norm.forward(&last))
    }
}

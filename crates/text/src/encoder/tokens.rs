//! Word pieces of a phrase.

use super::config::Config;
use crate::PhraseError;
use crate::error::shortened;
use scenesplat_scene::input_file::{MAX_TEXT_BYTES, read_file};
use std::path::Path;
use tokenizers::Tokenizer;

/// The tokenizer, without the padding and truncation that its file declares.
pub(super) struct Tokens {
    tokenizer: Tokenizer,
    unknown: Option<u32>,
    most: usize,
}

/// The tokens of a phrase.
pub(super) struct Ids {
    /// At most as many as are read, the last one being the file's own end.
    pub ids: Vec<u32>,
    /// How many there would be, if that is more.
    pub longer: Option<usize>,
}

impl Tokens {
    pub fn read(folder: &Path, config: &Config) -> Result<Self, PhraseError> {
        let path = folder.join("tokenizer.json");
        let bad = |problem: String| PhraseError::Model {
            path: path.clone(),
            problem,
            help: "give the tokenizer.json of the same model",
        };
        let mut tokenizer = Tokenizer::from_bytes(read_file(&path, MAX_TEXT_BYTES)?)
            .map_err(|error| bad(format!("is no tokenizer: {error}")))?;
        tokenizer.with_padding(None);
        tokenizer.with_truncation(None).map_err(|error| bad(error.to_string()))?;
        let rows = config.vocab_size;
        // Numbers, not their count: there may be gaps.
        let last = tokenizer.get_vocab(true).into_values().max();
        if let Some(last) = last.filter(|last| *last as usize >= rows) {
            return Err(bad(format!(
                "has a word piece number {last}, config.json names {rows} of them"
            )));
        }
        let unknown = tokenizer.token_to_id("[UNK]");
        let tokens = Self { tokenizer, unknown, most: config.max_tokens };
        // What stands around a phrase is part of the mean.
        let around = tokens.tokenizer.encode("", true).map_err(|e| bad(e.to_string()))?;
        let names = around.get_tokens();
        if names != ["[CLS]", "[SEP]"] {
            return Err(bad(format!("puts {names:?} around a phrase, BERT has [CLS] and [SEP]")));
        }
        Ok(tokens)
    }

    /// The most tokens of a phrase.
    pub fn most(&self) -> usize {
        self.most
    }

    pub fn of(&self, phrase: &str) -> Result<Ids, PhraseError> {
        let bad = |problem| PhraseError::Phrase { text: shortened(phrase), problem };
        let encoding = self.tokenizer.encode(phrase, true);
        let encoding = encoding.map_err(|_| bad("cannot be cut into word pieces"))?;
        let mut ids = encoding.get_ids().to_vec();
        let own = &ids[1..ids.len().max(2) - 1];
        if own.is_empty() {
            return Err(bad("holds no word: say what to look for, such as \"red chair\""));
        }
        if own.iter().all(|id| Some(*id) == self.unknown) {
            return Err(bad("holds nothing that the encoder knows: it reads English words"));
        }
        let tokens = ids.len();
        let Some(&end) = ids.last().filter(|_| tokens > self.most) else {
            return Ok(Ids { ids, longer: None });
        };
        ids.truncate(self.most);
        if let Some(last) = ids.last_mut() {
            *last = end;
        }
        Ok(Ids { ids, longer: Some(tokens) })
    }
}

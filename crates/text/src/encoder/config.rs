//! What the files beside the weights say about the encoder.

use crate::PhraseError;
use scenesplat_scene::input_file::read_text_file;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// The file of the weights.
pub(super) const MODEL: &str = "model.safetensors";

/// `config.json` of a BERT model; other keys do not change what is computed.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct Config {
    pub hidden_size: usize,
    pub num_hidden_layers: usize,
    pub num_attention_heads: usize,
    pub intermediate_size: usize,
    pub hidden_act: String,
    pub layer_norm_eps: f32,
    pub vocab_size: usize,
    pub max_position_embeddings: usize,
    pub type_vocab_size: usize,
    #[serde(default = "absolute")]
    pub position_embedding_type: String,
    #[serde(default = "bert")]
    pub model_type: String,
    /// The most tokens of a phrase, of `sentence_bert_config.json`.
    #[serde(skip)]
    pub max_tokens: usize,
}

fn absolute() -> String {
    "absolute".to_owned()
}

fn bert() -> String {
    "bert".to_owned()
}

#[derive(Deserialize)]
struct Sentence {
    max_seq_length: usize,
}

#[derive(Deserialize)]
struct Pooling {
    pooling_mode_mean_tokens: bool,
    #[serde(flatten)]
    others: std::collections::BTreeMap<String, serde_json::Value>,
}

const HELP: &str =
    "give the folder of a BERT sentence encoder such as all-MiniLM-L6-v2, with its own folders";

impl Config {
    /// Reads and checks the files of a folder.
    pub fn read(folder: &Path) -> Result<Self, PhraseError> {
        let path = folder.join("config.json");
        let mut config: Self = json(&path)?;
        let bad =
            |problem: String| Err(PhraseError::Model { path: path.clone(), problem, help: HELP });
        let sizes = [
            ("hidden_size", config.hidden_size, 1 << 14),
            ("num_hidden_layers", config.num_hidden_layers, 1 << 10),
            ("num_attention_heads", config.num_attention_heads, 1 << 10),
            ("intermediate_size", config.intermediate_size, 1 << 16),
            ("vocab_size", config.vocab_size, 1 << 24),
            ("max_position_embeddings", config.max_position_embeddings, 1 << 20),
            ("type_vocab_size", config.type_vocab_size, 1 << 10),
        ];
        if let Some((name, value, most)) = sizes.iter().find(|(_, v, most)| *v == 0 || v > most) {
            return bad(format!("{name} is {value}, 1 to {most} are possible"));
        }
        if !config.hidden_size.is_multiple_of(config.num_attention_heads) {
            let (width, heads) = (config.hidden_size, config.num_attention_heads);
            return bad(format!(
                "hidden_size {width} is no multiple of num_attention_heads {heads}"
            ));
        }
        for (name, value, known) in [
            ("model_type", &config.model_type, "bert"),
            ("hidden_act", &config.hidden_act, "gelu"),
            ("position_embedding_type", &config.position_embedding_type, "absolute"),
        ] {
            if value != known {
                return bad(format!("{name} is {value:?}, only {known:?} is known"));
            }
        }
        if !(config.layer_norm_eps >= 0.0 && config.layer_norm_eps < 1.0) {
            return bad(format!("layer_norm_eps is {}", config.layer_norm_eps));
        }
        config.max_tokens = config.max_position_embeddings;
        let path = folder.join("sentence_bert_config.json");
        if path.exists() {
            config.max_tokens = config.max_tokens.min(json::<Sentence>(&path)?.max_seq_length);
        }
        if config.max_tokens < 3 {
            let problem = format!("leaves room for {} tokens, a word needs 3", config.max_tokens);
            return Err(PhraseError::Model { path, problem, help: HELP });
        }
        let path = folder.join("1_Pooling/config.json");
        if path.exists() {
            let pooling: Pooling = json(&path)?;
            let mut others = pooling.others.iter();
            let other = others.find(|(k, v)| k.starts_with("pooling_mode") && **v == true);
            let other = other.map(|(name, _)| name.as_str());
            if let Some(mode) = other.or((!pooling.pooling_mode_mean_tokens).then_some("no mean")) {
                let problem = format!("asks for {mode}, only the mean over the tokens is known");
                return Err(PhraseError::Model { path, problem, help: HELP });
            }
        }
        Ok(config)
    }
}

/// Reads a JSON file.
fn json<T: DeserializeOwned>(path: &Path) -> Result<T, PhraseError> {
    serde_json::from_str(&read_text_file(path)?).map_err(|error| PhraseError::Model {
        path: path.to_owned(),
        problem: format!("is not the description of a sentence encoder: {error}"),
        help: HELP,
    })
}

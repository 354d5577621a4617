//! A sentence encoder of a few words, written as published ones are, and a slow reference in f64.

use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use safetensors::tensor::{Dtype, TensorView};
use std::collections::BTreeMap;
use std::path::Path;

const WIDTH: usize = 12;
const INNER: usize = 20;
const LAYERS: usize = 2;
const POSITIONS: usize = 200;
const EPS: f64 = 1e-12;
const WORDS: [&str; 10] =
    ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "a", "red", "chair", "##s", "lamp", ","];

/// Weights by name with their shapes.
pub struct SmallEncoder {
    heads: usize,
    weights: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
}

impl SmallEncoder {
    /// With weights of a fixed seed.
    pub fn new(heads: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut weights = BTreeMap::new();
        let mut put = |name: &str, shape: &[usize], middle: f32| {
            let count = shape.iter().product::<usize>();
            let values = (0..count).map(|_| middle + rng.random_range(-0.6..0.6)).collect();
            weights.insert(name.to_owned(), (shape.to_vec(), values));
        };
        put("embeddings.word_embeddings.weight", &[WORDS.len(), WIDTH], 0.0);
        put("embeddings.position_embeddings.weight", &[POSITIONS, WIDTH], 0.0);
        put("embeddings.token_type_embeddings.weight", &[2, WIDTH], 0.0);
        put("embeddings.LayerNorm.weight", &[WIDTH], 1.0);
        put("embeddings.LayerNorm.bias", &[WIDTH], 0.0);
        for layer in 0..LAYERS {
            let name = |part: &str| format!("encoder.layer.{layer}.{part}");
            for (part, cout, cin) in [
                ("attention.self.query", WIDTH, WIDTH),
                ("attention.self.key", WIDTH, WIDTH),
                ("attention.self.value", WIDTH, WIDTH),
                ("attention.output.dense", WIDTH, WIDTH),
                ("intermediate.dense", INNER, WIDTH),
                ("output.dense", WIDTH, INNER),
            ] {
                put(&name(&format!("{part}.weight")), &[cout, cin], 0.0);
                put(&name(&format!("{part}.bias")), &[cout], 0.0);
            }
            for part in ["attention.output.LayerNorm", "output.LayerNorm"] {
                put(&name(&format!("{part}.weight")), &[WIDTH], 1.0);
                put(&name(&format!("{part}.bias")), &[WIDTH], 0.0);
            }
        }
        // Published files hold it; nothing is done with it.
        put("pooler.dense.weight", &[WIDTH, WIDTH], 0.0);
        Self { heads, weights }
    }

    /// The folder of the encoder.
    pub fn write(&self) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let put =
            |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
        put(
            "config.json",
            format!(
                r#"{{"model_type":"bert","hidden_size":{WIDTH},"num_hidden_layers":{LAYERS},"num_attention_heads":{},
                "intermediate_size":{INNER},"hidden_act":"gelu","layer_norm_eps":1e-12,"vocab_size":{},
                "max_position_embeddings":{POSITIONS},"type_vocab_size":2,"torch_dtype":"float32"}}"#,
                self.heads,
                WORDS.len()
            ),
        );
        put(
            "sentence_bert_config.json",
            r#"{"max_seq_length": 180, "do_lower_case": false}"#.into(),
        );
        std::fs::create_dir(folder.path().join("1_Pooling")).unwrap();
        let pooling = r#"{"word_embedding_dimension": 12, "pooling_mode_cls_token": false,
            "pooling_mode_mean_tokens": true, "pooling_mode_max_tokens": false}"#;
        put("1_Pooling/config.json", pooling.into());
        put("tokenizer.json", tokenizer());
        self.write_weights(&folder.path().join("model.safetensors"), "", None);
        folder
    }

    /// The weights with something before their names, and perhaps a bad value among the first.
    pub fn write_weights(&self, path: &Path, prefix: &str, bad: Option<f32>) {
        let bytes: Vec<(String, Vec<usize>, Vec<u8>)> = (self.weights.iter())
            .map(|(name, (shape, values))| {
                let mut values = values.clone();
                if let Some(bad) = bad.filter(|_| name.contains("word_embeddings")) {
                    values[5] = bad;
                }
                let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
                (format!("{prefix}{name}"), shape.clone(), bytes)
            })
            .collect();
        let views = bytes.iter().map(|(name, shape, bytes)| {
            (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap())
        });
        std::fs::write(path, safetensors::serialize(views, None).unwrap()).unwrap();
    }

    fn get(&self, name: &str) -> Vec<f64> {
        self.weights[name].1.iter().map(|v| f64::from(*v)).collect()
    }

    /// The vector of a phrase, computed in f64 one number after the other.
    pub fn reference(&self, phrase: &str) -> Vec<f32> {
        let ids = ids(phrase);
        let (words, positions) = (
            self.get("embeddings.word_embeddings.weight"),
            self.get("embeddings.position_embeddings.weight"),
        );
        let types = self.get("embeddings.token_type_embeddings.weight");
        let mut x: Vec<Vec<f64>> = (ids.iter().enumerate())
            .map(|(t, &id)| {
                (0..WIDTH)
                    .map(|c| words[id * WIDTH + c] + positions[t * WIDTH + c] + types[c])
                    .collect()
            })
            .collect();
        self.norm(&mut x, "embeddings.LayerNorm");
        for layer in 0..LAYERS {
            let name = |part: &str| format!("encoder.layer.{layer}.{part}");
            let [q, k, v] = ["query", "key", "value"]
                .map(|part| self.linear(&x, &name(&format!("attention.self.{part}")), WIDTH));
            let dim = WIDTH / self.heads;
            let mut attended = vec![vec![0.0; WIDTH]; x.len()];
            for head in 0..self.heads {
                let part = head * dim..(head + 1) * dim;
                for i in 0..x.len() {
                    let score = |j: usize| {
                        let products = part.clone().map(|c| q[i][c] * k[j][c]).sum::<f64>();
                        (products / (dim as f64).sqrt()).exp()
                    };
                    let total: f64 = (0..x.len()).map(score).sum();
                    for j in 0..x.len() {
                        part.clone().for_each(|c| attended[i][c] += score(j) / total * v[j][c]);
                    }
                }
            }
            let out = self.linear(&attended, &name("attention.output.dense"), WIDTH);
            add(&mut x, &out);
            self.norm(&mut x, &name("attention.output.LayerNorm"));
            let mut inner = self.linear(&x, &name("intermediate.dense"), INNER);
            inner.iter_mut().flatten().for_each(|v| *v = gelu(*v));
            let out = self.linear(&inner, &name("output.dense"), WIDTH);
            add(&mut x, &out);
            self.norm(&mut x, &name("output.LayerNorm"));
        }
        let mean: Vec<f64> =
            (0..WIDTH).map(|c| x.iter().map(|row| row[c]).sum::<f64>() / x.len() as f64).collect();
        let length = mean.iter().map(|v| v * v).sum::<f64>().sqrt();
        mean.iter().map(|v| (v / length) as f32).collect()
    }

    fn linear(&self, x: &[Vec<f64>], name: &str, cout: usize) -> Vec<Vec<f64>> {
        let (weight, bias) =
            (self.get(&format!("{name}.weight")), self.get(&format!("{name}.bias")));
        x.iter()
            .map(|row| {
                let product = |o: usize| {
                    row.iter().zip(&weight[o * row.len()..]).map(|(v, w)| v * w).sum::<f64>()
                        + bias[o]
                };
                (0..cout).map(product).collect()
            })
            .collect()
    }

    fn norm(&self, x: &mut [Vec<f64>], name: &str) {
        let (weight, bias) =
            (self.get(&format!("{name}.weight")), self.get(&format!("{name}.bias")));
        for row in x {
            let mean = row.iter().sum::<f64>() / WIDTH as f64;
            let variance = row.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / WIDTH as f64;
            for (c, v) in row.iter_mut().enumerate() {
                *v = (*v - mean) / (variance + EPS).sqrt() * weight[c] + bias[c];
            }
        }
    }
}

fn add(x: &mut [Vec<f64>], other: &[Vec<f64>]) {
    x.iter_mut().flatten().zip(other.iter().flatten()).for_each(|(v, o)| *v += o);
}

/// `x·Φ(x)`, the distribution function by Simpson's rule.
fn gelu(x: f64) -> f64 {
    let steps = 400;
    let width = x / f64::from(steps);
    let density = |t: f64| (-t * t / 2.0).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let part = |i: i32| {
        let from = width * f64::from(i);
        width / 6.0 * (density(from) + 4.0 * density(from + width / 2.0) + density(from + width))
    };
    x * (0.5 + (0..steps).map(part).sum::<f64>())
}

/// The tokens of a phrase of known words, separated by spaces.
fn ids(phrase: &str) -> Vec<usize> {
    let id = |word: &str| WORDS.iter().position(|w| *w == word);
    let mut ids = vec![2];
    for word in phrase.to_lowercase().replace(',', " ,").replace('!', " !").split_whitespace() {
        match (id(word), word.strip_suffix('s').and_then(id)) {
            (Some(id), _) => ids.push(id),
            (None, Some(stem)) => ids.extend([stem, 7]),
            _ => ids.push(1),
        }
    }
    ids.push(3);
    ids
}

/// As published models have it, with the padding and truncation to 128 tokens that they declare.
fn tokenizer() -> String {
    let vocab: BTreeMap<&str, usize> = WORDS.iter().enumerate().map(|(i, w)| (*w, i)).collect();
    serde_json::json!({
        "version": "1.0",
        "truncation": {"max_length": 128, "strategy": "LongestFirst", "stride": 0, "direction": "Right"},
        "padding": {"strategy": {"Fixed": 128}, "direction": "Right", "pad_to_multiple_of": null, "pad_id": 0,
            "pad_type_id": 0, "pad_token": "[PAD]"},
        "added_tokens": (0..4).map(|id| serde_json::json!({"id": id, "special": true, "content": WORDS[id],
            "single_word": false, "lstrip": false, "rstrip": false, "normalized": false})).collect::<Vec<_>>(),
        "normalizer": {"type": "BertNormalizer", "clean_text": true, "handle_chinese_chars": true,
            "strip_accents": null, "lowercase": true},
        "pre_tokenizer": {"type": "BertPreTokenizer"},
        "post_processor": {"type": "TemplateProcessing",
            "single": [{"SpecialToken": {"id": "[CLS]", "type_id": 0}}, {"Sequence": {"id": "A", "type_id": 0}},
                {"SpecialToken": {"id": "[SEP]", "type_id": 0}}],
            "pair": [{"SpecialToken": {"id": "[CLS]", "type_id": 0}}, {"Sequence": {"id": "A", "type_id": 0}},
                {"SpecialToken": {"id": "[SEP]", "type_id": 0}}, {"Sequence": {"id": "B", "type_id": 1}},
                {"SpecialToken": {"id": "[SEP]", "type_id": 1}}],
            "special_tokens": {"[CLS]": {"id": "[CLS]", "ids": [2], "tokens": ["[CLS]"]},
                "[SEP]": {"id": "[SEP]", "ids": [3], "tokens": ["[SEP]"]}}},
        "decoder": {"type": "WordPiece", "prefix": "##", "cleanup": true},
        "model": {"type": "WordPiece", "unk_token": "[UNK]", "continuing_subword_prefix": "##",
            "max_input_chars_per_word": 100, "vocab": vocab},
    })
    .to_string()
}

//! A text tower of SigLIP of a few words, written as published ones are.

use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use safetensors::tensor::{Dtype, TensorView};
use serde_json::json;
use std::collections::BTreeMap;

const WORDS: [&str; 14] = [
    "<pad>", "<eos>", "<bos>", "<unk>", "this", "is", "a", "red", "chair", "table", "floor",
    "wall", "robot", "arm",
];
const LAYERS: usize = 2;
const INNER: usize = 40;
const POSITIONS: usize = 16;

/// Folder of a tower whose vectors have this width (a multiple of 4), with weights of a fixed seed: `config.json`,
/// `tokenizer.json` and `model.safetensors` by the names of transformers. The picture tower is left out.
pub fn small_siglip(width: usize) -> tempfile::TempDir {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut weights: BTreeMap<String, (Vec<usize>, Vec<u8>)> = BTreeMap::new();
    let mut put = |name: String, shape: &[usize], middle: f32| {
        let count = shape.iter().product::<usize>();
        let values = (0..count).map(|_| middle + rng.random_range(-0.4f32..0.4));
        let bytes = values.flat_map(f32::to_le_bytes).collect();
        weights.insert(name, (shape.to_vec(), bytes));
    };
    put("logit_scale".to_owned(), &[1], 4.0);
    put("logit_bias".to_owned(), &[1], -10.0);
    let text = |part: &str| format!("text_model.{part}");
    put(text("embeddings.token_embedding.weight"), &[WORDS.len(), width], 0.0);
    put(text("embeddings.position_embedding.weight"), &[POSITIONS, width], 0.0);
    for layer in 0..LAYERS {
        let name = |part: &str| text(&format!("encoder.layers.{layer}.{part}"));
        for (part, cout, cin) in [
            ("self_attn.q_proj", width, width),
            ("self_attn.k_proj", width, width),
            ("self_attn.v_proj", width, width),
            ("self_attn.out_proj", width, width),
            ("mlp.fc1", INNER, width),
            ("mlp.fc2", width, INNER),
        ] {
            put(name(&format!("{part}.weight")), &[cout, cin], 0.0);
            put(name(&format!("{part}.bias")), &[cout], 0.0);
        }
        for part in ["layer_norm1", "layer_norm2"] {
            put(name(&format!("{part}.weight")), &[width], 1.0);
            put(name(&format!("{part}.bias")), &[width], 0.0);
        }
    }
    put(text("final_layer_norm.weight"), &[width], 1.0);
    put(text("final_layer_norm.bias"), &[width], 0.0);
    put(text("head.weight"), &[width, width], 0.0);
    put(text("head.bias"), &[width], 0.0);

    let folder = tempfile::tempdir().unwrap();
    let views = weights.iter().map(|(name, (shape, bytes))| {
        (name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap())
    });
    let file = safetensors::serialize(views, None).unwrap();
    std::fs::write(folder.path().join("model.safetensors"), file).unwrap();
    let config = json!({
        "model_type": "siglip",
        "text_config": {
            "model_type": "siglip_text_model", "vocab_size": WORDS.len(), "hidden_size": width,
            "intermediate_size": INNER, "num_hidden_layers": LAYERS, "num_attention_heads": 4,
            "max_position_embeddings": POSITIONS,
        },
        "vision_config": { "model_type": "siglip_vision_model" },
    });
    std::fs::write(folder.path().join("config.json"), config.to_string()).unwrap();
    std::fs::write(folder.path().join("tokenizer.json"), tokenizer().to_string()).unwrap();
    folder
}

/// One piece a word, and an end.
fn tokenizer() -> serde_json::Value {
    let vocab: BTreeMap<&str, usize> = WORDS.iter().enumerate().map(|(i, w)| (*w, i)).collect();
    let special = |i: usize| {
        json!({
            "id": i, "content": WORDS[i], "single_word": false, "lstrip": false, "rstrip": false,
            "normalized": false, "special": true,
        })
    };
    json!({
        "version": "1.0",
        "truncation": null,
        "padding": null,
        "added_tokens": [special(0), special(1), special(2), special(3)],
        "normalizer": null,
        "pre_tokenizer": { "type": "Whitespace" },
        "post_processor": {
            "type": "TemplateProcessing",
            "single": [
                { "Sequence": { "id": "A", "type_id": 0 } },
                { "SpecialToken": { "id": "<eos>", "type_id": 0 } },
            ],
            "pair": [
                { "Sequence": { "id": "A", "type_id": 0 } },
                { "Sequence": { "id": "B", "type_id": 0 } },
            ],
            "special_tokens": { "<eos>": { "id": "<eos>", "ids": [1], "tokens": ["<eos>"] } },
        },
        "decoder": null,
        "model": { "type": "WordLevel", "vocab": vocab, "unk_token": "<unk>" },
    })
}

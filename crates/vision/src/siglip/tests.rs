//! Against numbers of transformers (`benches/pytorch/siglip.py`), and the traps between a folder and a vector.

mod folders;

use super::*;
use crate::test_files::{Arrays, save};
use scenesplat_kernels::Precision;
use scenesplat_models::weights::{hashed_parameter, unit};
use scenesplat_scene::picture::RgbPicture;
use serde_json::{Value, json};
use std::collections::BTreeMap;

const NUMBERS: &str = include_str!("../../tests/data/siglip_mini.json");
/// Sums of a few dozen f32 terms through two layers.
const F32: f32 = 1e-4;

fn numbers() -> Value {
    serde_json::from_str(NUMBERS).unwrap()
}

fn floats(value: &Value) -> Vec<f32> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32).collect()
}

/// A tokenizer of words whose file asks for padding with the end, as candle's example pads.
fn tokenizer() -> Value {
    let words = ["<pad>", "<eos>", "<bos>", "<unk>", "this", "is", "a", "chair", "red", "Chair"];
    let vocab: BTreeMap<&str, usize> = words.iter().enumerate().map(|(i, w)| (*w, i)).collect();
    let special = |i: usize| {
        json!({"id": i, "content": words[i], "single_word": false, "lstrip": false, "rstrip": false,
               "normalized": false, "special": true})
    };
    json!({
        "version": "1.0",
        "truncation": null,
        "padding": {"strategy": {"Fixed": 5}, "direction": "Left", "pad_to_multiple_of": null, "pad_id": 1,
                    "pad_type_id": 0, "pad_token": "<eos>"},
        "added_tokens": [special(0), special(1), special(2), special(3)],
        "normalizer": null,
        "pre_tokenizer": {"type": "Whitespace"},
        "post_processor": {
            "type": "TemplateProcessing",
            "single": [{"Sequence": {"id": "A", "type_id": 0}}, {"SpecialToken": {"id": "<eos>", "type_id": 0}}],
            "pair": [{"Sequence": {"id": "A", "type_id": 0}}, {"Sequence": {"id": "B", "type_id": 0}}],
            "special_tokens": {"<eos>": {"id": "<eos>", "ids": [1], "tokens": ["<eos>"]}}
        },
        "decoder": null,
        "model": {"type": "WordLevel", "vocab": vocab, "unk_token": "<unk>"}
    })
}

/// The small model as a folder, all names and shapes those of transformers.
fn folder(change: impl Fn(&mut Arrays)) -> tempfile::TempDir {
    let numbers = numbers();
    let seed = numbers["seed"].as_u64().unwrap();
    let mut tensors = Arrays::new();
    for (name, shape) in numbers["shapes"].as_object().unwrap() {
        let shape: Vec<usize> =
            shape.as_array().unwrap().iter().map(|v| v.as_u64().unwrap() as usize).collect();
        let value = hashed_parameter(name, &shape, seed).unwrap();
        tensors.insert(name.clone(), (shape, value.flatten_all().unwrap().to_vec1().unwrap()));
    }
    change(&mut tensors);
    let folder = tempfile::tempdir().unwrap();
    save(&tensors, &folder.path().join("model.safetensors"));
    write(&folder, "config.json", &numbers["config"]);
    write(&folder, "tokenizer.json", &tokenizer());
    folder
}

fn write(folder: &tempfile::TempDir, name: &str, value: &Value) {
    std::fs::write(folder.path().join(name), value.to_string()).unwrap();
}

fn close(got: &[f32], want: &[f32]) {
    assert_eq!(got.len(), want.len());
    let worst = got.iter().zip(want).map(|(g, w)| (g - w).abs()).fold(0.0, f32::max);
    println!("largest difference {worst:.2e}");
    assert!(worst <= F32, "{worst}");
}

#[test]
fn both_towers_at_the_numbers_of_transformers() {
    let (folder, numbers) = (folder(|_| ()), numbers());
    let image = SiglipImageEncoder::load(folder.path(), Precision::F32).unwrap();
    let side = image.image_size();
    let planes = unit("planes", 2 * 3 * side * side, 19);
    let planes: Vec<Vec<f32>> = planes.chunks(3 * side * side).map(<[f32]>::to_vec).collect();
    close(&image.forward(&planes), &floats(&numbers["image"]));

    let text = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap();
    let ids: Vec<Vec<u32>> = serde_json::from_value(numbers["ids"].clone()).unwrap();
    close(&text.forward(&ids), &floats(&numbers["text"]));
    assert_eq!((image.width(), text.width()), (24, 24));
}

fn pictures() -> Vec<RgbPicture> {
    let picture = |i: u32| {
        RgbPicture::from_fn(20 + 7 * i, 50 - 3 * i, |x, y| {
            [(x * 9 + i) as u8, (y * 5) as u8, (x ^ y) as u8]
        })
    };
    (0..11).map(picture).collect()
}

#[test]
fn rows_have_unit_length_and_the_bits_of_one_alone() {
    let folder = folder(|_| ());
    let encoder = SiglipImageEncoder::load(folder.path(), Precision::F32).unwrap();
    let rows = encoder.encode(&pictures()).unwrap();
    for (row, picture) in rows.chunks_exact(24).zip(pictures()) {
        assert!((scenesplat_kernels::normalize::norm(row) - 1.0).abs() < 1e-6);
        assert_eq!(encoder.encode(&[picture]).unwrap(), row);
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap();
    assert_eq!(rows, pool.install(|| encoder.encode(&pictures()).unwrap()));
    assert!(encoder.encode(&[]).unwrap().is_empty());
    let mut bad = pictures();
    bad[9] = RgbPicture::filled(0, 9, [0; 3]);
    let error = encoder.encode(&bad).unwrap_err().to_string();
    assert!(error.contains("number 9"), "{error}");
}

#[test]
fn bf16_is_near() {
    let folder = folder(|_| ());
    let load = |precision| SiglipImageEncoder::load(folder.path(), precision).unwrap();
    let (exact, rough) = (load(Precision::F32), load(Precision::Bf16));
    let (a, b) = (exact.encode(&pictures()).unwrap(), rough.encode(&pictures()).unwrap());
    assert_ne!(a, b);
    for (a, b) in a.chunks_exact(24).zip(b.chunks_exact(24)) {
        let cosine: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        assert!(cosine > 0.999, "{cosine}");
    }
}

#[test]
fn pictures_are_squashed_and_not_cut() {
    let folder = folder(|_| ());
    let encoder = SiglipImageEncoder::load(folder.path(), Precision::F32).unwrap();
    // What lies at the far ends of a wide picture changes its vector.
    let wide = |end: u8| RgbPicture::from_fn(200, 20, |x, _| [if x > 180 { end } else { 90 }; 3]);
    let rows = encoder.encode(&[wide(0), wide(255)]).unwrap();
    assert_ne!(rows[..24], rows[24..]);
    // Two resizers differ by rounding, and by nothing more.
    let photo = &pictures()[..1];
    let a = encoder.encode(photo).unwrap();
    let encoder = encoder.with_resizing(Resizing::Torchvision);
    let b = encoder.encode(photo).unwrap();
    let cosine: f32 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    assert!(a != b && cosine > 0.999, "{cosine}");
}

#[test]
fn texts_are_padded_with_pad_to_the_full_length() {
    let folder = folder(|_| ());
    let text = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap();
    // The end once, then padding (0, not the end's 1) behind, whatever tokenizer.json says; lower-cased.
    let want = [4, 5, 6, 7, 1, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(text.token_ids("this is a chair").unwrap(), want);
    assert_eq!(text.token_ids("This IS a Chair").unwrap(), want);
    // A longer one is cut before its end.
    let long = "red ".repeat(40);
    let ids = text.token_ids(&long).unwrap();
    assert_eq!((ids.len(), ids[..11].to_vec(), ids[11]), (12, vec![8; 11], 1));
    // One of exactly eleven words has an end and no padding.
    assert_eq!(text.token_ids(&"red ".repeat(11)).unwrap(), ids);
    let empty = text.token_ids(" ").unwrap_err().to_string();
    assert!(empty.contains("says nothing"), "{empty}");

    let rows = text.encode(&["red", "this is a chair", "THIS is a chair"]).unwrap();
    assert_eq!(rows[24..48], rows[48..]);
    assert_eq!(text.encode(&["red"]).unwrap(), rows[..24]);
    let text = text.with_lowercase(false);
    assert_eq!(text.token_ids("a Chair").unwrap()[..3], [6, 9, 1]);
}

#[test]
fn probabilities_are_of_each_text_alone() {
    let folder = folder(|t| {
        t.insert("logit_scale".to_owned(), (vec![1], vec![100f32.ln()]));
        t.insert("logit_bias".to_owned(), (vec![1], vec![-10.0]));
    });
    let text = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap();
    assert!((text.probability(0.1) - 0.5).abs() < 1e-4);
    assert!((text.probability(0.12) - 0.880_797).abs() < 1e-4);
}

#[test]
fn one_tower_is_enough() {
    let only = |part: &'static str| folder(move |t| t.retain(|name, _| name.starts_with(part)));
    assert!(SiglipImageEncoder::load(only("vision_model.").path(), Precision::F32).is_ok());
    let error = SiglipTextEncoder::load(only("vision_model.").path(), Precision::F32).unwrap_err();
    assert!(error.to_string().contains("has no tensor text_model."), "{error}");
}

#[test]
fn bad_folders_are_refused_by_name() {
    let load = |folder: &tempfile::TempDir| {
        SiglipImageEncoder::load(folder.path(), Precision::F32).unwrap_err().to_string()
    };
    let with = |name: &str, value: Value| {
        let folder = folder(|_| ());
        write(&folder, name, &value);
        load(&folder)
    };
    let naflex = with("config.json", json!({"model_type": "siglip2"}));
    assert!(naflex.contains("config.json") && naflex.contains("pictures of any size"), "{naflex}");
    let mut config = numbers()["config"].clone();
    config["vision_config"]["hidden_act"] = json!("gelu");
    assert!(with("config.json", config.clone()).contains("vision_config.hidden_act is \"gelu\""));
    config = numbers()["config"].clone();
    config["vision_config"]["image_size"] = json!(64);
    let message = with("config.json", config);
    assert!(message.contains("position_embedding.weight has shape [16, 24]"), "{message}");
    let other = with("preprocessor_config.json", json!({"size": {"height": 512, "width": 512}}));
    assert!(other.contains("512 × 512") && other.contains("34 × 34"), "{other}");
    let nearest = with("preprocessor_config.json", json!({"resample": 0}));
    assert!(nearest.contains("resample is 0"), "{nearest}");
    let missing = load(&folder(|t| {
        t.remove("vision_model.head.probe");
    }));
    assert!(missing.contains("has no tensor vision_model.head.probe"), "{missing}");
    let foreign = load(&folder(|t| {
        t.insert("vision_model.extra".to_owned(), (vec![1], vec![0.0]));
    }));
    assert!(foreign.contains("vision_model.extra"), "{foreign}");
    let nan = load(&folder(|t| t.get_mut("vision_model.head.probe").unwrap().1[3] = f32::NAN));
    assert!(nan.contains("head.probe: value 3 is NaN"), "{nan}");
    let mut wide = tokenizer();
    wide["model"]["vocab"]["far"] = json!(40);
    let folder = folder(|_| ());
    write(&folder, "tokenizer.json", &wide);
    let error = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap_err().to_string();
    assert!(error.contains("tokenizer.json") && error.contains("number 40"), "{error}");
}

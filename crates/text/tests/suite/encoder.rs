//! The encoder: a small one made here against a slow reference, and the published one where its weights are.

use rand::Rng;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use scenesplat_test_support::SmallEncoder;
use scenesplat_text::{PhraseTable, TextEncoder};
use std::path::{Path, PathBuf};

/// Sums of a few hundred products in f32 and f64.
const F32_EPS: f32 = 2e-5;

/// Of `assets/phrases.safetensors`.
const TABLE_SHA256: &str = "6fe2951b329f4a6c4825231000c804ef4d7b870b4a21609923d841045195fe0b";

/// Six numbers of a vector of length 1 were written down to five places.
const GIVEN_EPS: f32 = 1e-5;

/// The folder of all-MiniLM-L6-v2, or `None` after saying why a test is not run.
fn minilm() -> Option<TextEncoder> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/minilm");
    let folder = std::env::var_os("SCENESPLAT_MINILM").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(TextEncoder::open(&folder).unwrap());
    }
    // Not the word that CI stops at: the weights are no part of the shared data.
    println!("NOT RUN: no sentence encoder at {}; set SCENESPLAT_MINILM", folder.display());
    None
}

fn close(got: &[f32], expected: &[f32], eps: f32, what: &str) {
    assert_eq!(got.len(), expected.len(), "{what}");
    for (i, (g, e)) in got.iter().zip(expected).enumerate() {
        assert!((g - e).abs() <= eps, "{what}[{i}]: {g}, {e} is right");
    }
}

#[test]
fn it_agrees_with_a_slow_reference() {
    for heads in [1, 3] {
        let small = SmallEncoder::new(heads);
        let folder = small.write();
        let encoder = TextEncoder::open(folder.path()).unwrap();
        for phrase in ["red chair", "chair", "a red red chair lamp", "ChAiRs, lamp!"] {
            let got = encoder.encode(&[phrase]).unwrap();
            close(&got.values, &small.reference(phrase), F32_EPS, phrase);
            assert!(got.truncated.is_empty());
        }
    }
}

#[test]
fn phrases_have_the_same_bits_alone_and_together() {
    let folder = SmallEncoder::new(3).write();
    let encoder = TextEncoder::open(folder.path()).unwrap();
    let words = ["red", "chair", "lamp", "a", "chairs", "zzz"];
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let phrases: Vec<String> = (0..2000)
        .map(|_| {
            let length = rng.random_range(1..12);
            let words: Vec<&str> = (0..length).map(|_| words[rng.random_range(0..5)]).collect();
            words.join(" ")
        })
        .collect();
    let all = encoder.encode(&phrases).unwrap();
    for (phrase, row) in phrases.iter().zip(all.values.chunks_exact(all.dim)).step_by(37) {
        assert_eq!(encoder.encode(&[phrase]).unwrap().values, row, "{phrase}");
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert!(pool.install(|| encoder.encode(&phrases).unwrap()) == all, "one thread");
    assert!(encoder.encode::<&str>(&[]).unwrap().values.is_empty());
}

/// `tokenizer.json` asks for padding to 128 tokens and truncation there; neither may have an effect.
#[test]
fn the_padding_of_the_file_is_not_used() {
    let small = SmallEncoder::new(3);
    let folder = small.write();
    let encoder = TextEncoder::open(folder.path()).unwrap();
    let long = vec!["chair"; 150].join(" ");
    let got = encoder.encode(&[&long]).unwrap();
    assert!(got.truncated.is_empty(), "{:?}", got.truncated);
    close(&got.values, &small.reference(&long), F32_EPS, "150 words");
}

#[test]
fn long_phrases_are_read_to_the_limit_and_named() {
    let small = SmallEncoder::new(3);
    let folder = small.write();
    let encoder = TextEncoder::open(folder.path()).unwrap();
    let most = encoder.max_tokens();
    let fits = vec!["chair"; most - 2].join(" ");
    let long = vec!["chair"; 10_000].join(" ");
    let got = encoder.encode(&["lamp", &long, &fits]).unwrap();
    let [cut] = got.truncated[..] else { panic!("{:?}", got.truncated) };
    assert_eq!((cut.phrase, cut.tokens, cut.read), (1, 10_002, most));
    // It keeps its end, so it is the phrase that just fits.
    assert_eq!(got.values[got.dim..2 * got.dim], got.values[2 * got.dim..]);
}

#[test]
fn phrases_that_say_nothing_are_refused() {
    let folder = SmallEncoder::new(3).write();
    let encoder = TextEncoder::open(folder.path()).unwrap();
    for phrase in ["", "   ", "\u{0}", "\n\t"] {
        let error = encoder.encode(&["lamp", phrase]).unwrap_err().to_string();
        assert!(error.contains("no word"), "{phrase:?}: {error}");
    }
    for phrase in ["\u{1f6cb}", "стул", "椅子", "qqqq"] {
        let error = encoder.encode(&[phrase]).unwrap_err().to_string();
        assert!(error.contains("nothing that the encoder knows"), "{phrase:?}: {error}");
    }
    let odd =
        encoder.encode(&["red \u{0}chair \u{1f6cb}\u{fe0f}", "e\u{301} chair", "chair \u{feff}"]);
    assert!(odd.unwrap().values.iter().all(|v| v.is_finite()));
}

#[test]
fn foreign_and_damaged_files_are_refused_by_name() {
    let small = SmallEncoder::new(3);
    let refused = |change: &dyn Fn(&Path), parts: &[&str]| {
        let folder = small.write();
        change(folder.path());
        let error = TextEncoder::open(folder.path()).unwrap_err().to_string();
        for part in parts {
            assert!(error.contains(part), "{part:?} in {error}");
        }
    };
    for name in ["config.json", "tokenizer.json", "model.safetensors"] {
        refused(&|f| std::fs::remove_file(f.join(name)).unwrap(), &[name]);
        let cut = |f: &Path| {
            let bytes = std::fs::read(f.join(name)).unwrap();
            std::fs::write(f.join(name), &bytes[..bytes.len() - 2]).unwrap();
        };
        refused(&cut, &[name]);
        refused(&|f| std::fs::write(f.join(name), "").unwrap(), &[name]);
        refused(
            &|f| {
                std::fs::write(f.join(name), "version https://git-lfs.github.com/spec/v1").unwrap();
            },
            &["git-lfs"],
        );
    }
    for (from, to, parts) in [
        ("\"gelu\"", "\"relu\"", &["config.json", "hidden_act", "relu"][..]),
        ("\"bert\"", "\"roberta\"", &["model_type", "roberta"]),
        ("attention_heads\":3", "attention_heads\":5", &["5", "multiple"]),
        ("\"hidden_size\":12", "\"hidden_size\":24", &["word_embeddings", "12", "24"]),
        ("hidden_layers\":2", "hidden_layers\":3", &["no tensor encoder.layer.2."]),
        ("hidden_layers\":2", "hidden_layers\":1", &["has a tensor encoder.layer.1."]),
        ("hidden_layers\":2", "hidden_layers\":0", &["num_hidden_layers is 0"]),
        ("\"vocab_size\":", "\"vocab_size\":9999999999, \"old\":", &["vocab_size"]),
    ] {
        let config = |f: &Path| {
            let path = f.join("config.json");
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.contains(from), "{text}");
            std::fs::write(path, text.replace(from, to)).unwrap();
        };
        refused(&config, parts);
    }
    // Flattened archives: the file of the pooling took the name of the other.
    let flattened = |f: &Path| {
        std::fs::rename(f.join("1_Pooling/config.json"), f.join("config.json")).unwrap();
    };
    refused(&flattened, &["config.json", "hidden_size", "its own folders"]);
    let pooling = |f: &Path| {
        let text = r#"{"pooling_mode_mean_tokens": false, "pooling_mode_cls_token": true}"#;
        std::fs::write(f.join("1_Pooling/config.json"), text).unwrap();
    };
    refused(&pooling, &["1_Pooling", "pooling_mode_cls_token"]);
    let nan = |f: &Path| small.write_weights(&f.join("model.safetensors"), "", Some(f32::NAN));
    refused(&nan, &["model.safetensors", "embeddings.word_embeddings.weight", "NaN"]);
    let error = TextEncoder::open(Path::new("nowhere")).unwrap_err().to_string();
    assert!(error.contains("nowhere"), "{error}");
}

#[test]
fn names_with_the_prefix_of_a_whole_model_are_known() {
    let small = SmallEncoder::new(3);
    let folder = small.write();
    small.write_weights(&folder.path().join("model.safetensors"), "bert.", None);
    let encoder = TextEncoder::open(folder.path()).unwrap();
    let got = encoder.encode(&["red chair"]).unwrap();
    close(&got.values, &small.reference("red chair"), F32_EPS, "red chair");
}

/// Values of the published model: `MiniLm.encode_one`, a numpy reference.
#[test]
fn the_published_encoder_gives_its_published_vectors() {
    let Some(encoder) = minilm() else { return };
    let given = [
        ("chair", [-0.00028, 0.05202, -0.05432, 0.02133, -0.05385, 0.00451]),
        ("extractor fan", [-0.07620, -0.00249, 0.01704, 0.00268, 0.10967, -0.03468]),
    ];
    let got = encoder.encode(&given.map(|g| g.0)).unwrap();
    assert_eq!((encoder.dim(), encoder.max_tokens()), (384, 256));
    for ((phrase, first), row) in given.iter().zip(got.values.chunks_exact(384)) {
        close(&row[..6], first, GIVEN_EPS, phrase);
        assert_eq!(encoder.encode(&[phrase]).unwrap().values, row, "{phrase} alone");
    }
    let long = vec!["extractor fan"; 5000].join(" ");
    let got = encoder.encode(&[long.as_str(), "Стул, 椅子", "chair \u{1f6cb}"]).unwrap();
    assert_eq!((got.truncated.len(), got.truncated[0].tokens), (1, 3 * 5000 + 2));
}

/// What the table inside the library holds is what the encoder gives.
#[test]
fn the_table_holds_the_vectors_of_the_published_encoder() {
    let Some(encoder) = minilm() else { return };
    let table = PhraseTable::embedded().unwrap();
    let phrases: Vec<&String> = table.phrases().iter().step_by(1009).collect();
    let encoded = encoder.encode(&phrases).unwrap();
    for (phrase, vector) in phrases.iter().zip(encoded.values.chunks_exact(encoded.dim)) {
        let (own, kept) = (table.project(vector).unwrap(), table.row(phrase).unwrap());
        let cosine: f32 = own.iter().zip(&kept).map(|(a, b)| a * b).sum();
        assert!(cosine > 0.998, "{phrase}: {cosine}");
    }
}

/// The hash of the table that `docs/text.md` measures.
#[test]
fn the_table_is_the_one_that_was_measured() {
    use sha2::{Digest, Sha256};
    let bytes =
        std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/phrases.safetensors"));
    let hash: String = Sha256::digest(bytes.unwrap()).iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(hash, TABLE_SHA256);
    assert!(PhraseTable::embedded().unwrap().len() >= 20_000);
}

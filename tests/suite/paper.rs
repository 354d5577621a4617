//! The runs of the paper take steps on miniatures of their data.

use crate::runs::{run, with_causes};
use scenesplat::experiment::ExperimentConfig;
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use scenesplat::scene::{LanguageFeatures, TextTable};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Benchmarks: the width of their features (0: none), the files of their labels.
const BENCHMARKS: [(&str, usize, &[&str]); 9] = [
    ("scannet", 768, &["segment20", "segment200"]),
    ("scannetpp", 768, &["segment"]),
    ("matterport3d", 768, &["segment_nyu_160"]),
    ("scannet_codes16", 16, &["segment20"]),
    ("scannet_codes64", 64, &["segment20"]),
    ("3rscan", 0, &["segment"]),
    ("arkitscenes", 0, &["segment"]),
    ("hypersim", 0, &["segment"]),
    ("replica", 0, &["segment"]),
];

/// Their folders, of one scene each. Rows of pictures' segments look no different to an autoencoder.
const FOLDERS: [&str; 7] =
    ["train", "train_segments", "train_CHUNKS", "val", "val_CHUNKS", "test", "test_CHUNKS"];

/// Tables of texts, and the names of their rows.
const TEXTS: [(&str, &str); 4] = [
    ("scannet20", "scannet20"),
    ("scannet200", "scannet200"),
    ("scannetpp_top100", "scannetpp100"),
    ("matterport-nyu160", "matterport160"),
];

fn configs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("configs")
}

fn write_scene(folder: &Path, width: usize, labels: &[&str]) {
    let mut scene = generate(&SyntheticRoomSettings::with_count(400, 3)).unwrap().scene;
    let n = scene.len();
    if width > 0 {
        let mut values = vec![half::f16::ZERO; n * width];
        (0..n).for_each(|row| values[row * width + row % width] = half::f16::from_f32(1.0));
        scene.lang_feat = Some(LanguageFeatures { values, dim: width });
        scene.valid_feat_mask = Some(vec![true; n]);
    }
    // Every list of classes has as many.
    scene.segment = Some((0..n as i32).map(|row| row % 3).collect());
    std::fs::create_dir_all(folder.parent().unwrap()).unwrap();
    write_npy_folder(&scene, folder, false).unwrap();
    let written = folder.join("segment.npy");
    for name in labels.iter().filter(|name| **name != "segment") {
        std::fs::copy(&written, folder.join(format!("{name}.npy"))).unwrap();
    }
    if !labels.contains(&"segment") {
        std::fs::remove_file(written).unwrap();
    }
}

/// What the runs of the paper read, in miniature.
fn data() -> tempfile::TempDir {
    let data = tempfile::tempdir().unwrap();
    for (benchmark, width, labels) in BENCHMARKS {
        for folder in FOLDERS {
            let folder = folder.replace("CHUNKS", "grid1.0cm_chunk6x6_stride3x3");
            write_scene(&data.path().join(benchmark).join(folder).join("s_0"), width, labels);
        }
    }
    for (table, list) in TEXTS {
        let list = configs().join("../datasets/label_maps").join(format!("{list}.txt"));
        let names: Vec<String> =
            std::fs::read_to_string(list).unwrap().lines().map(str::to_owned).collect();
        let mut values = vec![0.0; names.len() * 768];
        (0..names.len()).for_each(|row| values[row * 768 + row] = 1.0);
        let bytes = TextTable::from_rows(names, values, 768).unwrap().to_safetensors().unwrap();
        let file = format!("{table}_text_embeddings_siglip2.safetensors");
        std::fs::write(data.path().join(file), bytes).unwrap();
    }
    data
}

/// The experiment with narrow layers, a scene a batch and three passes over its data.
fn small(config: &ExperimentConfig) -> ExperimentConfig {
    let mut value = serde_json::to_value(config).unwrap();
    let task = value["task"].as_str().unwrap().to_owned();
    if ["language_pretraining", "distillation"].contains(&task.as_str()) {
        value["model"]["projection"] = json!(768);
    }
    // An autoencoder has its own widths, and may have no others.
    let widths = [
        (["enc_channels", "dec_channels", "channels"], 16),
        (["enc_num_head", "dec_num_head", "patch_embed_groups"], 1),
        (["enc_groups", "dec_groups", ""], 2),
    ];
    for (fields, number) in widths.into_iter().filter(|_| task != "autoencoder") {
        for field in fields {
            match value["model"].get_mut(field) {
                Some(Value::Array(stages)) => stages.fill(json!(number)),
                Some(whole) => *whole = json!(number),
                None => {}
            }
        }
    }
    value["loader"]["batch_size"] = json!(1);
    value["loader"]["workers"] = json!(0);
    for data in value["train"].as_array_mut().unwrap() {
        data["repeat"] = json!(3);
        data["weight"] = json!(1);
    }
    value["trainer"]["epochs"] = json!(1);
    if let Some(trainer) = value["trainer"].as_object_mut() {
        trainer.remove("max_steps");
    }
    value["trainer"]["accumulate"] = json!(1);
    value["trainer"]["checkpoint"]["every_steps"] = json!(0);
    serde_json::from_value(value).unwrap()
}

/// Three steps or more; gives the model folder.
fn train_small(file: &Path, data: &Path, pretrained: &Path, out: &Path) -> PathBuf {
    let value = |name: &str| match name {
        "DATA_ROOT" => Some(data.display().to_string()),
        "SSL_MODEL" | "SONATA" => Some(pretrained.display().to_string()),
        "FEATURES" => Some("train_segments".to_owned()),
        _ => None,
    };
    let name = file.display();
    let config = ExperimentConfig::read_with(file, &value)
        .unwrap_or_else(|error| panic!("{name}: {}", with_causes(&error)));
    let report = run(&small(&config), out, false).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(report.progress.step >= 3, "{name}: {} steps", report.progress.step);
    report.model
}

/// Trains all runs, or those of these names, after the one that others begin with; gives how many.
fn train_all(only: &[&str]) -> usize {
    let data = data();
    let runs = data.path().join("runs");
    let first = configs().join("self_supervised/scannet_mgm.toml");
    let pretrained = train_small(&first, data.path(), Path::new(""), &runs.join("first"));
    let mut taken = 0;
    for folder in ["language_pretraining", "self_supervised", "semantic_segmentation"] {
        for entry in std::fs::read_dir(configs().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            // Of rooms, a common part, of a table with more rows than classes, and the first.
            let other = ["synthetic_rooms", "common", "holicity"];
            let is_run = name != "scannet_mgm" && !other.iter().any(|part| name.contains(part));
            if is_run && (only.is_empty() || only.contains(&name.as_str())) {
                train_small(&path, data.path(), &pretrained, &runs.join(&name));
                std::fs::remove_dir_all(runs.join(&name)).unwrap();
                taken += 1;
            }
        }
    }
    taken
}

#[test]
fn a_run_of_each_kind_takes_three_steps() {
    let kinds = [
        "scannet_labels",
        "scannetpp_contrast_always",
        "scannet_supplement",
        "scannet_la16",
        "scannet20_finetune",
        "scannet20_sonata",
        "ptv2_scannet20",
    ];
    assert_eq!(train_all(&kinds), kinds.len());
}

#[test]
#[ignore = "trains 44 networks for a minute; .ci/optional runs it"]
fn every_run_of_the_paper_takes_three_steps() {
    assert!(train_all(&[]) >= 40);
}

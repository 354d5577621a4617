//! Runs of experiments: what they read, record and refuse.

use crate::settings::{Data, text};
use scenesplat::experiment::{ExperimentConfig, RunOptions, RunReport, train};
use scenesplat::rooms::{SyntheticRoomSettings, generate};
use scenesplat::scene::formats::npy_folder::write_npy_folder;
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// An error with everything behind it.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(source) => format!("{error}: {}", with_causes(source)),
        None => error.to_string(),
    }
}

/// Reads an experiment whose paths start at a folder.
pub fn read(folder: &Path, text: &str) -> Result<ExperimentConfig, String> {
    static NUMBER: AtomicUsize = AtomicUsize::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let path = folder.join(format!("experiment-{number}.toml"));
    std::fs::write(&path, text).unwrap();
    ExperimentConfig::read(&path).map_err(|e| with_causes(&e))
}

pub fn run(config: &ExperimentConfig, out: &Path, resume: bool) -> Result<RunReport, String> {
    run_until(config, out, resume, false)
}

/// As `run`, and with `stop` ended at the first chance.
pub fn run_until(
    config: &ExperimentConfig,
    out: &Path,
    resume: bool,
    stop: bool,
) -> Result<RunReport, String> {
    let options = RunOptions {
        out: out.to_owned(),
        resume,
        console: None,
        stop: Arc::new(AtomicBool::new(stop)),
        device: candle_core::Device::Cpu,
        commit: None,
    };
    train(config, &options).map_err(|e| with_causes(&e))
}

/// The weights that a run ended with.
pub fn exported(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("model/model.safetensors")).unwrap()
}

/// The record of a run.
pub fn record(out: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(out.join("run.json")).unwrap()).unwrap()
}

#[test]
fn contents_count_where_paths_may_change() {
    let data = Data::new();
    let out = data.path().join("run");
    let config = data.experiment(&text("language")).unwrap();
    run(&config, &out, false).unwrap();
    let weights = exported(&out);
    // The same scenes elsewhere.
    std::fs::rename(data.path().join("halls"), data.path().join("elsewhere")).unwrap();
    let moved = text("language").replace("DATA/halls", "DATA/elsewhere");
    run(&data.experiment(&moved).unwrap(), &out, true).unwrap();
    assert!(exported(&out) == weights, "other bits");
    // Other scenes in the same place.
    std::fs::rename(data.path().join("elsewhere"), data.path().join("halls")).unwrap();
    std::fs::rename(data.path().join("halls/one"), data.path().join("halls/attic")).unwrap();
    let error = run(&config, &out, true).unwrap_err();
    assert!(error.contains("train[1].source.scenes was"), "{error}");
}

#[test]
fn training_on_nothing_is_an_error() {
    let data = Data::new();
    let out = data.path().join("run");
    let source = r#"{ type = "synthetic", count = 4, seed = 1, room = { num_gaussians = 500 } }"#;
    let from = |source_of_none: &str| {
        let text = text("segmentation");
        assert!(text.contains(source));
        let config = data.experiment(&text.replace(source, source_of_none)).unwrap();
        run(&config, &out, false).unwrap_err()
    };
    let error = from(&source.replace("500", "0"));
    assert!(error.contains("nothing to train on") || error.contains("num_gaussians"), "{error}");
    // Rows, but not one label.
    for id in ["hall", "kitchen"] {
        let mut scene = generate(&SyntheticRoomSettings::with_count(100, 1)).unwrap().scene;
        scene.segment = Some(vec![-1; scene.len()]);
        let folder = data.path().join("unlabelled").join(id);
        std::fs::create_dir_all(folder.parent().unwrap()).unwrap();
        write_npy_folder(&scene, &folder, false).unwrap();
    }
    let error = from(r#"{ type = "generic", root = "DATA/unlabelled" }"#);
    assert!(error.contains("nothing to train on"), "{error}");
    assert!(error.contains("hall") && error.contains("kitchen"), "{error}");
}

#[test]
fn repairs_are_recorded() {
    let data = Data::new();
    let out = data.path().join("run");
    let text = text("folders").replace("DATA/halls", "DATA/spoiled");
    run(&data.experiment(&text).unwrap(), &out, false).unwrap();
    let record = record(&out);
    let hall = &record["data"]["train"]["repaired"]["hall"];
    assert_eq!(hall["dropped_rows"], 2, "{record}");
    assert!(hall["reasons"][0].as_str().unwrap().starts_with("2 rows: "), "{record}");
    assert_eq!(record["commit"], "unknown");
    let log = std::fs::read_to_string(out.join("metrics.jsonl")).unwrap();
    assert!(log.contains(r#""name":"data/train/dropped_rows","value":2.0"#), "{log}");
}

#[test]
fn measurements_are_known_before_the_first_step() {
    let data = Data::new();
    let with = |best: &str| {
        let text = text("language")
            .replace("[[evaluate]]", &format!("checkpoint.best = {best}\n[[evaluate]]"));
        let out = data.path().join("run");
        (run(&data.experiment(&text).unwrap(), &out, false), out.join("checkpoints"))
    };
    let (error, checkpoints) = with("\"unseen/miou\"");
    let error = error.unwrap_err();
    assert!(error.contains("checkpoint.best") && error.contains("unseen/f-mIoU"), "{error}");
    assert!(!checkpoints.exists());
    let (done, checkpoints) = with("[\"unseen/mIoU\", \"unseen/allAcc\"]");
    done.unwrap();
    let best = std::fs::read_to_string(checkpoints.join("best.json")).unwrap();
    assert!(best.contains("mean of unseen/mIoU, unseen/allAcc"), "{best}");
}

/// The effects that the training scenes show are written into the record, which is the same run again.
#[test]
fn measured_effects_are_those_of_the_scenes() {
    let data = Data::new();
    let steps = r#"transforms = [
  { type = "center_shift" },
  { type = "measured_effects", most = "surface=5,holes=2" },
  { type = "grid_sample", grid_size = 0.3 },
]"#;
    let rough = "count = 2, effects = \"surface=4\", seed = 1, room = { num_gaussians = 3000 } }";
    let text = text("language")
        .replacen("transforms = \"language_pretraining\"", steps, 1)
        .replacen("count = 4, seed = 1, room = { num_gaussians = 500 } }", rough, 1);
    let config = data.experiment(&text).unwrap();
    let out = data.path().join("measured");
    run(&config, &out, false).unwrap();
    let first = exported(&out);
    run(&config, &out, true).unwrap();
    assert!(exported(&out) == first);

    // One entry for each of the two scenes.
    let written = std::fs::read_to_string(out.join("config.toml")).unwrap();
    let stored = serde_json::to_value(data.experiment(&written).unwrap()).unwrap();
    let found = stored["train"][0]["transforms"][1]["found"].as_array().unwrap();
    let severity = |text: &Value| -> f64 {
        let text = text.as_str().unwrap();
        text.strip_prefix("surface=").unwrap_or_else(|| panic!("{text}")).parse().unwrap()
    };
    assert!(found.len() == 2 && found.iter().all(|s| severity(s) > 2.0), "{found:?}");
    // The record by itself is the same run; one that finds something else is another.
    run(&data.experiment(&written).unwrap(), &out, true).unwrap();
    let other = written.replacen("found = [", "found = [\"none\",", 1);
    assert_ne!(other, written);
    let error = run(&data.experiment(&other).unwrap(), &out, true).unwrap_err();
    assert!(error.contains("train[0].transforms"), "{error}");
}

//! An experiment goes on only as what it began: every setting is changed once, and each is refused by
//! its name unless it is in the list of those that may change. And settings reach what they set.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

use scenesplat::experiment::{ExperimentConfig, MAY_CHANGE, RunOptions, train};
use scenesplat::trainers::TrainerConfig;
use serde_json::{Value, json};
use std::path::Path;

/// A small network, and every kind of setting that a language experiment has.
const LANGUAGE: &str = r#"
task = "language_pretraining"
targets = "class_text"
precision = "f32"
model_seed = 3
mix = "proportional"
text = { type = "vocabulary", dim = 64, exclude = ["wall"] }
[model]
grid_size = 0.3
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [64, 64]
dec_depths = [1]
dec_channels = [16]
dec_num_head = [2]
dec_patch_size = [64]
drop_path = 0.1
projection = 64
[input]
channels = ["color", "opacity", "quat", "scale"]
[[train]]
source = { type = "synthetic", count = 2, seed = 1, vocabulary = 64, room = { num_gaussians = 400 } }
transforms = "language_pretraining"
seed = 2
[[train]]
source = { type = "generic", root = "data", segment = "label", limit = 5, excluded_scenes = ["x"] }
transforms = [
  { type = "center_shift" },
  { type = "random_dropout" },
  { type = "random_rotate" },
  { type = "random_rotate_target_angle" },
  { type = "random_scale" },
  { type = "random_flip" },
  { type = "random_jitter" },
  { type = "elastic_distortion" },
  { type = "chromatic_auto_contrast" },
  { type = "chromatic_translation" },
  { type = "chromatic_jitter" },
  { type = "grid_sample", grid_size = 0.3 },
  { type = "sphere_crop", point_max = 300 },
]
weight = 2
[loader]
workers = 1
batch_size = 1
[[losses]]
type = "cosine"
weight = 0.2
[[losses]]
type = "aggregated_contrastive"
schedule = { last = 75.0 }
min_points = 5
[[losses]]
type = "text_classification"
[optimizer]
groups = [{ keyword = "block", lr = 0.001 }]
weight_decay_schedule = { warmup = 0.0, warmup_from = 0.04, from = 0.04, to = 0.4 }
[schedule]
type = "one_cycle"
[trainer]
epochs = 1
clip_norm = 1.0
ema = 0.9
max_left_out = 1.0
[trainer.checkpoint]
best = "unseen/mIoU"
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 400 } }
vote_k = 3
[early_stopping]
measurement = "unseen/mIoU"
patience = 3
"#;

/// What the other task has besides.
const SEGMENTATION: &str = r#"
task = "semantic_segmentation"
[model]
grid_size = 0.3
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [64, 64]
dec_depths = [1]
dec_channels = [16]
dec_num_head = [2]
dec_patch_size = [64]
num_classes = 41
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 400 } }
transforms = "semantic_segmentation"
[loader]
workers = 1
mix_probability = 0.0
batch_size = 1
[[losses]]
type = "cross_entropy"
[[losses]]
type = "lovasz_softmax"
[schedule]
type = "cosine"
warmup = 0.1
warmup_from = 0.1
from = 1.0
to = 0.0
[trainer]
epochs = 2
[trainer.checkpoint]
keep = 2
"#;

/// A student of the network inside the program.
const DISTILLATION: &str = r#"
task = "distillation"
text = { type = "vocabulary", dim = 96 }
[teacher]
type = "network"
weights = "embedded"
cache = { folder = "rows" }
[model]
grid_size = 0.3
stride = [2]
enc_depths = [1, 1]
enc_channels = [8, 16]
enc_num_head = [1, 2]
enc_patch_size = [64, 64]
dec_depths = [1]
dec_channels = [16]
dec_num_head = [2]
dec_patch_size = [64]
projection = 96
[[train]]
source = { type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 400 } }
transforms = "language_pretraining"
[loader]
workers = 1
mix_probability = 0.0
batch_size = 1
[[losses]]
type = "cosine"
[[losses]]
type = "smooth_l1"
beta = 0.5
[optimizer]
groups = []
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 400 } }
"#;

/// A scene of a few labelled Gaussians as text.
fn write_scene(path: &Path, seed: u32) {
    let names = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
        "rot_0", "rot_1", "rot_2", "rot_3",
    ];
    let mut text = "ply\nformat ascii 1.0\nelement vertex 400\n".to_owned();
    names.iter().for_each(|n| text.push_str(&format!("property float {n}\n")));
    text.push_str("property int label\nend_header\n");
    for i in 0..400_u32 {
        let noise = |k: u32| {
            f64::from((i * 37 + k * 101 + seed * 7).wrapping_mul(2_654_435) % 1000) / 1000.0
        };
        let at = [4.0 * noise(0), 3.0 * noise(1), 2.0 * noise(2)];
        let rest = [noise(3), noise(4), noise(5), 1.0, -4.0, -4.0, -4.0, 1.0, 0.1, 0.2, 0.3];
        at.iter().chain(&rest).for_each(|v| text.push_str(&format!("{v} ")));
        text.push_str(&format!("{}\n", i % 5));
    }
    std::fs::write(path, text).unwrap();
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for data in ["data", "moved"] {
        std::fs::create_dir(folder.path().join(data)).unwrap();
        write_scene(&folder.path().join(data).join("hall.ply"), 1);
        write_scene(&folder.path().join(data).join("kitchen.ply"), 2);
    }
    folder
}

fn read(folder: &Path, text: &str) -> ExperimentConfig {
    let path = folder.join("experiment.toml");
    std::fs::write(&path, text).unwrap();
    ExperimentConfig::read(&path).unwrap()
}

fn run(config: &ExperimentConfig, out: &Path, resume: bool) -> Result<(), String> {
    let (out, stop) = (out.to_owned(), Default::default());
    let options = RunOptions {
        out,
        resume,
        quiet: true,
        stop,
        device: candle_core::Device::Cpu,
        commit: None,
    };
    train(config, &options).map(|_| ()).map_err(|e| format!("{:#}", anyhow::Error::from(e)))
}

/// Paths of all leaves: `/train/0/source/count`, as JSON pointers.
fn leaves(value: &Value, path: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(name, v)| leaves(v, &format!("{path}/{name}"), found));
        }
        Value::Array(entries) if entries.iter().any(Value::is_object) => {
            entries.iter().enumerate().for_each(|(i, v)| leaves(v, &format!("{path}/{i}"), found));
        }
        _ => found.push(path.to_owned()),
    }
}

/// `/train/0/source/count` as `train[0].source.count`.
fn setting(pointer: &str) -> String {
    let mut name = String::new();
    for part in pointer.split('/').skip(1) {
        match part.parse::<usize>() {
            Ok(i) => name.push_str(&format!("[{i}]")),
            Err(_) if name.is_empty() => name.push_str(part),
            Err(_) => name.push_str(&format!(".{part}")),
        }
    }
    name
}

/// Other values that may stand for `value`.
fn others(value: &Value) -> Vec<Value> {
    let words = [
        "bf16",
        "f32",
        "features",
        "class_text",
        "main_first",
        "sum",
        "mean",
        "always",
        "skip",
        "max",
        "isolated",
        "scene",
        "shared_depth",
        "labels",
        "off",
        "argmax",
        "validation",
        "language_pretraining",
        "semantic_segmentation",
        "strict",
        "stop",
        "z",
        "x",
        "y",
        "test",
        "first",
        "moved",
        "unseen/mAcc",
        "unseen/f-mIoU",
        "other",
    ];
    let mut found: Vec<Value> = match value {
        Value::Bool(b) => vec![json!(!b)],
        Value::Number(n) if n.is_u64() || n.is_i64() => {
            let n = n.as_i64().unwrap();
            vec![json!(n + 1), json!(n * 2), json!(n - 1)]
        }
        Value::Number(n) => {
            let n = n.as_f64().unwrap();
            vec![json!(n * 0.5), json!(n + 0.25), json!(n * 2.0)]
        }
        Value::String(s) => words
            .iter()
            .filter(|w| *w != s)
            .map(|w| json!(w))
            .chain([json!(format!("{s}2"))])
            .collect(),
        Value::Null => {
            [json!(1), json!(0.5), json!("unseen/mAcc"), json!(true), json!([0.5, 0.5])].to_vec()
        }
        _ => Vec::new(),
    };
    if let Value::Array(list) = value {
        let mut shorter = list.clone();
        let last = shorter.pop();
        if let Some(last) = last {
            let with = |v: Value| json!([shorter.clone(), vec![v]].concat());
            found.extend(others(&last).into_iter().map(with));
            found.push(json!(shorter));
        }
        found.push(json!([list.clone(), vec![json!("bias")]].concat()));
        found.push(json!([list.clone(), vec![json!([0.25, 0.75])]].concat()));
    }
    found
}

/// Whether a setting is in the list, by its name.
fn may_change(setting: &str) -> bool {
    let digits: String = setting.chars().filter(|c| !c.is_ascii_digit()).collect();
    let name = digits.replace("[]", "[*]");
    let inside = |listed: &str| {
        name.strip_prefix(listed)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
    };
    // A preset may be written out; what the steps do may not change, so another preset is another run.
    if name.contains(".transforms[") || name.ends_with(".transforms") {
        return false;
    }
    MAY_CHANGE.iter().any(|(listed, _)| inside(listed))
        || TrainerConfig::MAY_CHANGE.iter().any(|listed| inside(&format!("trainer.{listed}")))
}

fn walk(text: &str, folder: &Path) -> (usize, Vec<String>) {
    let out = folder.join("run");
    let config = read(folder, text);
    run(&config, &out, false).unwrap();
    run(&config, &out, true).unwrap();
    let model = || std::fs::read(out.join("model/model.safetensors")).unwrap();
    let weights = model();
    let plain = serde_json::to_value(&config).unwrap();
    let mut all = Vec::new();
    leaves(&plain, "", &mut all);
    let (mut refused, mut wrong) = (0, Vec::new());
    for pointer in &all {
        let name = setting(pointer);
        let candidates = others(plain.pointer(pointer).unwrap());
        let mut changed = candidates.into_iter().filter_map(|value| {
            let mut all = plain.clone();
            *all.pointer_mut(pointer).unwrap() = value;
            let config: ExperimentConfig = serde_json::from_value(all).ok()?;
            // Refused as it stands, or no change at all, says nothing about resuming.
            (config.check().is_ok() && serde_json::to_value(&config).unwrap() != plain)
                .then_some(config)
        });
        let Some(mut changed) = changed.next() else {
            // A setting with one legal value here.
            continue;
        };
        if let Some(root) = name.ends_with("source.root").then_some(folder.join("moved")) {
            let mut all = plain.clone();
            *all.pointer_mut(pointer).unwrap() = json!(root);
            changed = serde_json::from_value(all).unwrap();
        }
        let record = std::fs::read(out.join("config.toml")).unwrap();
        let outcome = run(&changed, &out, true);
        match (&outcome, may_change(&name)) {
            (Ok(()), true) => {}
            (Err(error), true) if !error.contains("cannot be continued") => {}
            (Err(error), false) if error.contains(&name) => {
                refused += 1;
                assert_eq!(std::fs::read(out.join("config.toml")).unwrap(), record, "{name}");
            }
            // Another check was first: a file that is not there, a width that does not fit.
            (Err(error), false) if !error.contains("cannot be continued") => {}
            _ => wrong.push(format!("{name}: {outcome:?}")),
        }
    }
    run(&config, &out, true).unwrap();
    assert!(weights == model(), "other bits");
    (refused, wrong)
}

#[test]
fn every_setting_is_refused_by_name_unless_it_may_change() {
    for (text, least) in [(LANGUAGE, 100), (SEGMENTATION, 50), (DISTILLATION, 40)] {
        let folder = folder();
        let (refused, wrong) = walk(text, folder.path());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
        assert!(refused >= least, "only {refused} settings were changed");
        println!("{refused} settings refused by name");
    }
}

#[test]
fn contents_count_where_paths_may_change() {
    let folder = folder();
    let out = folder.path().join("run");
    let config = read(folder.path(), LANGUAGE);
    run(&config, &out, false).unwrap();
    // The same scenes elsewhere.
    let moved = read(folder.path(), &LANGUAGE.replace("\"data\"", "\"moved\""));
    run(&moved, &out, true).unwrap();
    // Other scenes in the same place.
    let hall = folder.path().join("data/hall.ply");
    std::fs::rename(&hall, folder.path().join("data/attic.ply")).unwrap();
    let error = run(&config, &out, true).unwrap_err();
    assert!(error.contains("train[1].source.scenes was"), "{error}");
}

/// Sums of the values of all exported parameters by name.
fn exported(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("model/model.safetensors")).unwrap()
}

#[test]
fn settings_reach_what_they_set() {
    let folder = folder();
    // Constant from the first step on, so that nothing is hidden by a warm-up.
    let base = LANGUAGE.replace("drop_path = 0.1", "drop_path = 0.3");
    let weights = |text: &str, name: &str| {
        let out = folder.path().join(name);
        run(&read(folder.path(), text), &out, false).unwrap_or_else(|e| panic!("{name}: {e}"));
        exported(&out)
    };
    let plain = weights(&base, "plain");
    assert!(plain == weights(&base, "again"), "the same settings give the same bits");
    for (from, to) in [
        ("precision = \"f32\"", "precision = \"bf16\""),
        ("model_seed = 3", "model_seed = 4"),
        ("seed = 2\n", "seed = 7\n"),
        ("epochs = 1", "epochs = 1\nseed = 7"),
        ("drop_path = 0.3", "drop_path = 0.1"),
        ("weight = 0.2", "weight = 0.3"),
        ("{ last = 75.0 }", "\"skip\""),
        ("clip_norm = 1.0", "clip_norm = 0.01"),
        ("ema = 0.9", "ema = 0.05"),
        ("lr = 0.001", "lr = 0.002"),
        ("from = 0.04, to", "from = 0.4, to"),
        ("clip_norm = 1.0", "clip_norm = 1.0\naccumulate = 2"),
        ("clip_norm = 1.0", "clip_norm = 1.0\nfreeze = [\"embedding\"]"),
        ("weight = 2\n", "weight = 1\n"),
    ] {
        assert!(base.contains(from), "{from}");
        let changed = weights(&base.replace(from, to), &to.replace(['"', '\n', ' '], ""));
        assert!(changed != plain, "{to} had no effect");
    }
    // The scenes have no features of their own.
    let text = base.replace("\"class_text\"", "\"features\"");
    let error = run(&read(folder.path(), &text), &folder.path().join("targets"), false);
    assert!(error.unwrap_err().contains("lang_feat"));
    // Two scenes have two orders: one of several seeds takes the other.
    let reordered = (7..15).any(|seed| {
        let text = base.replace("workers = 1", &format!("workers = 1\nseed = {seed}"));
        weights(&text, &format!("loader{seed}")) != plain
    });
    assert!(reordered, "loader.seed had no effect");
}

#[test]
fn training_on_nothing_is_an_error() {
    let folder = folder();
    let text = SEGMENTATION.replace("num_gaussians = 400", "num_gaussians = 0");
    let error = run(&read(folder.path(), &text), &folder.path().join("run"), false).unwrap_err();
    assert!(error.contains("nothing to train on") || error.contains("num_gaussians"), "{error}");
    // Rows, but not one label.
    let scene = folder.path().join("data/hall.ply");
    for name in ["hall.ply", "kitchen.ply"] {
        let path = scene.with_file_name(name);
        let text = std::fs::read_to_string(&path).unwrap();
        let (head, rows) = text.split_once("end_header\n").unwrap();
        let rows: String =
            rows.lines().map(|row| format!("{} -1\n", row.rsplit_once(' ').unwrap().0)).collect();
        std::fs::write(&path, format!("{head}end_header\n{rows}")).unwrap();
    }
    let source = r#"{ type = "synthetic", count = 2, seed = 1, room = { num_gaussians = 400 } }"#;
    assert!(SEGMENTATION.contains(source));
    let text =
        SEGMENTATION.replace(source, r#"{ type = "generic", root = "data", segment = "label" }"#);
    let error = run(&read(folder.path(), &text), &folder.path().join("run2"), false).unwrap_err();
    assert!(error.contains("nothing to train on"), "{error}");
    assert!(error.contains("hall") && error.contains("kitchen"), "{error}");
}

#[test]
fn repairs_are_told() {
    let folder = folder();
    let path = folder.path().join("data/hall.ply");
    let text = std::fs::read_to_string(&path).unwrap();
    let (head, rows) = text.split_once("end_header\n").unwrap();
    let spoiled: String = rows
        .lines()
        .enumerate()
        .map(|(i, row)| match i {
            0..30 => format!("nan {}\n", row.split_once(' ').unwrap().1),
            _ => format!("{row}\n"),
        })
        .collect();
    std::fs::write(&path, format!("{head}end_header\n{spoiled}")).unwrap();
    let out = folder.path().join("run");
    run(&read(folder.path(), LANGUAGE), &out, false).unwrap();
    let record: Value =
        serde_json::from_slice(&std::fs::read(out.join("run.json")).unwrap()).unwrap();
    let hall = &record["data"]["train"]["repaired"]["hall.ply"];
    assert_eq!(hall["dropped_rows"], 30, "{record}");
    assert!(hall["reasons"][0].as_str().unwrap().starts_with("30 rows: "), "{record}");
    assert_eq!(record["commit"], "unknown");
    let log = std::fs::read_to_string(out.join("metrics.jsonl")).unwrap();
    assert!(log.contains(r#""name":"data/train/dropped_rows","value":30.0"#), "{log}");
    // A smaller share is allowed than was left out.
    let strict = LANGUAGE.replace("max_left_out = 1.0", "max_left_out = 0.01");
    let error = run(&read(folder.path(), &strict), &folder.path().join("b"), false).unwrap_err();
    assert!(error.contains("30 of") && error.contains("hall.ply"), "{error}");
}

#[test]
fn misspelt_measurements_are_refused_before_the_first_step() {
    let folder = folder();
    for (from, to, place) in [
        ("best = \"unseen/mIoU\"", "best = \"unseen/miou\"", "checkpoint.best"),
        (
            "measurement = \"unseen/mIoU\"",
            "measurement = \"seen/mIoU\"",
            "early_stopping.measurement",
        ),
    ] {
        let out = folder.path().join("run");
        let error =
            run(&read(folder.path(), &LANGUAGE.replace(from, to)), &out, false).unwrap_err();
        assert!(error.contains(place) && error.contains("unseen/f-mIoU"), "{error}");
        assert!(!out.join("checkpoints").exists());
    }
    let mean = "best = [\"unseen/mIoU\", \"unseen/allAcc\"]";
    let text = LANGUAGE.replace("best = \"unseen/mIoU\"", mean);
    let out = folder.path().join("mean");
    run(&read(folder.path(), &text), &out, false).unwrap();
    let best = std::fs::read_to_string(out.join("checkpoints/best.json")).unwrap();
    assert!(best.contains("mean of unseen/mIoU, unseen/allAcc"), "{best}");
}

/// What is found in the training scenes is written down, and is found again.
#[test]
fn measured_effects_are_those_of_the_scenes_and_a_run_that_goes_on_has_the_same() {
    let folder = folder();
    let steps = r#"transforms = [
  { type = "center_shift" },
  { type = "measured_effects", most = "surface=5,holes=2" },
  { type = "grid_sample", grid_size = 0.3 },
]"#;
    let rough = "effects = \"surface=4\", room = { num_gaussians = 3000 } }";
    let text = LANGUAGE.replacen("transforms = \"language_pretraining\"", steps, 1).replacen(
        "room = { num_gaussians = 400 } }",
        rough,
        1,
    );
    let config = read(folder.path(), &text);
    let out = folder.path().join("measured");
    run(&config, &out, false).unwrap();
    let model = |out: &Path| std::fs::read(out.join("model/model.safetensors")).unwrap();
    let first = model(&out);
    run(&config, &out, true).unwrap();
    assert_eq!(model(&out), first);

    // One entry for each of the two scenes.
    let written = std::fs::read_to_string(out.join("config.toml")).unwrap();
    let stored: Value = serde_json::to_value(read(folder.path(), &written)).unwrap();
    let found = &stored["train"][0]["transforms"][1]["found"];
    let severity = |text: &Value| -> f64 {
        let text = text.as_str().unwrap();
        text.strip_prefix("surface=").unwrap_or_else(|| panic!("{text}")).parse().unwrap()
    };
    let found: Vec<f64> = found.as_array().unwrap().iter().map(severity).collect();
    assert!(found.len() == 2 && found.iter().all(|s| *s > 2.0), "{found:?}");
    // The record by itself is the same run; one that finds something else is another.
    let again = folder.path().join("again");
    run(&read(folder.path(), &written), &again, false).unwrap();
    assert_eq!(model(&again), first);
    let other = written.replacen("found = [", "found = [\"none\",", 1);
    assert_ne!(other, written);
    let error = run(&read(folder.path(), &other), &again, true).unwrap_err();
    assert!(error.contains("train[0].transforms"), "{error}");
}

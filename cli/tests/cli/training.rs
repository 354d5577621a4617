//! `scenesplat train`, and the network inside the program.

use crate::{done, scenesplat, stderr};
use std::path::Path;

/// A few steps of a tiny network on tiny rooms.
pub const EXPERIMENT: &str = r#"
task = "semantic_segmentation"
[model]
grid_size = 0.15
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
source = { type = "synthetic", count = 4, seed = 1, room = { num_gaussians = 1500 } }
transforms = "semantic_segmentation"
repeat = 2
[loader]
workers = 1
mix_probability = 0.5
[[losses]]
type = "cross_entropy"
[[losses]]
type = "lovasz_softmax"
[trainer]
epochs = 2
log_every = 1
[trainer.checkpoint]
best = "unseen/mIoU"
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 2, seed = 9, room = { num_gaussians = 1500 } }
"#;

fn train(config: &Path, out: &Path, more: &[&str]) -> std::process::Output {
    let mut args = vec!["train", config.to_str().unwrap(), "--out", out.to_str().unwrap()];
    args.extend(more);
    scenesplat(&args)
}

#[test]
fn a_run_leaves_what_it_promises_and_its_weights_work() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("experiment.toml");
    std::fs::write(&config, EXPERIMENT).unwrap();
    let out = folder.path().join("run");
    let output = train(&config, &out, &[]);
    done(&output);
    assert!(stderr(&output).contains("step 8/8"), "{}", stderr(&output));
    for name in [
        "config.toml",
        "run.json",
        "metrics.jsonl",
        "curves.png",
        "curves.html",
        "model/config.json",
    ] {
        assert!(out.join(name).is_file(), "{name}");
    }
    let log = String::from_utf8(bytes(&out.join("metrics.jsonl"))).unwrap();
    assert_eq!(log.lines().filter(|l| l.contains("train/lovasz_softmax")).count(), 8);
    assert_eq!(log.lines().filter(|l| l.contains("unseen/mIoU")).count(), 2);
    // A run is not overwritten by another one.
    let again = train(&config, &out, &[]);
    assert_eq!(again.status.code(), Some(1));
    assert!(stderr(&again).contains("--resume"), "{}", stderr(&again));
    done(&train(&config, &out, &["--resume"]));
    // Neither is a resumed one another one.
    let resumed = train(&config, &out, &["--resume", "--seed", "5"]);
    assert!(stderr(&resumed).contains("seed was 0 and is 5"), "{}", stderr(&resumed));

    let names = folder.path().join("names.txt");
    let classes = scenesplat::rooms::CLASSES.iter().map(|c| c.name);
    std::fs::write(&names, classes.collect::<Vec<_>>().join("\n")).unwrap();
    let (model, labels) = (out.join("model"), folder.path().join("labels"));
    done(&scenesplat(&[
        "evaluate",
        "synthetic:1:3",
        "--weights",
        model.to_str().unwrap(),
        "--text-names",
        names.to_str().unwrap(),
        "--out",
        labels.to_str().unwrap(),
    ]));
}

/// A tiny student of the network inside the program.
const DISTILLATION: &str = r#"
task = "distillation"
[teacher]
type = "network"
weights = "embedded"
cache = { folder = "rows" }
[model]
grid_size = 0.2
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
[text]
type = "vocabulary"
dim = 96
[[train]]
source = { type = "synthetic", count = 4, seed = 1, room = { num_gaussians = 1500 } }
transforms = "language_pretraining"
[loader]
mix_probability = 0.5
[[losses]]
type = "cosine"
[[losses]]
type = "l2"
weight = 0.5
[optimizer]
lr = 0.01
groups = []
[trainer]
epochs = 6
log_every = 1
[[evaluate]]
name = "unseen"
source = { type = "synthetic", count = 1, seed = 9, room = { num_gaussians = 1500 } }
"#;

#[test]
fn a_student_learns_from_a_teacher() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("student.toml");
    std::fs::write(&config, DISTILLATION).unwrap();
    let (one, two) = (folder.path().join("one"), folder.path().join("two"));
    done(&train(&config, &one, &["--threads", "1"]));
    done(&train(&config, &two, &["--threads", "2"]));
    let weights = |out: &Path| bytes(&out.join("model/model.safetensors"));
    assert!(weights(&one) == weights(&two), "other bits with other threads");
    let log = String::from_utf8(bytes(&one.join("metrics.jsonl"))).unwrap();
    let log: Vec<serde_json::Value> =
        log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let values = |name: &str| -> Vec<f64> {
        let of = log.iter().filter(|m| m["name"] == name);
        of.map(|m| m["value"].as_f64().unwrap()).collect()
    };
    let losses = values("train/cosine");
    assert_eq!(losses.len(), 12);
    assert!(losses[11] < 0.9 * losses[0], "{losses:?}");
    let (agreement, teacher) = (values("unseen/agreement/cosine"), values("unseen/teacher/allAcc"));
    assert!(agreement[5] > agreement[0], "{agreement:?}");
    // The same teacher on the same room, epoch after epoch; it knows rooms, though few Gaussians are far
    // from what it was trained on: five times better than one of 41 classes by chance.
    assert!(
        teacher.len() == 6 && teacher.iter().all(|v| *v == teacher[0] && *v > 5.0 / 41.0),
        "{teacher:?}"
    );
    assert_eq!(values("unseen/oracle/f-mIoU").len(), 6);
    // Its rows of the room were computed once and read ever after.
    let record = |out: &Path| -> serde_json::Value {
        serde_json::from_slice(&bytes(&out.join("run.json"))).unwrap()
    };
    let (first, second) = (record(&one), record(&two));
    assert_eq!(first["teacher"]["cache"]["kept"], 1, "{first}");
    assert_eq!(first["teacher"]["cache"]["read"], 5);
    assert_eq!(second["teacher"]["cache"]["read"], 6);
    assert!(first["teacher"]["content"].as_str().is_some_and(|text| text.contains("sha256")));
    // A student is a network like any other.
    let (model, labels) = (one.join("model"), folder.path().join("labels"));
    let (model, labels) = (model.to_str().unwrap(), labels.to_str().unwrap());
    let words = ["--weights", model, "--text", "vocabulary", "--out", labels];
    done(&scenesplat(&[["evaluate", "synthetic:1:3"].as_slice(), &words].concat()));
}

#[test]
fn wrong_experiments_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("experiment.toml");
    let problem = |from: &str, to: &str| {
        assert!(EXPERIMENT.contains(from));
        std::fs::write(&config, EXPERIMENT.replace(from, to)).unwrap();
        let output = train(&config, &folder.path().join("run"), &[]);
        assert_eq!(output.status.code(), Some(1), "{to}");
        stderr(&output)
    };
    assert!(problem("epochs = 2", "epoch = 2").contains("epoch"));
    assert!(problem("\"lovasz_softmax\"", "\"lovas\"").contains("lovas"));
    assert!(problem("num_classes = 41\n", "").contains("num_classes"));
    assert!(problem("grid_size = 0.15", "in_channels = 14").contains("in_channels is 14"));
    assert!(problem("\"semantic_segmentation\"\nrepeat", "\"fancy\"\nrepeat").contains("fancy"));
    assert!(!folder.path().join("run/checkpoints").exists());
    std::fs::write(&config, EXPERIMENT).unwrap();
    let output = train(&config, &folder.path().join("run"), &["--check"]);
    done(&output);
    assert!(String::from_utf8_lossy(&output.stdout).contains("lovasz_softmax"));
}

#[test]
fn the_network_inside_the_program_answers_without_any_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo");
    let output = scenesplat(&["demo", "--out", out.to_str().unwrap(), "--quiet"]);
    done(&output);
    assert!(String::from_utf8_lossy(&output.stdout).contains("f-mIoU"));
    for name in ["room.ply", "segmented.ply", "labels.npy", "preview.png", "truth.png"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    let room = out.join("room.ply");
    let query = |text: &str| {
        let place = folder.path().join("query");
        scenesplat(&["query", room.to_str().unwrap(), text, "--out", place.to_str().unwrap()])
    };
    done(&query("furniture"));
    let unknown = query("spaceship");
    assert_eq!(unknown.status.code(), Some(2));
    assert!(stderr(&unknown).contains("spaceship"), "{}", stderr(&unknown));

    let json = folder.path().join("figures.json");
    let place = folder.path().join("evaluation");
    done(&scenesplat(&[
        "evaluate",
        "synthetic:2:7",
        "--json",
        json.to_str().unwrap(),
        "--out",
        place.to_str().unwrap(),
    ]));
    let figures: serde_json::Value = serde_json::from_slice(&bytes(&json)).unwrap();
    for key in ["f_miou", "f_macc", "miou", "macc", "seconds"] {
        assert!(figures[key].as_f64().is_some_and(f64::is_finite), "{key}");
    }
    assert!(figures["oracle"]["miou"].as_f64() > figures["miou"].as_f64());
    assert!(figures["per_class"].as_array().is_some_and(|c| c.len() > 10));

    // A network trained with the same words is told by `--text vocabulary`.
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/../assets/embedded");
    let again = folder.path().join("again.json");
    done(&scenesplat(&[
        "evaluate",
        "synthetic:2:7",
        "--weights",
        model,
        "--text",
        "vocabulary",
        "--json",
        again.to_str().unwrap(),
        "--out",
        place.to_str().unwrap(),
    ]));
    let same: serde_json::Value = serde_json::from_slice(&bytes(&again)).unwrap();
    assert_eq!(same["per_class"], figures["per_class"]);
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

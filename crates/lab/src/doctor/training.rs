//! Level 3: short trainings on generated rooms.

use super::case::Case;
use super::inputs::files::{columns, little, with};
use super::table::case;
use super::trial::{Failure, Trial, ensure};
use candle_core::{DType, Device, Tensor};
use scenesplat::experiment::{ExperimentConfig, RunOptions, RunReport, train};
use scenesplat_trainers::callbacks::read_json_lines;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Two scales, six steps.
const EXPERIMENT: &str = r#"
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
source = { type = "synthetic", count = 3, seed = 1, room = { num_gaussians = 400 } }
transforms = "semantic_segmentation"
[loader]
workers = 1
batch_size = 1
[[losses]]
type = "cross_entropy"
[[losses]]
type = "lovasz_softmax"
[trainer]
epochs = 2
log_every = 1
ema = 0.9
[trainer.checkpoint]
keep = 5
every_steps = 2
"#;

/// Forms of a run: name, what is replaced in the experiment, and by what.
const FORMS: [(&str, &str, &str); 7] = [
    ("f32", "log_every = 1", "log_every = 1"),
    (
        "bf16",
        "[model]",
        "precision = \"bf16\"
[model]",
    ),
    (
        "split",
        "[model]",
        "precision = \"split\"
[model]",
    ),
    ("accumulated", "ema = 0.9", "accumulate = 3"),
    ("recomputed", "ema = 0.9", "recompute = true"),
    ("uneven-batches", "batch_size = 1", "batch_size = 2"),
    (
        "huge-rate",
        "[trainer]",
        "[optimizer]
lr = 1000.0
[trainer]
clip_norm = 1.0",
    ),
];

/// Settings that a run cannot go on with: name, word of the refusal, what is replaced, and by what.
const OTHERS: [(&str, &str, &str, &str); 4] = [
    ("patch", "enc_patch_size", "enc_patch_size = [64, 64]", "enc_patch_size = [32, 64]"),
    (
        "loss",
        "losses",
        "\"lovasz_softmax\"",
        "\"lovasz_softmax\"
weight = 0.5",
    ),
    ("voxels", "grid_size", "grid_size = 0.3", "grid_size = 0.4"),
    ("seed", "seed", "seed = 1", "seed = 7"),
];

pub(super) fn cases() -> Vec<Case> {
    let form = |(name, from, to)| {
        case(format!("training-{name}"), move |t| {
            let path = config(t, &EXPERIMENT.replacen(from, to, 1))?;
            finite(t, &start(t, &path, false)?)
        })
    };
    let mut cases: Vec<Case> = FORMS.map(form).into();
    cases.extend([
        case("training-on-threads", |t| {
            let path = config(t, EXPERIMENT)?;
            t.same_on_threads(|| {
                let weights = weights(&start(t, &path, false)?)?;
                std::fs::remove_dir_all(t.folder().join("run"))?;
                Ok(weights)
            })?;
            Ok(())
        }),
        case("resumed-training", |t| {
            let path = config(t, EXPERIMENT)?;
            let whole = weights(&interrupted(t, &path)?)?;
            let resumed = weights(&start(t, &path, true)?)?;
            ensure!(whole == resumed, "another network after going on from step 4");
            Ok(())
        }),
        case("resumed-without-its-average", |t| {
            damaged(t, |average| Ok(std::fs::remove_file(average)?))
        }),
        case("resumed-with-a-nan-in-its-average", |t| {
            damaged(t, |average| {
                let mut bytes = std::fs::read(average)?;
                let end = bytes.len() - 4;
                bytes[end..].copy_from_slice(&f32::NAN.to_le_bytes());
                Ok(std::fs::write(average, bytes)?)
            })
        }),
        case("training-on-nothing", |t| {
            let text = EXPERIMENT.replace("num_gaussians = 400", "num_gaussians = 0");
            let ended = start(t, &config(t, &text)?, false);
            ensure!(ended.is_err(), "a network is trained on nothing");
            Ok(())
        }),
        case("training-data-with-bad-values", bad_data),
    ]);
    cases.extend(OTHERS.map(|(name, word, from, to)| {
        case(format!("resumed-with-another-{name}"), move |t| {
            interrupted(t, &config(t, EXPERIMENT)?)?;
            let ended = start(t, &config(t, &EXPERIMENT.replace(from, to))?, true);
            let named = ended.as_ref().is_err_and(|e| e.0.contains(word));
            ensure!(named, "goes on with {to}, or does not name it: {ended:?}");
            Ok(())
        })
    }));
    cases
}

/// Trains, and removes the checkpoints after step 4, as an interruption would.
fn interrupted(trial: &Trial<'_>, path: &Path) -> Result<RunReport, Failure> {
    let report = start(trial, path, false)?;
    forget(&trial.folder().join("run"), 4)?;
    Ok(report)
}

/// Writes the experiment.
fn config(trial: &Trial<'_>, text: &str) -> Result<PathBuf, Failure> {
    trial.file("experiment.toml", text.as_bytes())
}

fn start(trial: &Trial<'_>, path: &Path, resume: bool) -> Result<RunReport, Failure> {
    let options = RunOptions {
        device: Device::Cpu,
        out: trial.folder().join("run"),
        resume,
        console: None,
        stop: Default::default(),
        commit: None,
    };
    Ok(train(&ExperimentConfig::read(path)?, &options)?)
}

/// The bytes of the exported network.
fn weights(report: &RunReport) -> Result<Vec<u8>, Failure> {
    Ok(std::fs::read(report.model.join("model.safetensors"))?)
}

/// That losses were logged, and are finite with all parameters.
fn finite(trial: &Trial<'_>, report: &RunReport) -> Result<(), Failure> {
    let log = read_json_lines(&trial.folder().join("run/metrics.jsonl"))?;
    let losses: Vec<_> = log.iter().filter(|line| line.name.starts_with("train/")).collect();
    ensure!(!losses.is_empty(), "no loss was logged");
    if let Some(bad) = losses.iter().find(|line| !line.value.is_finite()) {
        return Err(Failure(format!("step {}: {} is {}", bad.step, bad.name, bad.value)));
    }
    let file = report.model.join("model.safetensors");
    let tensors: HashMap<String, Tensor> = candle_core::safetensors::load(file, &Device::Cpu)?;
    ensure!(!tensors.is_empty(), "the network has no parameter");
    let mut names: Vec<&String> = tensors.keys().collect();
    names.sort();
    for name in names {
        let values = tensors[name].to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
        ensure!(values.iter().all(|v| v.is_finite()), "parameter {name} is not finite");
    }
    Ok(())
}

/// Removes the checkpoints after a step, as an interruption would.
fn forget(out: &Path, step: u64) -> Result<(), Failure> {
    let mut left = 0;
    for entry in std::fs::read_dir(out.join("checkpoints"))? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Some(number) = name.strip_prefix("step-") else { continue };
        if number.parse::<u64>()? > step {
            std::fs::remove_dir_all(&path)?;
        } else {
            left += 1;
        }
    }
    ensure!(left > 0, "there is no checkpoint up to step {step}");
    Ok(())
}

/// A run whose last checkpoint's average is damaged must not go on from it.
fn damaged(trial: &Trial<'_>, damage: fn(&Path) -> Result<(), Failure>) -> Result<(), Failure> {
    let path = config(trial, EXPERIMENT)?;
    interrupted(trial, &path)?;
    damage(&trial.folder().join("run/checkpoints/step-000000004/average.safetensors"))?;
    let ended = start(trial, &path, true);
    let named = ended.as_ref().is_err_and(|e| e.0.contains("average.safetensors"));
    ensure!(named, "goes on, or does not name the file: {ended:?}");
    Ok(())
}

/// Scenes with NaN positions and rotations: the run says how many.
fn bad_data(trial: &Trial<'_>) -> Result<(), Failure> {
    let data = trial.folder().join("data");
    std::fs::create_dir(&data)?;
    let mut columns = columns(400);
    for row in (0..400).step_by(40) {
        columns = with(with(columns, "x", row + 7, f32::NAN), "rot_0", row + 9, f32::NAN);
    }
    for scene in ["a.ply", "b.ply"] {
        std::fs::write(data.join(scene), little(&columns))?;
    }
    let text = EXPERIMENT.replace(
        "{ type = \"synthetic\", count = 3, seed = 1, room = { num_gaussians = 400 } }",
        "{ type = \"generic\", root = \"data\" }",
    );
    let report = start(trial, &config(trial, &text)?, false)?;
    let log = read_json_lines(&trial.folder().join("run/metrics.jsonl"))?;
    let counted = |name: &str| log.iter().find(|v| v.name == name).map(|v| v.value);
    for (name, want) in [("data/train/repaired_scenes", 2.0), ("data/train/dropped_rows", 20.0)] {
        ensure!(counted(name) == Some(want), "{name} is {:?}, {want} is right", counted(name));
    }
    finite(trial, &report)
}

//! Level 3: short trainings on generated rooms.

use super::case::{Case, Finding, Level, Policy};
use super::trial::{Failure, Trial, ensure};
use candle_core::{DType, Device, Tensor};
use scenesplat::experiment::{ExperimentConfig, ExperimentError, RunOptions, RunReport, train};
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

pub(super) fn cases() -> Vec<Case> {
    let case = |name: &str,
                origin: &'static str,
                check: fn(&Trial<'_>) -> Result<Finding, Failure>| {
        Case {
            area: "training",
            origin,
            reason: "every loss and parameter is finite, or the files are the same, byte for byte",
            ..Case::new(name, Level::Training, check)
        }
    };
    let refused =
        |name: &str, origin: &'static str, check: fn(&Trial<'_>) -> Result<Finding, Failure>| {
            Case { policy: Policy::Refused, ..case(name, origin, check) }
        };
    let mut cases = Vec::new();
    for (name, from, to) in [
        ("f32", "log_every = 1", "log_every = 1"),
        ("bf16", "[model]", "precision = \"bf16\"\n[model]"),
        ("split", "[model]", "precision = \"split\"\n[model]"),
        ("accumulated", "ema = 0.9", "accumulate = 3"),
        ("recomputed", "ema = 0.9", "recompute = true"),
        ("uneven-batches", "batch_size = 1", "batch_size = 2"),
        ("huge-rate", "[trainer]", "[optimizer]\nlr = 1000.0\n[trainer]\nclip_norm = 1.0"),
    ] {
        cases.push(Case { quick: name == "f32" || name == "bf16", ..case_of_run(name, from, to) });
    }
    cases.extend([
        case(
            "training-on-threads",
            "demands 2a, level 3: identical hashes on 1 and many threads",
            |t| {
                let path = config(t, EXPERIMENT)?;
                let runs = std::sync::atomic::AtomicUsize::new(0);
                t.same_on_threads(|| {
                    let run = runs.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
                    let out = t.folder().join(format!("run-{run}"));
                    weights(&start(&path, &out, false)?)
                })?;
                Ok(Finding::right())
            },
        ),
        case(
            "resumed-training",
            "demands 2a, level 3: resume = uninterrupted run, bit for bit",
            |t| {
                let path = config(t, EXPERIMENT)?;
                let out = t.folder().join("run");
                let whole = weights(&start(&path, &out, false)?)?;
                forget(&out, 4)?;
                let resumed = weights(&start(&path, &out, true)?)?;
                ensure!(whole == resumed, "another network after going on from step 4");
                Ok(Finding::right())
            },
        ),
        refused(
            "resumed-without-its-average",
            "attack M6: average.safetensors missing: other bits, in silence",
            |t| damaged(t, |average| Ok(std::fs::remove_file(average)?)),
        ),
        refused(
            "resumed-with-a-nan-in-its-average",
            "attack M6: a NaN is exported, in silence",
            |t| {
                damaged(t, |average| {
                    let mut bytes = std::fs::read(average)?;
                    let end = bytes.len() - 4;
                    bytes[end..].copy_from_slice(&f32::NAN.to_le_bytes());
                    Ok(std::fs::write(average, bytes)?)
                })
            },
        ),
        refused("training-on-nothing", "attack M6: trained on 0 Gaussians, and exported", |t| {
            let text = EXPERIMENT.replace("num_gaussians = 400", "num_gaussians = 0");
            let ended = start(&config(t, &text)?, &t.folder().join("run"), false);
            ensure!(ended.is_err(), "a network is trained on nothing");
            Ok(Finding::right())
        }),
        Case {
            policy: Policy::Repaired,
            ..case(
                "training-data-with-bad-values",
                "attack M9: 300 NaN positions and 600 NaN rotations, not a word",
                bad_data,
            )
        },
    ]);
    for (name, word, from, to) in [
        ("patch", "enc_patch_size", "enc_patch_size = [64, 64]", "enc_patch_size = [32, 64]"),
        ("loss", "losses", "\"lovasz_softmax\"", "\"lovasz_softmax\"\nweight = 0.5"),
        ("voxels", "grid_size", "grid_size = 0.3", "grid_size = 0.4"),
        ("seed", "seed", "seed = 1", "seed = 7"),
    ] {
        cases.push(Case {
            area: "training",
            origin: "attack M6: a run goes on with other settings, in silence",
            policy: Policy::Refused,
            quick: name == "voxels",
            reason: "an error that names the setting; nothing is measured",
            ..Case::new(format!("resumed-with-another-{name}"), Level::Training, move |t| {
                let path = config(t, EXPERIMENT)?;
                let out = t.folder().join("run");
                start(&path, &out, false)?;
                forget(&out, 4)?;
                let other = config(t, &EXPERIMENT.replace(from, to))?;
                let ended = start(&other, &out, true);
                let named = ended.as_ref().is_err_and(|e| e.0.contains(word));
                ensure!(named, "goes on with {to}, or does not name it: {ended:?}");
                Ok(Finding::right())
            })
        });
    }
    cases
}

/// A run with one setting changed, whose numbers have to be finite.
fn case_of_run(name: &str, from: &'static str, to: &'static str) -> Case {
    Case {
        area: "training",
        origin: "demands 2a, level 3: f32, bf16; even and uneven batches; accumulation, recomputation",
        reason: "every loss and parameter is finite; nothing else is measured",
        ..Case::new(format!("training-{name}"), Level::Training, move |t| {
            let path = config(t, &EXPERIMENT.replacen(from, to, 1))?;
            let report = start(&path, &t.folder().join("run"), false)?;
            finite(&t.folder().join("run"), &report)
        })
    }
}

/// Writes the experiment.
fn config(trial: &Trial<'_>, text: &str) -> Result<PathBuf, Failure> {
    trial.file("experiment.toml", text.as_bytes())
}

fn start(path: &Path, out: &Path, resume: bool) -> Result<RunReport, Failure> {
    let options = RunOptions {
        device: candle_core::Device::Cpu,
        out: out.to_owned(),
        resume,
        quiet: true,
        stop: Default::default(),
        commit: None,
    };
    let run = || -> Result<RunReport, ExperimentError> {
        train(&ExperimentConfig::read(path)?, &options)
    };
    Ok(run()?)
}

/// The bytes of the exported network.
fn weights(report: &RunReport) -> Result<Vec<u8>, Failure> {
    Ok(std::fs::read(report.model.join("model.safetensors"))?)
}

/// That losses were logged, and are finite with all parameters.
fn finite(out: &Path, report: &RunReport) -> Result<Finding, Failure> {
    let log = read_json_lines(&out.join("metrics.jsonl"))?;
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
    Ok(Finding::right())
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
fn damaged(
    trial: &Trial<'_>,
    damage: fn(&Path) -> Result<(), Failure>,
) -> Result<Finding, Failure> {
    let path = config(trial, EXPERIMENT)?;
    let out = trial.folder().join("run");
    start(&path, &out, false)?;
    forget(&out, 4)?;
    let average = out.join("checkpoints/step-000000004/average.safetensors");
    damage(&average)?;
    let ended = start(&path, &out, true);
    ensure!(
        ended.as_ref().is_err_and(|e| e.0.contains("average.safetensors")),
        "goes on, or does not name the file: {ended:?}"
    );
    Ok(Finding::right())
}

/// Scenes with NaN positions and rotations: the run says how many.
fn bad_data(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let data = trial.folder().join("data");
    std::fs::create_dir(&data)?;
    for scene in 0..2 {
        let mut text = "ply\nformat ascii 1.0\nelement vertex 400\n".to_owned();
        let columns = [
            "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1",
            "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
        ];
        columns.iter().for_each(|name| text += &format!("property float {name}\n"));
        text += "property int segment\nend_header\n";
        let mut rng = super::noise::Noise::new(scene);
        for row in 0..400 {
            let x = if row % 40 == 7 { "nan".to_owned() } else { rng.float().to_string() };
            let quat = if row % 40 == 9 { "nan 0 0 0" } else { "1 0 0 0" };
            let (y, z) = (rng.float(), rng.float());
            text += &format!("{x} {y} {z} 0.1 0.2 0.3 1 -3 -3 -3 {quat} {}\n", row % 5);
        }
        std::fs::write(data.join(format!("s{scene}.ply")), text)?;
    }
    let text = EXPERIMENT.replace(
        "{ type = \"synthetic\", count = 3, seed = 1, room = { num_gaussians = 400 } }",
        "{ type = \"generic\", root = \"data\" }",
    );
    let report = start(&config(trial, &text)?, &trial.folder().join("run"), false)?;
    let log = read_json_lines(&trial.folder().join("run/metrics.jsonl"))?;
    let counted = |name: &str| log.iter().find(|v| v.name == name).map(|v| v.value);
    for (name, want) in [("data/train/repaired_scenes", 2.0), ("data/train/dropped_rows", 20.0)] {
        ensure!(counted(name) == Some(want), "{name} is {:?}, {want} is right", counted(name));
    }
    finite(&trial.folder().join("run"), &report)
}

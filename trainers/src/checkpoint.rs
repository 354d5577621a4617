//! Checkpoints: folders that hold a run at a step, complete or not there at all.
//!
//! ```text
//! DIR/step-000000120/params.safetensors      parameters and batch statistics
//!                    optimizer.safetensors   moments and counters
//!                    average.safetensors     moving average of the parameters, if there is one
//!                    state.json              step, settings, callbacks
//! DIR/best.json                              which of the folders is the best, and its value
//! ```
//!
//! There is neither a random state nor a loader position to store: both follow from seed and step.

use crate::{Progress, TrainError, TrainerConfig};
use candle_core::{Device, Tensor};
use scenesplat_models::weights::save_tensors;
use scenesplat_scene::AtomicFile;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Version of the layout above.
const FORMAT: u32 = 1;

/// What `state.json` holds.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CheckpointState {
    /// Version of the layout.
    pub format: u32,
    /// Where the run stands.
    pub progress: Progress,
    /// Batches of an epoch; another number would put the loader at another place.
    pub batches_per_epoch: usize,
    /// Settings of the loop.
    pub config: TrainerConfig,
    /// Best value so far of the measurement that decides.
    pub best: Option<f64>,
    /// States of callbacks by name.
    pub callbacks: BTreeMap<String, serde_json::Value>,
}

impl CheckpointState {
    pub(crate) fn new(
        progress: Progress,
        batches_per_epoch: usize,
        config: &TrainerConfig,
        best: Option<f64>,
        callbacks: BTreeMap<String, serde_json::Value>,
    ) -> Self {
        let config = config.clone();
        Self { format: FORMAT, progress, batches_per_epoch, config, best, callbacks }
    }

    /// Checks that a run with other settings can go on from here bit for bit. What may differ: the
    /// intervals of log, evaluation and checkpoints, and `recompute`.
    ///
    /// # Errors
    /// Names the first setting that differs.
    pub(crate) fn check(&self, config: &TrainerConfig, batches: usize) -> Result<(), TrainError> {
        let mine = &self.config;
        let fields = [
            ("seed", mine.seed.to_string(), config.seed.to_string()),
            ("epochs", mine.epochs.to_string(), config.epochs.to_string()),
            ("accumulate", mine.accumulate.to_string(), config.accumulate.to_string()),
            ("clip_norm", format!("{:?}", mine.clip_norm), format!("{:?}", config.clip_norm)),
            ("ema", format!("{:?}", mine.ema), format!("{:?}", config.ema)),
            ("freeze", format!("{:?}", mine.freeze), format!("{:?}", config.freeze)),
            ("batches of an epoch", self.batches_per_epoch.to_string(), batches.to_string()),
        ];
        for (field, expected, got) in fields {
            if expected != got {
                return Err(TrainError::Resume { field, expected, got });
            }
        }
        Ok(())
    }
}

/// The newest complete checkpoint in a folder; `None` if there is none (or no folder).
///
/// # Errors
/// If the folder cannot be listed.
pub fn newest_checkpoint(dir: &Path) -> Result<Option<PathBuf>, TrainError> {
    Ok(steps(dir)?.pop().map(|(_, path)| path))
}

/// Complete checkpoints, oldest first.
fn steps(dir: &Path) -> Result<Vec<(u64, PathBuf)>, TrainError> {
    if !dir.is_dir() {
        return Ok(Vec::new());
    }
    let error = |source| TrainError::Io { path: dir.to_owned(), action: "cannot list", source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(error)? {
        let path = entry.map_err(error)?.path();
        let name = path.file_name().and_then(|n| n.to_str());
        let step = name.and_then(|n| n.strip_prefix("step-")).and_then(|n| n.parse().ok());
        if let (Some(step), true) = (step, path.join("state.json").is_file()) {
            found.push((step, path));
        }
    }
    found.sort_unstable();
    Ok(found)
}

/// Everything that a checkpoint holds.
pub(crate) struct Contents<'a> {
    pub(crate) params: &'a scenesplat_models::ParamStore,
    pub(crate) optimizer: BTreeMap<String, Tensor>,
    pub(crate) average: Option<BTreeMap<String, Tensor>>,
    pub(crate) state: CheckpointState,
}

/// Writes a checkpoint beside its place and moves it there when it is complete.
pub(crate) fn write(dir: &Path, contents: &Contents<'_>) -> Result<PathBuf, TrainError> {
    let place = dir.join(format!("step-{:09}", contents.state.progress.step));
    let beside = place.with_extension("partial");
    let io = |path: &Path, action| {
        let path = path.to_owned();
        move |source| TrainError::Io { path, action, source }
    };
    if beside.exists() {
        std::fs::remove_dir_all(&beside).map_err(io(&beside, "cannot remove"))?;
    }
    std::fs::create_dir_all(dir).map_err(io(dir, "cannot make"))?;
    // Not over anything: a link in the way would lead out of the folder.
    std::fs::create_dir(&beside).map_err(io(&beside, "cannot make"))?;
    contents
        .params
        .save(&beside.join("params.safetensors"))
        .map_err(TrainError::tensor("params.safetensors"))?;
    save(&beside.join("optimizer.safetensors"), &contents.optimizer)?;
    if let Some(average) = &contents.average {
        save(&beside.join("average.safetensors"), average)?;
    }
    let text = serde_json::to_string_pretty(&contents.state)
        .map_err(|e| io(&beside, "cannot describe")(e.into()))?;
    AtomicFile::write(&beside.join("state.json"), text.as_bytes())?;
    if place.exists() {
        std::fs::remove_dir_all(&place).map_err(io(&place, "cannot replace"))?;
    }
    std::fs::rename(&beside, &place).map_err(io(&place, "cannot rename to"))?;
    Ok(place)
}

fn save(path: &Path, tensors: &BTreeMap<String, Tensor>) -> Result<(), TrainError> {
    let tensors: HashMap<&str, Tensor> =
        tensors.iter().map(|(n, t)| (n.as_str(), t.clone())).collect();
    save_tensors(&tensors, path).map_err(TrainError::tensor(&path.display().to_string()))
}

/// Reads `state.json`.
///
/// # Errors
/// If the folder is no complete checkpoint of this format.
pub fn read_state(dir: &Path) -> Result<CheckpointState, TrainError> {
    let path = dir.join("state.json");
    let error = |source| TrainError::Io { path: path.clone(), action: "cannot read", source };
    let text = std::fs::read_to_string(&path).map_err(error)?;
    let state: CheckpointState = serde_json::from_str(&text).map_err(|e| error(e.into()))?;
    if state.format != FORMAT {
        let (expected, got) = (FORMAT.to_string(), state.format.to_string());
        return Err(TrainError::Resume { field: "checkpoint format", expected, got });
    }
    Ok(state)
}

/// Reads tensors by name.
pub(crate) fn read_tensors(path: &Path) -> Result<BTreeMap<String, Tensor>, TrainError> {
    let tensors = candle_core::safetensors::load(path, &Device::Cpu)
        .map_err(TrainError::tensor(&path.display().to_string()))?;
    Ok(tensors.into_iter().collect())
}

/// Which checkpoint is the best.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BestCheckpoint {
    /// Name of its folder, beside the file.
    pub checkpoint: String,
    /// Measurement that decided.
    pub measurement: String,
    /// Its value.
    pub value: f64,
}

/// The best checkpoint of a folder, if one was marked.
///
/// # Errors
/// If `best.json` is there and cannot be read.
pub fn best_checkpoint(dir: &Path) -> Result<Option<BestCheckpoint>, TrainError> {
    let path = dir.join("best.json");
    if !path.is_file() {
        return Ok(None);
    }
    let error = |source| TrainError::Io { path: path.clone(), action: "cannot read", source };
    let text = std::fs::read_to_string(&path).map_err(error)?;
    serde_json::from_str(&text).map(Some).map_err(|e| error(e.into()))
}

/// Marks the best checkpoint.
pub(crate) fn mark_best(dir: &Path, best: &BestCheckpoint) -> Result<(), TrainError> {
    let path = dir.join("best.json");
    let error = |action| {
        let path = path.clone();
        move |source| TrainError::Io { path, action, source }
    };
    let text =
        serde_json::to_string_pretty(best).map_err(|e| error("cannot describe")(e.into()))?;
    Ok(AtomicFile::write(&path, text.as_bytes())?)
}

/// Removes all but the last `keep` checkpoints and the best one.
pub(crate) fn prune(dir: &Path, keep: usize) -> Result<(), TrainError> {
    let best = best_checkpoint(dir)?.map(|b| b.checkpoint);
    let found = steps(dir)?;
    let surplus = found.len().saturating_sub(keep);
    for (_, path) in &found[..surplus] {
        let name = path.file_name().and_then(|n| n.to_str());
        if name.is_some() && name != best.as_deref() {
            std::fs::remove_dir_all(path).map_err(|source| TrainError::Io {
                path: path.clone(),
                action: "cannot remove",
                source,
            })?;
        }
    }
    Ok(())
}

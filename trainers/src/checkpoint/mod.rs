//! Checkpoints: folders that hold a run at a step, complete or not there at all.
//!
//! ```text
//! DIR/step-000000120/params.safetensors      parameters and batch statistics
//!                    optimizer.safetensors   moments and counters
//!                    average.safetensors     moving average of the parameters, if there is one
//!                    teacher.safetensors     further stores of the module, by their names
//!                    state.json              step, settings, checksums of the files, callbacks
//! DIR/best.json                              which of the folders is the best, and its value
//! ```
//!
//! There is neither a random state nor a loader position to store: both follow from seed and step. A
//! checkpoint is taken up only by a run of the same settings ([`crate::Identity`]), and
//! only if its files are what was written.

mod files;

pub use files::FileSum;
pub(crate) use files::read_tensors;

use crate::{Identity, Progress, Tally, TrainError};
use candle_core::Tensor;
use scenesplat_models::ParamStore;
use scenesplat_scene::input_file::read_text_file;
use scenesplat_scene::{AtomicFile, WholeFolder};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Version of the layout above.
pub(crate) const FORMAT: u32 = 2;

/// Parameters and batch statistics of a checkpoint.
pub(crate) const PARAMS: &str = "params.safetensors";
/// Moments and counters.
pub(crate) const OPTIMIZER: &str = "optimizer.safetensors";
/// The moving average.
pub(crate) const AVERAGE: &str = "average.safetensors";

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
    /// SHA-256 of `experiment`.
    pub experiment_hash: String,
    /// Settings that must be the same to go on.
    pub experiment: Identity,
    /// Lengths and checksums of the files beside it, by name.
    pub files: BTreeMap<String, FileSum>,
    /// Rows and batches of the epoch under way.
    pub tally: Tally,
    /// Whether the run was stopped at the end of an epoch, before its evaluation.
    pub evaluation_due: bool,
    /// Best value so far of the measurement that decides.
    pub best: Option<f64>,
    /// States of callbacks by name.
    pub callbacks: BTreeMap<String, serde_json::Value>,
}

impl CheckpointState {
    /// Checks that a run of these settings goes on from here bit for bit.
    ///
    /// # Errors
    /// Names the settings that differ, with both values.
    pub fn check(&self, experiment: &Identity) -> Result<(), TrainError> {
        let changes = self.experiment.changes(experiment);
        if changes.is_empty() { Ok(()) } else { Err(TrainError::Resume { changes }) }
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
    pub(crate) params: &'a ParamStore,
    pub(crate) stores: Vec<(&'static str, &'a ParamStore)>,
    pub(crate) optimizer: BTreeMap<String, Tensor>,
    pub(crate) average: Option<BTreeMap<String, Tensor>>,
    /// Without its checksums.
    pub(crate) state: CheckpointState,
}

/// The file of a further store of a module.
pub(crate) fn store_file(name: &str) -> String {
    format!("{name}.safetensors")
}

/// Writes a checkpoint beside its place and moves it there when it is complete.
pub(crate) fn write(dir: &Path, mut contents: Contents<'_>) -> Result<PathBuf, TrainError> {
    let place = dir.join(format!("step-{:09}", contents.state.progress.step));
    let folder = WholeFolder::create(&place)?;
    let beside = folder.waiting();
    let stores = contents.stores.iter().map(|(name, store)| (store_file(name), *store));
    let mut names = vec![OPTIMIZER.to_owned()];
    for (name, store) in std::iter::once((PARAMS.to_owned(), contents.params)).chain(stores) {
        store.save(&beside.join(&name)).map_err(TrainError::tensor(&name))?;
        names.push(name);
    }
    files::save(&beside.join(OPTIMIZER), &contents.optimizer)?;
    if let Some(average) = &contents.average {
        files::save(&beside.join(AVERAGE), average)?;
        names.push(AVERAGE.to_owned());
    }
    for name in names {
        let sum = files::sum(&beside.join(&name))?;
        contents.state.files.insert(name, sum);
    }
    let text = serde_json::to_string_pretty(&contents.state)
        .map_err(|e| TrainError::io(&place, "cannot describe")(e.into()))?;
    folder.write("state.json", text.as_bytes())?;
    folder.commit()?;
    Ok(place)
}

/// Reads `state.json`.
///
/// # Errors
/// If the folder is no complete checkpoint of this format, or its settings are not what was written.
pub fn read_state(dir: &Path) -> Result<CheckpointState, TrainError> {
    let path = dir.join("state.json");
    let damaged = |problem: String| TrainError::Damaged { path: path.clone(), problem };
    let text = read_text_file(&path)?;
    let value: serde_json::Value =
        serde_json::from_str(&text).map_err(|e| damaged(format!("is no JSON: {e}")))?;
    let format = value.get("format").cloned().unwrap_or_default();
    if format != FORMAT {
        let problem = format!(
            "is of format {format}, this program writes {FORMAT}: go on with the program that wrote it, \
             or start a new run from its {PARAMS}"
        );
        return Err(damaged(problem));
    }
    let state: CheckpointState =
        serde_json::from_value(value).map_err(|e| damaged(format!("cannot be understood: {e}")))?;
    if state.experiment.hash() != state.experiment_hash {
        return Err(damaged("names settings that do not fit their checksum".to_owned()));
    }
    Ok(state)
}

/// The network of a checkpoint: parameters, averaged where there is an average, and batch
/// statistics.
///
/// # Errors
/// If a file is missing, not what was written, or holds a value that is not finite.
pub fn read_network(dir: &Path) -> Result<BTreeMap<String, Tensor>, TrainError> {
    let state = read_state(dir)?;
    let mut tensors = read_tensors(dir, &state, PARAMS)?;
    if state.files.contains_key(AVERAGE) {
        tensors.extend(read_tensors(dir, &state, AVERAGE)?);
    }
    Ok(tensors)
}

/// A further store of a checkpoint, see [`TrainingModule::stores`](crate::TrainingModule::stores).
///
/// # Errors
/// If the checkpoint has none of this name, or its file is not what was written.
pub fn read_store(dir: &Path, name: &str) -> Result<BTreeMap<String, Tensor>, TrainError> {
    read_tensors(dir, &read_state(dir)?, &store_file(name))
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
    let text = read_text_file(&path)?;
    serde_json::from_str(&text)
        .map(Some)
        .map_err(|e| TrainError::io(&path, "cannot understand")(e.into()))
}

/// Marks the best checkpoint.
pub(crate) fn mark_best(dir: &Path, best: &BestCheckpoint) -> Result<(), TrainError> {
    let path = dir.join("best.json");
    let text = serde_json::to_string_pretty(best)
        .map_err(|e| TrainError::io(&path, "cannot describe")(e.into()))?;
    Ok(AtomicFile::write(&path, text.as_bytes())?)
}

/// Removes all but the last `keep` checkpoints and the best one, and what a killed run left of one.
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
    for entry in std::fs::read_dir(dir).map_err(TrainError::io(dir, "cannot list"))? {
        let path = entry.map_err(TrainError::io(dir, "cannot list"))?.path();
        if path.file_name().and_then(|n| n.to_str()).is_some_and(is_leftover) {
            std::fs::remove_dir_all(&path).map_err(TrainError::io(&path, "cannot remove"))?;
        }
    }
    Ok(())
}

/// Whether a name is that of a checkpoint being written: `.step-<9 digits>.<16 hex digits>.part`. This
/// run writes none now, and another cannot write to its folder.
fn is_leftover(name: &str) -> bool {
    let middle = name.strip_prefix(".step-").and_then(|n| n.strip_suffix(".part"));
    middle.and_then(|n| n.split_once('.')).is_some_and(|(step, token)| {
        step.len() >= 9
            && step.bytes().all(|b| b.is_ascii_digit())
            && token.len() == 16
            && token.bytes().all(|b| b.is_ascii_hexdigit())
    })
}

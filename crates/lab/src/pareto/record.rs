//! What was measured: a line of JSON for each setting and set of scenes, appended as it is made.

use super::ParetoError;
use scenesplat::machine::Machine;
use serde::{Deserialize, Serialize};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// What a line is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A setting, which changes the result.
    Setting,
    /// The reference again with something that must not change the result.
    Neutral,
    /// The truth through the same chain: the ceiling. Its time is that of the chain, once.
    Oracle,
    /// Labels drawn evenly from all classes: what any setting has to beat.
    Random,
}

/// Time of a stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// `read`, `network`, `labels`, `write_labels` or `write_features`.
    pub name: String,
    /// Seconds a scene, mean over scenes and repeats.
    pub seconds: f64,
    /// Share of the time of a scene, 0..=1.
    pub share: f64,
}

/// One scene of a set.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// Its name.
    pub name: String,
    /// Gaussians.
    pub gaussians: usize,
    /// Voxels of a pass.
    pub voxels: usize,
    /// Passes of the network.
    pub passes: usize,
    /// Tiles over all passes.
    pub tiles: usize,
    /// Seconds of each repeat.
    pub seconds: Vec<f64>,
    /// Mean seconds of each stage, in the order of [`Record::stages`].
    pub stage_seconds: Vec<f64>,
    /// Foreground mean `IoU` of this scene alone.
    pub f_miou: Option<f64>,
    /// Share of Gaussians with the label of the reference.
    pub agreement: Option<f64>,
    /// SHA-256 of its labels.
    pub prediction_hash: String,
    /// Ids in its own labels that have no name, in words; they count as unlabeled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unnamed: Option<String>,
}

/// A line of `records.jsonl`. Field names are stable. Shares are 0..=1, times seconds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// What the line is about.
    pub kind: Kind,
    /// The setting in canonical form; `oracle` and `random labels` for those.
    pub setting: String,
    /// Whether it may change the result; none for the two rows that are no settings.
    pub changes_result: Option<bool>,
    /// What must not change the result, such as `threads=1`.
    pub neutral: Option<String>,
    /// The rule that a neutral line is held to.
    pub rule: Option<String>,
    /// Whether the rule holds.
    pub holds: Option<bool>,
    /// The set of scenes, as it was given.
    pub scenes: String,
    /// Repeats after the warm-up.
    pub repeats: usize,
    /// Median time of a scene, over scenes and repeats.
    pub seconds_p50: f64,
    /// Time that 95 % of scenes and repeats keep.
    pub seconds_p95: f64,
    /// Least of the repeats' medians.
    pub seconds_low: f64,
    /// Largest of the repeats' medians.
    pub seconds_high: f64,
    /// Time to load the weights, once in a process; not part of the time of a scene.
    pub load_seconds: f64,
    /// Largest resident memory of the process, bytes, before anything was scored.
    pub peak_bytes: u64,
    /// Bytes of the results of a scene, mean.
    pub bytes_written: u64,
    /// Foreground mean `IoU` over all scenes together.
    pub f_miou: Option<f64>,
    /// Lower end of its 95 % interval over scenes.
    pub f_miou_low: Option<f64>,
    /// Upper end of its 95 % interval over scenes.
    pub f_miou_high: Option<f64>,
    /// Mean `IoU`.
    pub miou: Option<f64>,
    /// Foreground mean accuracy.
    pub f_macc: Option<f64>,
    /// Mean accuracy.
    pub macc: Option<f64>,
    /// Share of labeled Gaussians with the right class.
    pub all_acc: Option<f64>,
    /// Share of Gaussians with the label that the reference gives.
    pub agreement: Option<f64>,
    /// Share of the classes of a scene whose best-scoring Gaussian is of the class.
    pub query_hit1: Option<f64>,
    /// Expected calibration error; lower is better.
    pub ece: Option<f64>,
    /// Where the time went.
    pub stages: Vec<Stage>,
    /// Share of the time that the stages explain.
    pub stage_coverage: f64,
    /// Numbers of a feature row.
    pub width: usize,
    /// Classes.
    pub classes: usize,
    /// SHA-256 of the labels of all scenes.
    pub prediction_hash: String,
    /// The reference, the classes and what is written, which all records of a folder share.
    pub conditions: String,
    /// SHA-256 of the weights.
    pub weights_hash: String,
    /// SHA-256 of the scenes.
    pub input_hash: String,
    /// SHA-256 of their true labels.
    pub truth_hash: String,
    /// Where it ran.
    pub machine: Machine,
    /// [`Machine::fingerprint`], to be compared.
    pub fingerprint: String,
    /// The scenes one by one.
    pub per_scene: Vec<SceneRecord>,
}

impl Record {
    /// What no two lines share: kind, setting, what is neutral, and scenes.
    pub fn key(&self) -> (String, String, String) {
        let neutral = self.neutral.as_deref().unwrap_or_default();
        let what = format!("{:?} {} {neutral}", self.kind, self.setting);
        (what, self.scenes.clone(), self.input_hash.clone())
    }
}

/// The records of a folder, read when opened and appended to.
#[derive(Debug)]
pub struct Records {
    path: PathBuf,
    file: File,
    /// What is there.
    pub all: Vec<Record>,
    /// Whether an interrupted line was removed from the end.
    pub repaired: bool,
}

impl Records {
    /// Opens or makes the file. A last line that an interruption cut is removed.
    ///
    /// # Errors
    /// If it cannot be read or written, or another line is no record.
    pub fn open(path: &Path) -> Result<Self, ParetoError> {
        let (all, whole, length) = if path.exists() { read(path)? } else { (Vec::new(), 0, 0) };
        let file = OpenOptions::new().create(true).append(true).open(path);
        let file = file.map_err(ParetoError::io(path, "cannot write"))?;
        let repaired = whole < length;
        if repaired {
            file.set_len(whole as u64)
                .map_err(ParetoError::io(path, "cannot remove its unfinished last line"))?;
        }
        Ok(Self { path: path.to_owned(), file, all, repaired })
    }

    /// Reads the file, and changes nothing.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn read(path: &Path) -> Result<Vec<Record>, ParetoError> {
        Ok(read(path)?.0)
    }

    /// The record that is there already, if any.
    pub fn find(
        &self,
        kind: Kind,
        setting: &str,
        neutral: Option<&str>,
        scenes: &str,
    ) -> Option<&Record> {
        self.all.iter().find(|r| {
            r.kind == kind
                && r.setting == setting
                && r.neutral.as_deref() == neutral
                && r.scenes == scenes
        })
    }

    /// Adds a line, which is on the disk when this returns.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn append(&mut self, record: Record) -> Result<(), ParetoError> {
        let line = serde_json::to_string(&record)? + "\n";
        let io = |e| ParetoError::io(&self.path, "cannot add a record")(e);
        // One call: an interruption leaves a whole line or the begin of one.
        self.file.write_all(line.as_bytes()).map_err(io)?;
        self.file.sync_data().map_err(io)?;
        self.all.push(record);
        Ok(())
    }

    /// Refuses records of another machine, program, input or choice of what is measured.
    ///
    /// `conditions`: what records are to share; `inputs`: sets of scenes with their hashes.
    ///
    /// # Errors
    /// Names what differs.
    pub fn check_own(
        &self,
        fingerprint: &str,
        machine: &Machine,
        conditions: &str,
        inputs: &[(String, String)],
    ) -> Result<(), ParetoError> {
        let foreign = |what, theirs: String, ours: String| {
            Err(ParetoError::Foreign { path: self.path.clone(), what, theirs, ours })
        };
        for record in &self.all {
            if record.conditions != conditions {
                let (theirs, ours) = (record.conditions.clone(), conditions.to_owned());
                return foreign("choice", theirs, ours);
            }
            if record.kind == Kind::Neutral {
                continue;
            }
            if record.machine.version != machine.version {
                let (theirs, ours) = (record.machine.version.clone(), machine.version.clone());
                return foreign("version", theirs, ours);
            }
            if record.fingerprint != fingerprint {
                return foreign("machine", record.machine.to_string(), machine.to_string());
            }
            let own = inputs.iter().find(|(name, _)| *name == record.scenes);
            if let Some((name, hash)) = own
                && *hash != record.input_hash
            {
                let short =
                    |hash: &str| format!("{name} sha256 {}…", hash.get(..12).unwrap_or(hash));
                return foreign("input", short(&record.input_hash), short(hash));
            }
        }
        Ok(())
    }
}

/// Records, bytes up to the end of the last whole line, and all bytes.
fn read(path: &Path) -> Result<(Vec<Record>, usize, usize), ParetoError> {
    let text = std::fs::read(path).map_err(ParetoError::io(path, "cannot read the records"))?;
    let whole = text.iter().rposition(|&b| b == b'\n').map_or(0, |at| at + 1);
    let mut all = Vec::new();
    for (index, line) in text[..whole].split(|&b| b == b'\n').enumerate() {
        if line.is_empty() {
            continue;
        }
        all.push(serde_json::from_slice(line).map_err(|error| ParetoError::Record {
            path: path.to_owned(),
            line: index + 1,
            text: error.to_string(),
        })?);
    }
    Ok((all, whole, text.len()))
}

#[cfg(test)]
pub(crate) mod tests;

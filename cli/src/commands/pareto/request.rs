//! What the command asks of the processes that it starts.

use scenesplat::scene::LabelBase;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A setting to measure on a set of scenes.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Request {
    /// The setting as records call it; its `net` may be a name of the grid.
    pub setting: String,
    /// The setting as the flags take it: without `net` where the grid says what it is.
    pub given: String,
    /// Flags of the network and the classes.
    pub flags: Vec<String>,
    /// The set of scenes, as it was given.
    pub set: String,
    /// Its scenes.
    pub scenes: Vec<Scene>,
    /// Names of the labels of files.
    pub label_names: Option<PathBuf>,
    /// The id of the first of those names.
    #[serde(default)]
    pub label_base: Option<LabelBase>,
    /// What those names mean.
    pub class_map: Option<PathBuf>,
    /// Classes left out of the foreground averages.
    pub exclude: Option<Vec<String>>,
    /// Repeats after the warm-up.
    pub repeats: usize,
    /// Whether features are written, too.
    pub features: bool,
    /// Whether labels are written.
    pub labels: bool,
    /// Threads.
    pub threads: usize,
    /// Memory limit, as the flag takes it.
    pub max_memory: Option<String>,
    /// What all records of a folder share.
    pub conditions: String,
    /// SHA-256 of the weights.
    pub weights_hash: String,
    /// SHA-256 of the scenes.
    pub input_hash: String,
    /// Folder with the reference's labels.
    pub reference: Option<PathBuf>,
    /// Folder for the labels.
    pub keep_labels: Option<PathBuf>,
    /// Whether the evaluator is checked, and oracle and random labels are scored.
    pub bounds: bool,
    /// Folder for what is written and thrown away.
    pub scratch: PathBuf,
    /// File for the answer.
    pub answer: PathBuf,
}

/// A scene of a request.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Scene {
    /// What records call it.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// Whether its labels are those of synthetic rooms.
    pub is_room: bool,
}

//! A teacher as a file gives it.

use super::super::error::ExperimentError;
use crate::network::Weights;
use scenesplat_datasets::TeacherView;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// Whose rows the network shall learn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum TeacherConfig {
    /// Another network, with weights.
    Network(NetworkTeacherConfig),
    /// Features that were stored before.
    Features(StoredTeacherConfig),
}

/// A network as a teacher. It has voxels and inputs of its own: those of its configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkTeacherConfig {
    /// A file or model folder, `embedded`, or `seeded:N` (without any meaning, for tests).
    pub weights: PathBuf,
    /// What the weights belong to, where they do not say it: a name (`language`, `litept-b`, …) or a
    /// file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub config: Option<PathBuf>,
    /// Form of the numbers in its products: `f32`, `split`, `bf16` or `int8`.
    #[serde(default = "f32_name")]
    pub precision: String,
    /// What it is shown: `augmented`, what the student sees; or `scene`, each scene as it was read.
    #[serde(default)]
    pub view: TeacherView,
    /// Keeps its rows for scenes that come again; none if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cache: Option<CacheConfig>,
}

fn f32_name() -> String {
    "f32".to_owned()
}

/// Where rows of a teacher are kept: those of whole scenes, and those of evaluations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CacheConfig {
    /// A folder for them alone; it is made. Several runs may share it.
    pub folder: PathBuf,
    /// Most that it may hold, 10⁹ bytes. What does not fit is computed each time.
    #[serde(default = "max_gb")]
    pub max_gb: f64,
}

fn max_gb() -> f64 {
    20.0
}

/// Stored features as a teacher.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredTeacherConfig {
    /// Holds `ID/features.npy` or `ID.npy` for each scene, `[N, D]`, one row a Gaussian; rows of zeros
    /// are none. The scenes' own `lang_feat` if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
}

impl TeacherConfig {
    /// Makes relative paths start at `base`.
    pub(in super::super) fn place(&mut self, base: &Path) {
        let place = |path: &mut PathBuf| *path = base.join(&*path);
        match self {
            Self::Network(network) => {
                if matches!(weights(&network.weights), Ok(Weights::File(_))) {
                    place(&mut network.weights);
                }
                if let Some(config) = &mut network.config
                    && config.extension().is_some()
                {
                    place(config);
                }
                network.cache.iter_mut().for_each(|cache| place(&mut cache.folder));
            }
            Self::Features(stored) => stored.folder.iter_mut().for_each(place),
        }
    }

    pub(in super::super) fn check(&self) -> Result<()> {
        let Self::Network(network) = self else { return Ok(()) };
        weights(&network.weights)?;
        precision(&network.precision)?;
        match &network.cache {
            Some(cache) if !(cache.max_gb.is_finite() && cache.max_gb > 0.0) => {
                let problem = format!("{}, expected a number above 0", cache.max_gb);
                Err(ExperimentError::setting("teacher.cache.max_gb", problem))
            }
            _ => Ok(()),
        }
    }
}

/// The weights that a path stands for.
pub(super) fn weights(path: &Path) -> Result<Weights> {
    match path.to_str() {
        Some(text) => {
            text.parse().map_err(|e: String| ExperimentError::setting("teacher.weights", e))
        }
        None => Ok(Weights::File(path.to_owned())),
    }
}

pub(super) fn precision(name: &str) -> Result<scenesplat_kernels::Precision> {
    name.parse().map_err(|e: String| ExperimentError::setting("teacher.precision", e))
}

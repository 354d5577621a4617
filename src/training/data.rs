//! Scenes of an experiment: where they come from and how they become batches.

use super::config::{ExperimentConfig, TextConfig, TransformList};
use crate::text::read_text_table;
use anyhow::{Context, Result};
use scenesplat_datasets::synthetic::{
    CLASSES, SyntheticRoomSettings, SyntheticRooms, VOCABULARY_DIM, Vocabulary,
};
use scenesplat_datasets::transforms::build_transforms;
use scenesplat_datasets::{
    BatchLoader, DataSource, Dataset, SceneDataset, SceneFolder, SceneLoader, TrainBatch,
};
use scenesplat_scene::{LabelSet, ReadOptions, TextTable};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Scenes to train on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainDataConfig {
    /// Where they come from.
    pub source: SourceConfig,
    /// What is done to each.
    pub transforms: TransformList,
    /// How often each comes in an epoch, with other random numbers each time.
    #[serde(default = "one")]
    pub repeat: usize,
    /// Seed of the transforms.
    #[serde(default)]
    pub seed: u64,
}

/// Scenes to evaluate on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Prefix of the measurements.
    pub name: String,
    /// Where the scenes come from.
    pub source: SourceConfig,
    /// What is done to each.
    #[serde(default = "validation")]
    pub transforms: TransformList,
    /// Neighbours that vote on each label; 1 for no vote.
    #[serde(default = "one")]
    pub vote_k: usize,
}

fn one() -> usize {
    1
}

fn validation() -> TransformList {
    TransformList::Preset("validation".to_owned())
}

/// Where scenes come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum SourceConfig {
    /// Furnished rooms that are made as they are needed, with exact labels.
    Synthetic(SyntheticConfig),
    /// A folder of scene files or folders of arrays.
    Folder {
        /// The folder.
        path: PathBuf,
        /// Which labels to read: a PLY property or the stem of a `.npy` file.
        #[serde(default)]
        segment: Option<String>,
    },
}

/// Synthetic rooms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SyntheticConfig {
    /// Number of rooms.
    pub count: usize,
    /// Other seeds give other rooms.
    #[serde(default)]
    pub seed: u64,
    /// What the rooms are like.
    #[serde(default)]
    pub room: SyntheticRoomSettings,
    /// Whether each Gaussian carries its feature in the built-in vocabulary.
    #[serde(default)]
    pub vocabulary: bool,
}

impl SourceConfig {
    /// Makes relative paths start at `folder`.
    pub(super) fn place(&mut self, folder: &Path) {
        match self {
            Self::Folder { path, .. } if path.is_relative() => *path = folder.join(&*path),
            _ => {}
        }
    }

    /// The scenes.
    ///
    /// # Errors
    /// If a folder cannot be listed or holds no scene.
    pub fn open(&self) -> Result<Arc<dyn DataSource>> {
        Ok(match self {
            Self::Synthetic(s) => {
                let rooms = SyntheticRooms::new(s.count, s.room.clone(), s.seed)?;
                Arc::new(if s.vocabulary {
                    rooms.with_vocabulary(Arc::new(Vocabulary::new(VOCABULARY_DIM)?))
                } else {
                    rooms
                })
            }
            Self::Folder { path, segment } => {
                let options = ReadOptions {
                    segment: segment.clone(),
                    lang_feat: true,
                    sh_rest: false,
                    ..ReadOptions::default()
                };
                let folder = SceneFolder::new(path, options)?;
                let empty = folder.scene_ids().is_empty();
                anyhow::ensure!(!empty, "{}: no scene in this folder", path.display());
                Arc::new(folder)
            }
        })
    }
}

/// Batches to train on.
///
/// # Errors
/// If scenes or transforms cannot be had.
pub fn loader(config: &ExperimentConfig) -> Result<Box<dyn BatchLoader<TrainBatch>>> {
    let [entry] = config.train.as_slice() else {
        anyhow::bail!("train: one dataset is expected, got {}", config.train.len());
    };
    let data = dataset(&entry.source, &entry.transforms, entry.seed, entry.repeat)?;
    Ok(Box::new(SceneLoader::new(data, config.input.clone(), config.loader.clone())?))
}

/// Scenes of an evaluation.
///
/// # Errors
/// If scenes or transforms cannot be had.
pub fn evaluation(entry: &EvaluationConfig, _: &ExperimentConfig) -> Result<Arc<dyn Dataset>> {
    dataset(&entry.source, &entry.transforms, 0, 1)
        .with_context(|| format!("evaluate {:?}", entry.name))
}

fn dataset(
    source: &SourceConfig,
    transforms: &TransformList,
    seed: u64,
    repeat: usize,
) -> Result<Arc<dyn Dataset>> {
    let steps = build_transforms(&transforms.steps()?)?;
    Ok(Arc::new(SceneDataset::new(source.open()?, steps, seed, repeat)?))
}

/// Texts of the classes, and which are background.
#[derive(Debug, Clone)]
pub struct ClassTexts {
    /// One row for each class of the labels.
    pub table: TextTable,
    /// Names left out of the averages that begin with f.
    pub exclude: Vec<String>,
}

/// Reads or makes the texts of the classes.
///
/// # Errors
/// If a table cannot be read or lacks a row.
pub fn text_table(config: &TextConfig) -> Result<ClassTexts> {
    let (table, exclude) = match config {
        TextConfig::Vocabulary { exclude } => {
            (Vocabulary::new(VOCABULARY_DIM)?.class_table()?, exclude)
        }
        TextConfig::Table { path, names, rows, exclude } => {
            let table = read_text_table(path, names.as_deref())?;
            let table = if rows.is_empty() {
                table
            } else {
                choose(&table, rows, rows.clone()).with_context(|| path.display().to_string())?
            };
            (table, exclude)
        }
        TextConfig::SyntheticClasses { path, names, exclude } => {
            let table = read_text_table(path, names.as_deref())?;
            let rows: Vec<String> = CLASSES.iter().map(|c| c.scannet200_name.to_owned()).collect();
            let names = CLASSES.iter().map(|c| c.name.to_owned()).collect();
            (choose(&table, &rows, names).with_context(|| path.display().to_string())?, exclude)
        }
    };
    Ok(ClassTexts { table, exclude: exclude.clone() })
}

/// The named rows of a table, in this order, under new names.
fn choose(table: &TextTable, rows: &[String], names: Vec<String>) -> Result<TextTable> {
    let set = LabelSet::new(table.names.clone())?;
    let mut values = Vec::with_capacity(rows.len() * table.dim);
    for name in rows {
        let row = table.row(set.index_of(name)?).context("a row of the table")?;
        values.extend_from_slice(row);
    }
    Ok(TextTable::from_rows(names, values, table.dim)?)
}

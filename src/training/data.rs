//! Scenes of an experiment: where they come from and how they become batches.

use super::config::{ExperimentConfig, TextConfig, TransformList};
use crate::text::read_text_table;
use anyhow::{Context, Result};
use scenesplat_datasets::transforms::build_transforms;
use scenesplat_datasets::{
    BatchLoader, Dataset, SceneLoader, SourceConfig, TrainBatch, WeightedMix,
};
use scenesplat_rooms::CLASSES;
use scenesplat_rooms::vocabulary::Vocabulary;
use scenesplat_scene::{LabelSet, TextTable};
use serde::{Deserialize, Serialize};
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
    /// Weight among several datasets, see `mix`.
    #[serde(default = "one")]
    pub weight: usize,
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
    /// Texts of these scenes' classes, where they are others than those of the experiment.
    #[serde(default)]
    pub text: Option<TextConfig>,
}

fn one() -> usize {
    1
}

fn validation() -> TransformList {
    TransformList::Preset("validation".to_owned())
}

/// Batches to train on.
///
/// # Errors
/// If scenes or transforms cannot be had.
pub fn loader(config: &ExperimentConfig) -> Result<Box<dyn BatchLoader<TrainBatch>>> {
    let open = |entry: &TrainDataConfig| -> Result<SceneLoader> {
        let data = dataset(
            &entry.source,
            &entry.transforms,
            config.model.grid_size,
            entry.seed,
            entry.repeat,
        )?;
        Ok(SceneLoader::new(data, config.input.clone(), config.loader.clone())?)
    };
    let mut loaders = Vec::with_capacity(config.train.len());
    for (i, entry) in config.train.iter().enumerate() {
        loaders.push(open(entry).with_context(|| format!("train[{i}]"))?);
    }
    if loaders.len() == 1 && config.train[0].weight == 1 {
        return Ok(Box::new(loaders.remove(0)));
    }
    let weights = config.train.iter().map(|entry| entry.weight).collect();
    Ok(Box::new(WeightedMix::new(loaders, weights, config.mix)?))
}

/// Scenes of an evaluation.
///
/// # Errors
/// If scenes or transforms cannot be had.
pub fn evaluation(entry: &EvaluationConfig, config: &ExperimentConfig) -> Result<Arc<dyn Dataset>> {
    dataset(&entry.source, &entry.transforms, config.model.grid_size, 0, 1)
        .with_context(|| format!("evaluate {:?}", entry.name))
}

fn dataset(
    source: &SourceConfig,
    transforms: &TransformList,
    grid_size: f64,
    seed: u64,
    repeat: usize,
) -> Result<Arc<dyn Dataset>> {
    let steps = build_transforms(&transforms.steps(grid_size)?)?;
    Ok(Arc::new(source.dataset(steps, seed, repeat)?))
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
        TextConfig::Vocabulary { dim, exclude } => (Vocabulary::new(*dim)?.class_table(), exclude),
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

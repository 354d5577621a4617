//! What a run is: the settings and contents that decide its bits.

use super::config::ExperimentConfig;
use super::data::{self, ClassTexts};
use super::error::{ExperimentError, Place};
use super::teacher::Teacher;
use candle_core::DType;
use scenesplat_datasets::SourceConfig;
use scenesplat_models::ParamStore;
use scenesplat_trainers::{Identity, TrainerConfig};
use sha2::{Digest, Sha256};

/// Settings of an experiment that a resumed run may change, with the reason; in the `trainer` table
/// also [`TrainerConfig::MAY_CHANGE`]. Everything else must stay as it was. docs/training.md lists
/// them.
pub const MAY_CHANGE: [(&str, &str); 17] = [
    ("loader.workers", "batches do not depend on who makes them"),
    ("loader.prefetch", "batches do not depend on when they are made"),
    ("init_from", "the content of the files is compared"),
    ("teacher.weights", "the content of the files is compared"),
    ("teacher.config", "the content of the file is compared"),
    ("teacher.folder", "lengths and samples of the files are compared"),
    ("teacher.cache", "rows from a cache have the bits of computed ones"),
    ("text.path", "the content of the table is compared"),
    ("text.names", "the content of the table is compared"),
    ("train[*].source.root", "the names of the scenes are compared"),
    ("train[*].source.class_names", "the names are compared"),
    ("evaluate[*].source.root", "the names of the scenes are compared"),
    ("evaluate[*].source.class_names", "the names are compared"),
    ("evaluate[*].text.path", "the content of the table is compared"),
    ("evaluate[*].text.names", "the content of the table is compared"),
    // What a transform list comes to is compared step by step.
    ("train[*].transforms", "the steps that it stands for are compared"),
    ("evaluate[*].transforms", "the steps that it stands for are compared"),
];

/// The identity of an experiment: every setting that is not in [`MAY_CHANGE`], the steps that presets
/// stand for, and checksums of what it reads (class texts, first weights, names of scenes and
/// classes). `text`: the class texts that the experiment names; `first_values`: the parameters before
/// the first step; `teacher`: the teacher that it names.
///
/// # Errors
/// If a scene folder or text table cannot be read.
pub fn identity(
    config: &ExperimentConfig,
    text: Option<&ClassTexts>,
    first_values: &ParamStore,
    teacher: Option<&Teacher>,
) -> Result<Identity, ExperimentError> {
    let own = MAY_CHANGE.map(|(name, _)| name.to_owned()).into_iter();
    let loop_settings = TrainerConfig::MAY_CHANGE.map(|name| format!("trainer.{name}"));
    let may_change: Vec<String> = own.chain(loop_settings).collect();
    let mut identity =
        Identity::new().with_settings("", config)?.without(may_change.iter().map(String::as_str));
    if let Some(text) = text {
        identity = identity.with("text.content", table_hash(text));
    }
    if config.init_from.is_some() {
        identity = identity.with("init_from.content", values_hash(first_values)?);
    }
    if let Some(content) = teacher.and_then(|teacher| teacher.content.as_deref()) {
        identity = identity.with("teacher.content", content);
    }
    let grid = config.model.grid_size;
    for (i, entry) in config.train.iter().enumerate() {
        let steps = entry.transforms.steps(grid)?;
        identity = identity.with_settings(&format!("train[{i}].transforms"), &steps)?;
        identity = with_scenes(identity, &format!("train[{i}]"), &entry.source)?;
    }
    for (i, entry) in config.evaluate.iter().enumerate() {
        let steps = entry.transforms.steps(grid)?;
        identity = identity.with_settings(&format!("evaluate[{i}].transforms"), &steps)?;
        identity = with_scenes(identity, &format!("evaluate[{i}]"), &entry.source)?;
        if let Some(text) = &entry.text {
            let table = data::text_table(text)?;
            identity = identity.with(&format!("evaluate[{i}].text.content"), table_hash(&table));
        }
    }
    Ok(identity)
}

/// Adds which scenes and classes a source holds.
fn with_scenes(
    identity: Identity,
    name: &str,
    source: &SourceConfig,
) -> Result<Identity, ExperimentError> {
    let scenes = source.build().at(|| format!("{name}.source"))?;
    let ids = scenes.scene_ids();
    let listed = format!("{} scenes, {}", ids.len(), names_hash(ids));
    let identity = identity.with(&format!("{name}.source.scenes"), listed);
    Ok(match source.label_set()? {
        Some(classes) => {
            let listed = format!("{} classes, {}", classes.len(), names_hash(&classes.names));
            identity.with(&format!("{name}.source.classes"), listed)
        }
        None => identity,
    })
}

fn names_hash(names: &[String]) -> String {
    let mut hash = Sha256::new();
    for name in names {
        hash.update(name.as_bytes());
        hash.update([0]);
    }
    hex(hash)
}

fn table_hash(text: &ClassTexts) -> String {
    let mut hash = Sha256::new();
    for name in &text.table.names {
        hash.update(name.as_bytes());
        hash.update([0]);
    }
    for value in &text.table.values {
        hash.update(value.to_le_bytes());
    }
    format!("{} rows of {}, {}", text.table.len(), text.table.dim, hex(hash))
}

/// Of the first values of parameters and batch statistics, by name.
fn values_hash(params: &ParamStore) -> Result<String, ExperimentError> {
    let mut hash = Sha256::new();
    let (parameters, buffers) = (params.parameters(), params.buffers());
    for (name, var) in parameters.iter().chain(&buffers) {
        hash.update(name.as_bytes());
        hash.update([0]);
        for value in var.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()? {
            hash.update(value.to_le_bytes());
        }
    }
    Ok(hex(hash))
}

pub(super) fn hex(hash: Sha256) -> String {
    let digits: String = hash.finalize().iter().take(16).map(|b| format!("{b:02x}")).collect();
    format!("sha256 {digits}")
}

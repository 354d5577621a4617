//! Autoencoders of language features from a file.

use super::config::ExperimentConfig;
use super::data::{self, ClassTexts};
use super::error::ExperimentError;
use super::export::exported_checkpoint;
use scenesplat_models::ParamStore;
use scenesplat_models::weights::save_tensors;
use scenesplat_scene::StagedFolder;
use scenesplat_trainers::Evaluator;
use scenesplat_trainers::checkpoint::read_network;
use scenesplat_trainers::tasks::autoencoder::{AutoencoderEvaluator, AutoencoderTask};
use std::path::Path;

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// The module that is trained.
pub(super) fn module(config: &ExperimentConfig, params: ParamStore) -> Result<AutoencoderTask> {
    let Some(settings) = &config.autoencoder else {
        return Err(ExperimentError::setting("autoencoder", "the task needs this table"));
    };
    Ok(AutoencoderTask::new(settings, params)?)
}

/// What is kept of the features of other scenes; classes are compared where there are texts.
pub(super) fn evaluators(
    config: &ExperimentConfig,
    text: Option<&ClassTexts>,
) -> Result<Vec<Box<dyn Evaluator<AutoencoderTask>>>> {
    let mut all: Vec<Box<dyn Evaluator<AutoencoderTask>>> = Vec::new();
    for entry in &config.evaluations() {
        let own = entry.text.as_ref().map(data::text_table).transpose()?;
        let table = own.as_ref().or(text).map(|text| text.table.clone());
        let width = config.autoencoder.as_ref().and_then(|a| a.widths.first().copied());
        if let (Some(table), Some(width)) = (&table, width)
            && table.dim != width
        {
            let problem = format!("the texts are {} wide and the features {width}", table.dim);
            return Err(ExperimentError::setting("text", problem));
        }
        let data = data::evaluation(entry, config, None)?;
        all.push(Box::new(AutoencoderEvaluator::new(&entry.name, data, table)));
    }
    Ok(all)
}

/// Writes `model.safetensors` and `autoencoder.json` (its settings) into `folder`.
pub(super) fn export(
    config: &ExperimentConfig,
    checkpoints: &Path,
    folder: &Path,
) -> Result<Vec<String>> {
    let (dir, remark) = exported_checkpoint(checkpoints)?;
    let tensors = read_network(&dir)?.into_iter().collect();
    let mut staged = StagedFolder::create(folder)?;
    save_tensors(&tensors, &staged.add("model.safetensors"))?;
    let text = serde_json::to_string_pretty(&config.autoencoder)?;
    staged.write("autoencoder.json", text.as_bytes())?;
    staged.commit::<&str>(&[])?;
    Ok(vec![format!("autoencoder: {remark}")])
}

//! Self-supervised training from a file.

use super::config::{ExperimentConfig, TargetChoice, Task};
use super::error::{ExperimentError, Place};
use scenesplat_datasets::TransformConfig;
use scenesplat_models::ParamStore;
use scenesplat_trainers::tasks::self_supervised::{Export, SelfSupervised};

type Result<T, E = ExperimentError> = std::result::Result<T, E>;

/// Checks that views are made exactly if they are compared, and that nothing besides would have no
/// effect.
pub(super) fn check(config: &ExperimentConfig) -> Result<()> {
    let wrong = |field: &str, problem: &str| Err(ExperimentError::setting(field, problem));
    let is_task = config.task == Task::SelfSupervised;
    for (i, entry) in config.train.iter().enumerate() {
        let steps = entry.transforms.steps(config.model.grid_size)?;
        let field = format!("train[{i}].transforms");
        let at = steps.iter().position(|step| matches!(step, TransformConfig::Views(_)));
        match at {
            None if is_task => {
                return wrong(
                    &field,
                    "self-supervised training compares views: end with a `views` step",
                );
            }
            Some(_) if !is_task => {
                return wrong(&field, "only task = \"self_supervised\" compares views");
            }
            Some(at) if at + 1 < steps.len() => {
                return wrong(
                    &field,
                    "`views` comes last; give other steps before it or to its views",
                );
            }
            _ => {}
        }
    }
    let settings = match (&config.self_supervised, is_task) {
        (None, false) => return Ok(()),
        (None, true) => {
            return wrong("self_supervised", "the task needs this table, with its terms");
        }
        (Some(_), false) => {
            return wrong("self_supervised", "only task = \"self_supervised\" has it");
        }
        (Some(settings), true) => settings,
    };
    settings.check().at(|| "self_supervised".to_owned())?;
    if !config.losses.is_empty() {
        return wrong("losses", "the terms are those of self_supervised.terms; leave them out");
    }
    if !config.evaluate.is_empty() {
        return wrong(
            "evaluate",
            "there are no labels to score; use `scenesplat probe` on the model",
        );
    }
    if config.text.is_some() || config.targets != TargetChoice::Features {
        return wrong("text", "the task has neither texts nor targets; leave text and targets out");
    }
    if config.loader.mix_probability != 0.0 {
        return wrong("loader.mix_probability", "two scenes share no view; set it to 0");
    }
    if config.trainer.ema.is_some() && settings.export == Export::Teacher {
        return wrong("trainer.ema", "it averages the student; export that, or leave it out");
    }
    Ok(())
}

/// Which network becomes the model folder; `None` for other tasks.
pub(super) fn exported(config: &ExperimentConfig) -> Option<Export> {
    config.self_supervised.as_ref().map(|settings| settings.export)
}

/// The module that is trained. `params`: the student's first values.
pub(super) fn module(config: &ExperimentConfig, params: ParamStore) -> Result<SelfSupervised> {
    let Some(settings) = &config.self_supervised else {
        return Err(ExperimentError::setting("self_supervised", "the task needs this table"));
    };
    let network = config.network()?;
    Ok(SelfSupervised::new(settings, &network.model, &network.input, params, config.model_seed)?)
}

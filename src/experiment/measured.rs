//! Capture effects measured in the training scenes, for the steps that imitate them.

use super::config::{ExperimentConfig, TransformList};
use super::error::{ExperimentError, Place};
use scenesplat_datasets::{SourceConfig, TransformConfig};
use std::borrow::Cow;

/// The experiment with what is found in its scenes in each step `measured_effects` that does not say it; itself if
/// there is no such step. Each scene is read once for it. Depends on the scenes alone.
///
/// # Errors
/// If a scene cannot be read.
pub(super) fn with_measured_effects(
    config: &ExperimentConfig,
) -> Result<Cow<'_, ExperimentConfig>, ExperimentError> {
    let lists = config.train.iter().map(|entry| &entry.transforms);
    let lists = lists.chain(config.evaluate.iter().map(|entry| &entry.transforms));
    if !lists.into_iter().any(asks) {
        return Ok(Cow::Borrowed(config));
    }
    let mut config = config.clone();
    for (i, entry) in config.train.iter_mut().enumerate() {
        look(&mut entry.transforms, &entry.source).at(|| format!("train[{i}]"))?;
    }
    for entry in &mut config.evaluate {
        let source = entry.source.clone().for_evaluation();
        look(&mut entry.transforms, &source).at(|| format!("evaluate {:?}", entry.name))?;
    }
    Ok(Cow::Owned(config))
}

fn asks(list: &TransformList) -> bool {
    let open = |step: &TransformConfig| matches!(step, TransformConfig::MeasuredEffects(step) if step.found.is_none());
    matches!(list, TransformList::Steps(steps) if steps.iter().any(open))
}

fn look(list: &mut TransformList, source: &SourceConfig) -> Result<(), ExperimentError> {
    let TransformList::Steps(steps) = list else { return Ok(()) };
    for step in steps {
        if let TransformConfig::MeasuredEffects(step) = step
            && step.found.is_none()
        {
            step.look(&*source.build()?)?;
        }
    }
    Ok(())
}

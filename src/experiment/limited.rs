//! Whether the limits of an experiment fit it, and what is evaluated under them.

use super::config::{EvaluationConfig, ExperimentConfig};
use super::error::ExperimentError;
use super::limits::LimitsConfig;
use scenesplat_datasets::Amount;

/// Checks the limits of an experiment.
///
/// # Errors
/// Names the first that is out of its range or has no effect.
pub(super) fn check_limits(config: &ExperimentConfig) -> Result<(), ExperimentError> {
    let LimitsConfig { train, evaluate, overfit } = config.limits;
    let range = "a number from 1, or a share above 0 and at most 1";
    let out = |amount: Option<Amount>| amount.is_some_and(|amount| !amount.is_valid());
    let tables = config.train.len();
    for (holds, field, problem) in [
        (out(train), "limits.train", range),
        (out(evaluate), "limits.evaluate", range),
        (overfit == Some(0), "limits.overfit", "0, expected 1 or more"),
        (
            overfit.is_some() && train.is_some(),
            "limits.train",
            "has no effect beside overfit, which says the batches; leave one out",
        ),
        (
            overfit.is_some() && tables > 1 && !config.evaluate.is_empty(),
            "limits.overfit",
            "evaluations read the scenes of one dataset; give one [[train]], or no [[evaluate]]",
        ),
        (
            evaluate.is_some() && config.evaluate.is_empty(),
            "limits.evaluate",
            "has no effect without [[evaluate]]",
        ),
    ] {
        if holds {
            return Err(ExperimentError::setting(field, problem));
        }
    }
    Ok(())
}

impl ExperimentConfig {
    /// The evaluations as they are made: those of the file, with `limits.overfit` on the scenes that are trained on.
    pub(super) fn evaluations(&self) -> Vec<EvaluationConfig> {
        let seen = |entry: &EvaluationConfig| match (self.limits.overfit, self.train.first()) {
            (Some(_), Some(data)) => {
                EvaluationConfig { source: data.source.clone(), text: None, ..entry.clone() }
            }
            _ => entry.clone(),
        };
        self.evaluate.iter().map(seen).collect()
    }
}

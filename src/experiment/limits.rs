//! An experiment on less data than there is.

use super::config::{EvaluationConfig, ExperimentConfig};
use super::error::ExperimentError;
use scenesplat_datasets::{Amount, BatchLoader, LimitedLoader, TrainBatch};
use scenesplat_kernels::settings;

settings! {
    /// Less data than there is: for a quick look, or to see whether a network can learn at all.
    #[derive(Copy)]
    pub struct LimitsConfig {
        /// Batches of each epoch: a number, or a share such as 0.1.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub train: Option<Amount> = None,
        /// Scenes of each evaluation: a number, or a share.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub evaluate: Option<Amount> = None,
        /// Trains on so many batches again and again: the first ones of the first epoch, with the same augmentation. All
        /// evaluations read the scenes of these batches in place of their own.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub overfit: Option<usize> = None,
    }
}

impl LimitsConfig {
    /// Whether all data are used.
    pub fn is_off(&self) -> bool {
        *self == Self::default()
    }

    /// The loader with these limits.
    pub(super) fn of_loader(
        &self,
        loader: Box<dyn BatchLoader<TrainBatch>>,
    ) -> Box<dyn BatchLoader<TrainBatch>> {
        match (self.overfit, self.train) {
            (Some(batches), _) => Box::new(LimitedLoader::same(loader, batches)),
            (None, Some(amount)) => {
                let batches = amount.of(loader.batches_per_epoch());
                Box::new(LimitedLoader::first(loader, batches))
            }
            (None, None) => loader,
        }
    }
}

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

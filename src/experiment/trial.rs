//! A few batches of everything that a run does, without leaving anything on the disk.

use super::config::ExperimentConfig;
use super::error::ExperimentError;
use super::measured::with_measured_effects;
use super::module::{Opened, Work, optimizer, schedule};
use super::run::MakeConsole;
use candle_core::Device;
use scenesplat_datasets::{Amount, TrainBatch};
use scenesplat_trainers::{DataModule, Progress, Trainer, TrainingModule};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What came of a trial.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrialReport {
    /// Optimizer steps.
    pub steps: u64,
    /// Batches of each step.
    pub accumulate: u64,
    /// Names of the evaluations, each of which read a few scenes.
    pub evaluations: Vec<String>,
    /// Things to know.
    pub remarks: Vec<String>,
}

/// Trains on so many batches (more, if a step takes more), and evaluates on as many scenes of each evaluation. Writes no
/// log, checkpoint or model: it shows that data, network, losses and evaluations fit together.
///
/// # Errors
/// As [`train`](super::train).
pub fn try_out(
    config: &ExperimentConfig,
    batches: usize,
    device: &Device,
    console: Option<MakeConsole>,
    stop: Arc<AtomicBool>,
) -> Result<TrialReport, ExperimentError> {
    let mut config = with_measured_effects(config)?.into_owned();
    let accumulate = config.trainer.accumulate;
    let steps = batches.div_ceil(accumulate as usize).max(1);
    config.limits.overfit = None;
    config.limits.train = Some(Amount::Count(steps * accumulate as usize));
    config.limits.evaluate = (!config.evaluate.is_empty()).then_some(Amount::Count(batches.max(1)));
    config.trainer.epochs = 1;
    config.trainer.max_steps = None;
    config.trainer.log_every = 1;
    config.trainer.eval_every = 1;
    config.trainer.checkpoint.dir = None;
    let mut opened = Opened::of(&config, device)?;
    let trial = Trial { config: &config, console, stop };
    let end = opened.with_module(&config, &trial)?;
    Ok(TrialReport {
        steps: end.step,
        accumulate,
        evaluations: config.evaluate.iter().map(|entry| entry.name.clone()).collect(),
        remarks: opened.remarks,
    })
}

struct Trial<'a> {
    config: &'a ExperimentConfig,
    console: Option<MakeConsole>,
    stop: Arc<AtomicBool>,
}

impl Work for Trial<'_> {
    type Out = Progress;

    fn with<M: TrainingModule<Batch = TrainBatch>>(
        &self,
        module: &M,
        mut data: DataModule<'_, M>,
    ) -> Result<Progress, ExperimentError> {
        let optimizer = optimizer(&self.config.optimizer, module.params())?;
        let settings = self.config.trainer.clone();
        let mut trainer = Trainer::new(settings, optimizer, schedule(self.config)?)?
            .with_stop(Arc::clone(&self.stop));
        if let Some(console) = self.console {
            trainer = trainer.with_callback(console());
        }
        // Its measurement is one of those that may be misspelt.
        if let Some(stopping) = &self.config.early_stopping {
            trainer = trainer.with_callback(stopping.callback());
        }
        Ok(trainer.fit(module, &mut data, Progress::default())?)
    }
}

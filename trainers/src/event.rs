//! What happens in a run, and who is told.

use crate::{Criterion, TrainError};
use scenesplat_datasets::LeftOut;
use scenesplat_metrics::Measurement;
use std::path::Path;

/// Where a run stands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// Optimizer steps done.
    pub step: u64,
    /// Epoch under way, from 0.
    pub epoch: u64,
    /// Planned steps.
    pub total_steps: u64,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// All steps done.
    Finished,
    /// A callback or the user asked to stop; it can be resumed.
    Stopped,
}

/// Something happened.
#[derive(Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// Before the first step.
    FitStart {
        /// Values of all trainable parameters.
        parameters: usize,
        /// Steps in an epoch.
        steps_per_epoch: u64,
        /// Batches at the end of each epoch that do not fill a step (`accumulate`) and are left out.
        leftover_batches: u64,
    },
    /// After an optimizer step, each `log_every` steps and after the last.
    Step {
        /// Loss, its terms, learning rate, gradient norm, seconds a step.
        measurements: &'a [Measurement],
    },
    /// After an evaluator ran.
    Eval {
        /// Which evaluator.
        name: &'a str,
        /// What it found, names prefixed with the evaluator's.
        measurements: &'a [Measurement],
    },
    /// After all evaluators ran: everything they found.
    Evaluated {
        /// With full names, such as `unseen/f-mIoU`.
        measurements: &'a [Measurement],
    },
    /// At the end of an epoch: what of the data was left out or repaired, if that is more than said
    /// before.
    Data {
        /// `train`, or the name of an evaluator.
        name: &'a str,
        /// Counts and reasons, of the whole run so far.
        left_out: &'a LeftOut,
    },
    /// Something looks wrong although every number is finite.
    Alarm {
        /// What, and what may help.
        message: &'a str,
    },
    /// A checkpoint is complete on disk.
    Checkpoint {
        /// Its folder.
        dir: &'a Path,
        /// Whether it is the best one so far.
        best: bool,
    },
    /// After the last step.
    FitEnd {
        /// Why.
        end: End,
    },
}

/// Whether to go on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// Go on.
    Continue,
    /// Save, and leave.
    Stop,
}

impl Flow {
    /// Stops if either does.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        if other == Self::Stop { other } else { self }
    }
}

/// Watches a run: logs, progress bars, early stopping. Cannot change the model.
pub trait Callback: Send {
    /// Called for every event, in the order in which callbacks were added.
    ///
    /// # Errors
    /// If it cannot do its work, a log that cannot be written, say: the run ends.
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError>;

    /// The measurement that it waits for, with the setting that names it; the run does not begin if
    /// no evaluator gives it.
    fn waits_for(&self) -> Option<(&'static str, &Criterion)> {
        None
    }

    /// What must survive a resume, under the callback's name; `None` if nothing.
    fn state(&self) -> Option<(&'static str, serde_json::Value)> {
        None
    }

    /// Takes back what [`state`](Self::state) gave.
    ///
    /// # Errors
    /// If the value is none of its own.
    fn load_state(&mut self, _state: &serde_json::Value) -> Result<(), TrainError> {
        Ok(())
    }
}

impl<C: Callback + ?Sized> Callback for Box<C> {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        (**self).on_event(event, at)
    }

    fn waits_for(&self) -> Option<(&'static str, &Criterion)> {
        (**self).waits_for()
    }

    fn state(&self) -> Option<(&'static str, serde_json::Value)> {
        (**self).state()
    }

    fn load_state(&mut self, state: &serde_json::Value) -> Result<(), TrainError> {
        (**self).load_state(state)
    }
}

/// Scores a module, on data of its own.
pub trait Evaluator<M: ?Sized>: Send {
    /// Prefix of its measurements, `snake_case`.
    fn name(&self) -> &str;

    /// Names of the measurements that it may give, without the prefix. Settings that name one are
    /// checked against them before the first step.
    fn measurements(&self) -> Vec<String>;

    /// What was left out or repaired in the scenes read so far.
    fn left_out(&self) -> LeftOut {
        LeftOut::default()
    }

    /// Runs the whole evaluation; must not change the module.
    ///
    /// # Errors
    /// If data cannot be read or the module fails.
    fn run(&mut self, module: &M, at: Progress) -> Result<Vec<Measurement>, TrainError>;
}

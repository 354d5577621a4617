//! What is trained: a model together with how it learns from a batch.

use candle_core::{Tensor, Var};
use scenesplat_models::{Backbone, Forward, ParamStore};
use std::collections::BTreeMap;

/// What a step gets besides its batch.
pub struct StepContext<'a> {
    /// Mode, randomness and recomputation of the forward pass.
    pub forward: Forward<'a>,
    /// Part of the run that is done, `0..1`: for terms with a schedule.
    pub progress: f64,
    /// Optimizer steps done before this one: what a schedule of a module's own goes by.
    pub step: u64,
    /// Planned steps.
    pub total_steps: u64,
    /// Seed of whatever else is random in this step. The same after a resume.
    pub seed: u64,
}

/// What a step returns. The trainer, not the module, runs `backward`.
pub struct StepOutput {
    /// What is minimized. Scalar f32
    pub loss: Tensor,
    /// Rows of the batch.
    pub rows: usize,
    /// Rows that the loss looks at (they have a label, or a target). A run in which none counts for a
    /// whole epoch stops with an error.
    pub counted_rows: usize,
    /// For the log: values by name, e.g. of each term of the loss that was on, detached. Where a step
    /// has several batches, the mean over those that have the name is logged.
    pub terms: Vec<(String, f64)>,
    /// Detached output rows, `[N, D]`, for the collapse alarms; `None` if they would mean nothing.
    pub features: Option<Tensor>,
}

/// What a module gets after an optimizer step.
pub struct AfterStep<'a> {
    /// Number of the step that was taken, from 0.
    pub step: u64,
    /// Planned steps.
    pub total_steps: u64,
    /// The parameters that the optimizer moved, by name: those of [`TrainingModule::params`] that
    /// are not frozen.
    pub trained: &'a BTreeMap<String, Var>,
}

/// A model together with how it learns from a batch.
///
/// There is nothing here about optimizers, loaders or logging: those are arguments of the
/// [`Trainer`](crate::Trainer).
pub trait TrainingModule {
    /// Host memory, made by loader threads.
    type Batch: Send;

    /// The parameters that optimizer and checkpoints see.
    fn params(&self) -> &ParamStore;

    /// Forward pass and loss. Must neither call `backward` nor change a parameter (batch statistics
    /// may move).
    ///
    /// # Errors
    /// If the batch does not fit the model.
    fn training_step(
        &self,
        batch: &Self::Batch,
        cx: &mut StepContext<'_>,
    ) -> candle_core::Result<StepOutput>;

    /// Called after each optimizer step: what moves by other rules than gradients, such as a teacher
    /// that follows its student ([`ema_update`](crate::ema_update) by a
    /// [`CosineSchedule`](crate::CosineSchedule) of the step).
    ///
    /// What it changes must be in [`stores`](Self::stores), and may depend on the step and on
    /// parameters alone; then a resumed run has the bits of an uninterrupted one.
    ///
    /// # Errors
    /// If an update fails; the run ends.
    fn after_step(&self, _cx: &AfterStep<'_>) -> Result<(), crate::TrainError> {
        Ok(())
    }

    /// Further stores that checkpoints keep, by name (`snake_case`; the name of their file): a
    /// teacher's parameters, say. The optimizer does not see them.
    fn stores(&self) -> Vec<(&'static str, &ParamStore)> {
        Vec::new()
    }

    /// Whether there is nothing to learn from a batch; it is then passed over, but counted.
    fn is_empty(&self, _batch: &Self::Batch) -> bool {
        false
    }

    /// Names of the scenes in a batch, for messages.
    fn scenes(&self, _batch: &Self::Batch) -> Vec<String> {
        Vec::new()
    }

    /// What in a batch is not finite, such as `scene-7: color of row 12 is NaN`. Asked when a loss or
    /// gradient is not finite.
    fn suspects(&self, _batch: &Self::Batch) -> Vec<String> {
        Vec::new()
    }
}

/// A module with one network, which the [`evaluators`](crate::evaluators) can run: a task of one's own
/// that has it is scored as ours are.
pub trait HasBackbone {
    /// The network whose rows are scored: language features or logits.
    fn backbone(&self) -> &dyn Backbone;
}

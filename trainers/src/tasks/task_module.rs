//! A task as the trainer sees it.

use super::input::bad_values;
use super::learner::Learner;
use crate::TrainError;
use crate::module::{AfterStep, HasBackbone, StepContext, StepOutput, TrainingModule};
use scenesplat_datasets::TrainBatch;
use scenesplat_losses::Objective;
use scenesplat_models::{Backbone, ParamStore};

/// What a network is trained for: what a batch asks of it.
///
/// A task with targets for the rows of a batch is one function:
///
/// ```
/// use scenesplat_datasets::TrainBatch;
/// use scenesplat_models::{Backbone, Forward};
/// use scenesplat_trainers::tasks::{Learner, RowTargets, TrainingTask, point_cloud};
/// use scenesplat_trainers::{StepContext, StepOutput};
///
/// /// The rows shall be those of another network.
/// struct Imitation {
///     teacher: Box<dyn Backbone>,
/// }
///
/// impl TrainingTask for Imitation {
///     fn step(
///         &self,
///         learner: &Learner,
///         batch: &TrainBatch,
///         cx: &mut StepContext<'_>,
///     ) -> candle_core::Result<StepOutput> {
///         let teach = &mut Forward::eval(cx.forward.rng);
///         let target = self.teacher.forward(&point_cloud(batch)?, teach)?.detach();
///         let pred = learner.forward(batch, cx)?;
///         learner.output(&pred, RowTargets { target: Some(&target), ..Default::default() }, cx)
///     }
/// }
/// ```
///
/// What has several views of a batch, further networks or a teacher that follows its student needs
/// [`after_step`](Self::after_step) and [`stores`](Self::stores) besides.
pub trait TrainingTask: Send + Sync {
    /// As [`TrainingModule::training_step`].
    ///
    /// # Errors
    /// If the batch does not fit the network or the task.
    fn step(
        &self,
        learner: &Learner,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> candle_core::Result<StepOutput>;

    /// As [`TrainingModule::after_step`].
    ///
    /// # Errors
    /// If an update fails; the run ends.
    fn after_step(&self, _learner: &Learner, _cx: &AfterStep<'_>) -> Result<(), TrainError> {
        Ok(())
    }

    /// As [`TrainingModule::stores`].
    fn stores(&self) -> Vec<(&'static str, &ParamStore)> {
        Vec::new()
    }
}

/// A [`Learner`] and its [task](TrainingTask), for the [`Trainer`](crate::Trainer) and the
/// [`evaluators`](crate::evaluators).
pub struct TaskModule {
    learner: Learner,
    task: Box<dyn TrainingTask>,
}

impl TaskModule {
    /// `model` must have been built from `params`.
    pub fn new(
        params: ParamStore,
        model: impl Backbone + 'static,
        objective: Objective,
        task: impl TrainingTask + 'static,
    ) -> Self {
        Self { learner: Learner::new(params, model, objective), task: Box::new(task) }
    }
}

impl HasBackbone for TaskModule {
    fn backbone(&self) -> &dyn Backbone {
        self.learner.backbone()
    }
}

impl TrainingModule for TaskModule {
    type Batch = TrainBatch;

    fn params(&self) -> &ParamStore {
        self.learner.params()
    }

    fn training_step(
        &self,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> candle_core::Result<StepOutput> {
        self.task.step(&self.learner, batch, cx)
    }

    fn after_step(&self, cx: &AfterStep<'_>) -> Result<(), TrainError> {
        self.task.after_step(&self.learner, cx)
    }

    fn stores(&self) -> Vec<(&'static str, &ParamStore)> {
        self.task.stores()
    }

    fn is_empty(&self, batch: &TrainBatch) -> bool {
        batch.is_empty()
    }

    fn scenes(&self, batch: &TrainBatch) -> Vec<String> {
        batch.ids.clone()
    }

    fn suspects(&self, batch: &TrainBatch) -> Vec<String> {
        bad_values(batch)
    }
}

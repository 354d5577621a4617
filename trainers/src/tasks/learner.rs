//! What every task has: a network, its parameters and its losses.

use super::input::point_cloud;
use crate::module::{StepContext, StepOutput};
use candle_core::{Result, Tensor};
use scenesplat_datasets::TrainBatch;
use scenesplat_losses::{IGNORE, LossInput, Objective};
use scenesplat_models::{Backbone, ParamStore};

/// A network that learns, its parameters, and what is minimized.
pub struct Learner {
    params: ParamStore,
    model: Box<dyn Backbone>,
    objective: Objective,
}

/// What the rows of a batch shall be. What is `None`, the losses do without, or fail.
#[derive(Debug, Clone, Copy, Default)]
pub struct RowTargets<'a> {
    /// Features. `[N, D]`
    pub target: Option<&'a Tensor>,
    /// Which rows have a feature; all if `None`. `[N]`
    pub valid: Option<&'a [bool]>,
    /// Classes, -1 for none. `[N]`
    pub label: Option<&'a [i32]>,
}

impl Learner {
    /// `model` must have been built from `params`.
    pub fn new(params: ParamStore, model: impl Backbone + 'static, objective: Objective) -> Self {
        Self { params, model: Box::new(model), objective }
    }

    /// The parameters that are trained.
    pub fn params(&self) -> &ParamStore {
        &self.params
    }

    /// The network.
    pub fn backbone(&self) -> &dyn Backbone {
        self.model.as_ref()
    }

    /// The network's rows for a batch. `[N, D]`
    ///
    /// # Errors
    /// If the batch does not fit the network.
    pub fn forward(&self, batch: &TrainBatch, cx: &mut StepContext<'_>) -> Result<Tensor> {
        self.model.forward(&point_cloud(batch)?, &mut cx.forward)
    }

    /// The losses of predicted rows, `[N, D]`, and their terms for the log.
    ///
    /// Rows count if they have a target, or a label where no target is given or none is there; none
    /// does in a step without any term.
    ///
    /// # Errors
    /// If a loss fails, or lacks what it asks for.
    pub fn output(
        &self,
        pred: &Tensor,
        targets: RowTargets<'_>,
        cx: &StepContext<'_>,
    ) -> Result<StepOutput> {
        let RowTargets { target, valid, label } = targets;
        let (progress, seed) = (cx.progress, cx.seed);
        let input = LossInput { pred, target, label, valid, progress, seed };
        let out = self.objective.forward(&input)?;
        let terms = out
            .terms
            .iter()
            .map(|term| Ok((term.name.clone(), f64::from(term.value.to_scalar::<f32>()?))))
            .collect::<Result<_>>()?;
        let rows = pred.dim(0)?;
        let with_target = match (target, valid) {
            (None, _) => 0,
            (Some(_), None) => rows,
            (Some(_), Some(valid)) => valid.iter().filter(|v| **v).count(),
        };
        let labels = || label.map_or(0, |l| l.iter().filter(|l| **l != IGNORE).count());
        let counted_rows = match (out.terms.is_empty(), with_target) {
            (true, _) => 0,
            (false, 0) => labels(),
            (false, count) => count,
        };
        let features = Some(pred.detach());
        Ok(StepOutput { loss: out.total, rows, counted_rows, terms, features })
    }
}

//! Supervised segmentation: a class for each row.

use super::input::{bad_values, evaluate, point_cloud};
use crate::module::{HasBackbone, StepContext, StepOutput, TrainingModule};
use candle_core::{Result, bail};
use scenesplat_datasets::TrainBatch;
use scenesplat_losses::{LossInput, Objective};
use scenesplat_models::{Backbone, ParamStore};

/// A network with a classifier, and its losses (usually cross entropy and Lovász softmax).
///
/// # Source
/// `DefaultSegmentorV2`, SceneSplat be9d5e1.
pub struct SemanticSegmentation {
    params: ParamStore,
    model: Box<dyn Backbone>,
    objective: Objective,
}

impl SemanticSegmentation {
    /// `model` gives logits and must have been built from `params`.
    pub fn new(params: ParamStore, model: impl Backbone + 'static, objective: Objective) -> Self {
        Self { params, model: Box::new(model), objective }
    }
}

impl HasBackbone for SemanticSegmentation {
    fn backbone(&self) -> &dyn Backbone {
        self.model.as_ref()
    }
}

impl TrainingModule for SemanticSegmentation {
    type Batch = TrainBatch;

    fn params(&self) -> &ParamStore {
        &self.params
    }

    fn training_step(&self, batch: &TrainBatch, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let Some(labels) = &batch.segment else {
            bail!("segment: none of the scenes {} has labels", batch.ids.join(", "));
        };
        let logits = self.model.forward(&point_cloud(batch)?, &mut cx.forward)?;
        let input = LossInput {
            pred: &logits,
            target: None,
            label: Some(labels),
            valid: None,
            progress: cx.progress,
            seed: cx.seed,
        };
        evaluate(&self.objective, &input, Some(&logits))
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

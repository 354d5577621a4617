//! Supervised segmentation: a class for each row.

use super::learner::{Learner, RowTargets};
use super::task_module::TrainingTask;
use crate::module::{StepContext, StepOutput};
use candle_core::{Result, bail};
use scenesplat_datasets::TrainBatch;

/// A network that gives logits, and losses of classes (usually cross entropy and Lovász softmax).
///
/// # Source
/// `DefaultSegmentorV2`, SceneSplat be9d5e1.
#[derive(Debug, Clone, Copy, Default)]
pub struct SemanticSegmentation;

impl TrainingTask for SemanticSegmentation {
    fn step(
        &self,
        learner: &Learner,
        batch: &TrainBatch,
        cx: &mut StepContext<'_>,
    ) -> Result<StepOutput> {
        let Some(label) = batch.segment.as_deref() else {
            bail!("segment: none of the scenes {} has labels", batch.ids.join(", "));
        };
        let logits = learner.forward(batch, cx)?;
        learner.output(&logits, RowTargets { label: Some(label), ..RowTargets::default() }, cx)
    }
}

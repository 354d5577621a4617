//! Supervised segmentation: the class with the largest logit, compared with the truth.

use super::scenes::{for_each, some_label, values};
use crate::TrainError;
use crate::event::{Evaluator, Progress};
use crate::tasks::SemanticSegmentation;
use scenesplat_datasets::{Dataset, InputFeatures, LeftOut};
use scenesplat_metrics::{ConfusionMatrix, Measurement, Metric, TesterReport};
use std::sync::Arc;

/// Labels every voxel with its largest logit and measures mIoU, mAcc, allAcc (as
/// [`ConfusionMatrix`]).
///
/// # Source
/// `SemSegEvaluator`, SceneSplat be9d5e1. Differs: averages are over the classes that occur, not
/// over all.
pub struct SegmentationEvaluator {
    name: String,
    data: Arc<dyn Dataset>,
    features: InputFeatures,
    excluded: Vec<usize>,
}

impl SegmentationEvaluator {
    /// `data` ends with a grid sample; `excluded` classes are left out of the averages that begin
    /// with f.
    pub fn new(
        name: impl Into<String>,
        data: Arc<dyn Dataset>,
        features: InputFeatures,
        excluded: Vec<usize>,
    ) -> Self {
        Self { name: name.into(), data, features, excluded }
    }
}

impl Evaluator<SemanticSegmentation> for SegmentationEvaluator {
    fn name(&self) -> &str {
        &self.name
    }

    fn left_out(&self) -> LeftOut {
        self.data.left_out()
    }

    fn measurements(&self) -> Vec<String> {
        TesterReport::NAMES.map(str::to_owned).to_vec()
    }

    fn run(
        &mut self,
        module: &SemanticSegmentation,
        _: Progress,
    ) -> Result<Vec<Measurement>, TrainError> {
        let classes = module.model().out_channels();
        let mut confusion = ConfusionMatrix::new(classes)?.with_excluded(&self.excluded)?;
        for_each(self.data.as_ref(), &self.features, module.model(), |_, labels, out| {
            let logits = values(out)?;
            let predicted: Vec<i32> = logits.chunks_exact(classes).map(largest).collect();
            Ok(confusion.update((&predicted, labels))?)
        })?;
        some_label(&self.name, self.data.len(), &confusion)?;
        Ok(confusion.measure())
    }
}

/// Index of the largest value, the first of equal ones.
fn largest(row: &[f32]) -> i32 {
    let mut best = 0;
    for (i, value) in row.iter().enumerate() {
        if *value > row[best] {
            best = i;
        }
    }
    best as i32
}

//! Zero-shot segmentation: the class whose text is nearest, compared with the truth.

use super::scenes::{for_each, some_label, values};
use crate::TrainError;
use crate::event::{Evaluator, Progress};
use crate::tasks::LanguagePretraining;
use scenesplat_datasets::{Dataset, InputFeatures, LeftOut};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, Measurement, Metric, TesterReport, TextTable, ZeroShotOptions,
    classify, vote,
};
use std::sync::Arc;

/// Labels every voxel by the nearest of the class texts and measures mIoU, mAcc, allAcc, f-mIoU,
/// f-mAcc (as [`ConfusionMatrix`]).
///
/// # Source
/// `LangPretrainZeroShotSemSegEval`, SceneSplat be9d5e1. Differs: numbers are those of the tester;
/// scenes are looked at one by one, so none votes in another.
pub struct ZeroShotEvaluator {
    name: String,
    data: Arc<dyn Dataset>,
    features: InputFeatures,
    text: TextTable,
    excluded: Vec<usize>,
    vote_k: usize,
}

impl ZeroShotEvaluator {
    /// `data` ends with a grid sample; its labels index the rows of `text`. `excluded` classes (wall,
    /// floor, ceiling) are left out of the averages that begin with f.
    pub fn new(
        name: impl Into<String>,
        data: Arc<dyn Dataset>,
        features: InputFeatures,
        text: TextTable,
        excluded: Vec<usize>,
    ) -> Self {
        Self { name: name.into(), data, features, text, excluded, vote_k: 1 }
    }

    /// Each voxel takes the majority of its `k` nearest; 1 is none.
    #[must_use]
    pub fn with_vote(mut self, k: usize) -> Self {
        self.vote_k = k;
        self
    }

    /// The counts over all scenes.
    ///
    /// # Errors
    /// If data cannot be read or the network fails.
    pub fn confusion(
        &self,
        model: &dyn scenesplat_models::Backbone,
    ) -> Result<ConfusionMatrix, TrainError> {
        let classes = self.text.num_classes();
        let mut confusion = ConfusionMatrix::new(classes)?.with_excluded(&self.excluded)?;
        for_each(self.data.as_ref(), &self.features, model, |batch, labels, out| {
            let found = values(out)?;
            let rows = FeatureSlice::new(&found, model.out_channels())?;
            let mut predicted = classify(&rows, &self.text, &ZeroShotOptions::default())?.labels;
            if self.vote_k > 1 {
                let (coord, k) = (&batch.coord, self.vote_k.min(batch.len()));
                predicted = vote(coord, &predicted, None, coord, k, classes)?;
            }
            Ok(confusion.update((&predicted, labels))?)
        })?;
        Ok(confusion)
    }
}

impl Evaluator<LanguagePretraining> for ZeroShotEvaluator {
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
        module: &LanguagePretraining,
        _: Progress,
    ) -> Result<Vec<Measurement>, TrainError> {
        let confusion = self.confusion(module.model())?;
        some_label(&self.name, self.data.len(), &confusion)?;
        Ok(confusion.measure())
    }
}

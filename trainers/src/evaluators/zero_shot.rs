//! Zero-shot segmentation: the class whose text is nearest, compared with the truth.

use super::own_metric::OwnMetrics;
use super::scene_evaluator::{Labelling, SceneEvaluator};
use super::scenes::VOTE_K;
use crate::TrainError;
use scenesplat_datasets::{Dataset, InputFeatures};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, TextRows, VoteRule, ZeroShotOptions, classify,
};
use scenesplat_models::Backbone;
use scenesplat_scene::TextTable;
use std::sync::Arc;

/// Labels every Gaussian by the class text nearest to the feature of its voxel and measures the
/// numbers of [`Scores`](super::Scores).
///
/// Where a scene has labeled points with classes, they are scored, else every labeled Gaussian.
/// Each takes the majority of the [`VOTE_K`] Gaussians nearest to it that have a language feature
/// in the data (all, if the data do not say).
///
/// # Source
/// `LangPretrainZeroShotSemSegEval`, SceneSplat be9d5e1. Differs: numbers are those of the tester,
/// and so are the voters: all Gaussians, not one a voxel, and all labeled points; scenes are scored
/// one by one, so none votes in another; labels never use instances of the truth.
pub type ZeroShotEvaluator = SceneEvaluator<NearestText>;

/// The class whose text has the largest cosine with the row; -1 for rows of no direction.
#[derive(Debug, Clone)]
pub struct NearestText(TextTable);

impl ZeroShotEvaluator {
    /// `data` ends with a grid sample that keeps the full scene, as
    /// [`validation`](scenesplat_datasets::transforms::validation) does (else the sample is the scene);
    /// its labels index the rows of `text`. `excluded` classes (wall, floor, ceiling) are left out of
    /// the averages that begin with f.
    pub fn new(
        name: impl Into<String>,
        data: Arc<dyn Dataset>,
        features: InputFeatures,
        text: TextTable,
        excluded: Vec<usize>,
    ) -> Self {
        let (name, labelling, own) = (name.into(), NearestText(text), OwnMetrics::default());
        Self { name, data, features, labelling, excluded, vote: VoteRule::of(VOTE_K), own }
    }

    /// The network's classes against the truth: a part of [`scores`](Self::scores).
    ///
    /// # Errors
    /// As [`scores`](Self::scores).
    pub fn confusion(&self, model: &dyn Backbone) -> Result<ConfusionMatrix, TrainError> {
        Ok(self.scores(model)?.model)
    }
}

impl Labelling for NearestText {
    fn classify(&self, rows: &[f32], width: usize) -> Result<Vec<i32>, TrainError> {
        let text = TextRows::new(&self.0.values, self.0.dim)?;
        let rows = FeatureSlice::new(rows, width)?;
        Ok(classify(&rows, text, &ZeroShotOptions::default())?.labels)
    }

    /// Of the text of each class: itself, or an earlier class of the same text.
    fn answers(&self, _: usize) -> Result<Vec<i32>, TrainError> {
        let text = TextRows::new(&self.0.values, self.0.dim)?;
        self.classify(text.rows(), text.dim())
    }
}

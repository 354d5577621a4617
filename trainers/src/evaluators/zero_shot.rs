//! Zero-shot segmentation: the class whose text is nearest, compared with the truth.

use super::own_metric::OwnMetrics;
use super::scenes::{Protocol, VOTE_K};
use crate::TrainError;
use crate::event::{Evaluator, Progress};
use crate::module::HasBackbone;
use scenesplat_datasets::{Dataset, FullScene, InputFeatures, LeftOut};
use scenesplat_metrics::{
    ConfusionMatrix, FeatureSlice, Measurement, Metric, Scores, TextRows, VoteRule,
    ZeroShotOptions, classify,
};
use scenesplat_models::Backbone;
use scenesplat_scene::TextTable;
use std::sync::Arc;

/// Labels every Gaussian by the class text nearest to the feature of its voxel and measures the
/// numbers of [`Scores`].
///
/// Where a scene has labelled points with classes, they are scored, else every labelled Gaussian.
/// Each takes the majority of the [`VOTE_K`] Gaussians nearest to it that have a language feature
/// in the data (all, if the data do not say).
///
/// # Source
/// `LangPretrainZeroShotSemSegEval`, SceneSplat be9d5e1. Differs: numbers are those of the tester,
/// and so are the voters: all Gaussians, not one a voxel, and all labelled points; scenes are looked
/// at one by one, so none votes in another; labels never use instances of the truth.
pub struct ZeroShotEvaluator {
    name: String,
    data: Arc<dyn Dataset>,
    features: InputFeatures,
    text: TextTable,
    excluded: Vec<usize>,
    vote_k: usize,
    own: OwnMetrics,
}

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
        Self {
            name: name.into(),
            data,
            features,
            text,
            excluded,
            vote_k: VOTE_K,
            own: OwnMetrics::default(),
        }
    }

    /// Each scored point or Gaussian takes the majority of the `k` nearest; for Gaussians, 1 is no
    /// vote.
    #[must_use]
    pub fn with_vote(mut self, k: usize) -> Self {
        self.vote_k = k;
        self
    }

    /// Feeds a metric of one's own too, with the predicted and the true class of what is scored (-1 for
    /// none), scene by scene; each evaluation begins with the metric as it is given here.
    #[must_use]
    pub fn with_metric<M>(mut self, metric: M) -> Self
    where
        M: for<'a> Metric<Update<'a> = (&'a [i32], &'a [i32])> + Clone + 'static,
    {
        self.own.add(metric);
        self
    }

    /// The counts over all scenes.
    ///
    /// # Errors
    /// If data cannot be read, none is labelled, or the network fails.
    pub fn scores(&self, model: &dyn Backbone) -> Result<Scores, TrainError> {
        self.scores_and_own(model, &mut self.own.fresh())
    }

    fn scores_and_own(
        &self,
        model: &dyn Backbone,
        own: &mut OwnMetrics,
    ) -> Result<Scores, TrainError> {
        self.run_with(model, own, |_, _, _| Ok(()))
    }

    /// As [`scores`](Self::scores); `onlooker` sees what is scored of every scene, and rows and classes of
    /// its sample.
    pub(super) fn run_with(
        &self,
        model: &dyn Backbone,
        own: &mut OwnMetrics,
        mut onlooker: impl FnMut(&str, &FullScene, (&[f32], &[i32])) -> Result<(), TrainError>,
    ) -> Result<Scores, TrainError> {
        let width = model.out_channels();
        let label = |id: &str, full: &FullScene, rows: &[f32]| {
            let classes = self.classify(rows, width)?;
            onlooker(id, full, (rows, &classes))?;
            Ok(classes)
        };
        self.protocol()?.run(&self.name, self.data.as_ref(), &self.features, model, own, label)
    }

    pub(super) fn protocol(&self) -> Result<Protocol<'_>, TrainError> {
        let (answers, vote) = (self.answers()?, VoteRule::of(self.vote_k));
        Ok(Protocol { excluded: &self.excluded, answers, vote })
    }

    /// The class of each row, -1 for rows of no direction.
    pub(super) fn classify(&self, rows: &[f32], width: usize) -> Result<Vec<i32>, TrainError> {
        let text = TextRows::new(&self.text.values, self.text.dim)?;
        let rows = FeatureSlice::new(rows, width)?;
        Ok(classify(&rows, text, &ZeroShotOptions::default())?.labels)
    }

    pub(super) fn own_metrics(&self) -> OwnMetrics {
        self.own.fresh()
    }

    pub(super) fn title(&self) -> &str {
        &self.name
    }

    pub(super) fn data_left_out(&self) -> LeftOut {
        self.data.left_out()
    }

    /// What the network said, against the truth: a part of [`scores`](Self::scores).
    ///
    /// # Errors
    /// As [`scores`](Self::scores).
    pub fn confusion(&self, model: &dyn Backbone) -> Result<ConfusionMatrix, TrainError> {
        Ok(self.scores(model)?.model)
    }

    /// What the text of each class comes out as: itself, or an earlier class of the same text.
    fn answers(&self) -> Result<Vec<i32>, TrainError> {
        let text = TextRows::new(&self.text.values, self.text.dim)?;
        self.classify(text.rows(), text.dim())
    }
}

impl<M: HasBackbone> Evaluator<M> for ZeroShotEvaluator {
    fn name(&self) -> &str {
        &self.name
    }

    fn left_out(&self) -> LeftOut {
        self.data.left_out()
    }

    fn measurements(&self) -> Vec<String> {
        [Scores::names(), self.own.names()].concat()
    }

    fn run(&mut self, module: &M, _: Progress) -> Result<Vec<Measurement>, TrainError> {
        let mut own = self.own.fresh();
        let scores = self.scores_and_own(module.backbone(), &mut own)?;
        Ok([scores.measurements(), own.measure()].concat())
    }
}

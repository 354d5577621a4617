//! What the evaluators of scenes share: their data, who votes, and metrics of the caller.

use super::own_metric::OwnMetrics;
use super::scenes::Protocol;
use crate::TrainError;
use crate::event::{Evaluator, Progress};
use crate::module::HasBackbone;
use scenesplat_datasets::{Dataset, FullScene, InputFeatures, LeftOut};
use scenesplat_metrics::{Measurement, Metric, Scores, VoteRule};
use scenesplat_models::Backbone;
use std::sync::Arc;

/// How the rows of a network become classes.
pub trait Labelling: Send {
    /// The class of each row; -1 for rows of no class. `rows`: `[N, width]`
    ///
    /// # Errors
    /// If the width does not fit, or a value is not finite.
    fn classify(&self, rows: &[f32], width: usize) -> Result<Vec<i32>, TrainError>;

    /// What a row of each class comes out as without an error: itself, except for classes that cannot be
    /// told apart. `[C]`
    ///
    /// # Errors
    /// As [`classify`](Self::classify).
    fn answers(&self, width: usize) -> Result<Vec<i32>, TrainError>;
}

/// Labels every Gaussian of its scenes by the row of its voxel and measures the numbers of [`Scores`]; see
/// [`SegmentationEvaluator`](super::SegmentationEvaluator) and [`ZeroShotEvaluator`](super::ZeroShotEvaluator).
///
/// Where a scene has labeled points with classes, they are scored, else every labeled Gaussian.
pub struct SceneEvaluator<L> {
    pub(super) name: String,
    pub(super) data: Arc<dyn Dataset>,
    pub(super) features: InputFeatures,
    pub(super) labelling: L,
    pub(super) excluded: Vec<usize>,
    pub(super) vote: VoteRule,
    pub(super) own: OwnMetrics,
}

impl<L> SceneEvaluator<L> {
    /// Each scored point or Gaussian takes the majority of the `k` Gaussians nearest to it; for
    /// Gaussians, 1 is no vote.
    #[must_use]
    pub fn with_vote(mut self, k: usize) -> Self {
        self.vote = VoteRule::of(k);
        self
    }

    /// Feeds a further metric, with the predicted and the true class of what is scored (-1 for none),
    /// scene by scene; each evaluation begins with the metric as it is given here.
    #[must_use]
    pub fn with_metric<M>(mut self, metric: M) -> Self
    where
        M: for<'a> Metric<Update<'a> = (&'a [i32], &'a [i32])> + Clone + 'static,
    {
        self.own.add(metric);
        self
    }
}

impl<L: Labelling> SceneEvaluator<L> {
    /// The counts over all scenes.
    ///
    /// # Errors
    /// If data cannot be read, none is labeled, or the network fails.
    pub fn scores(&self, model: &dyn Backbone) -> Result<Scores, TrainError> {
        self.run_with(model, &mut self.own.fresh(), |_, _, _| Ok(()))
    }

    /// As [`scores`](Self::scores); `observe` gets the name of every scene, what is scored of it, and rows
    /// and classes of its sample.
    pub(super) fn run_with(
        &self,
        model: &dyn Backbone,
        own: &mut OwnMetrics,
        mut observe: impl FnMut(&str, &FullScene, (&[f32], &[i32])) -> Result<(), TrainError>,
    ) -> Result<Scores, TrainError> {
        let width = model.out_channels();
        let label = |id: &str, full: &FullScene, rows: &[f32]| {
            let classes = self.labelling.classify(rows, width)?;
            observe(id, full, (rows, &classes))?;
            Ok(classes)
        };
        let protocol = self.protocol(width)?;
        protocol.run(&self.name, self.data.as_ref(), &self.features, model, own, label)
    }

    /// `width`: that of the network's rows.
    pub(super) fn protocol(&self, width: usize) -> Result<Protocol<'_>, TrainError> {
        let (excluded, vote) = (self.excluded.as_slice(), self.vote);
        Ok(Protocol { excluded, answers: self.labelling.answers(width)?, vote })
    }
}

impl<M: HasBackbone, L: Labelling> Evaluator<M> for SceneEvaluator<L> {
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
        let scores = self.run_with(module.backbone(), &mut own, |_, _, _| Ok(()))?;
        Ok([scores.measurements(), own.measure()].concat())
    }
}

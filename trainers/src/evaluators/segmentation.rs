//! Supervised segmentation: the class with the largest logit, compared with the truth.

use super::own_metric::OwnMetrics;
use super::scenes::{Protocol, VOTE_K};
use crate::TrainError;
use crate::event::{Evaluator, Progress};
use crate::module::HasBackbone;
use scenesplat_datasets::{Dataset, FullScene, InputFeatures, LeftOut};
use scenesplat_metrics::{Measurement, Metric, Scores, VoteRule};
use std::sync::Arc;

/// Labels every Gaussian with the largest logit of its voxel and measures the numbers of [`Scores`].
///
/// Where a scene has labelled points with classes, they are scored: each takes the majority of the
/// [`VOTE_K`] Gaussians nearest to it. Else every labelled Gaussian is, without a vote.
///
/// # Source
/// `SemSegEvaluator`, SceneSplat be9d5e1. Differs: averages are over the classes that occur, not
/// over all.
pub struct SegmentationEvaluator {
    name: String,
    data: Arc<dyn Dataset>,
    features: InputFeatures,
    excluded: Vec<usize>,
    vote_k: Option<usize>,
    own: OwnMetrics,
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
        Self {
            name: name.into(),
            data,
            features,
            excluded,
            vote_k: None,
            own: OwnMetrics::default(),
        }
    }

    /// Each scored point or Gaussian takes the majority of the `k` Gaussians nearest to it; for
    /// Gaussians, 1 is no vote.
    #[must_use]
    pub fn with_vote(mut self, k: usize) -> Self {
        self.vote_k = Some(k);
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
}

impl<M: HasBackbone> Evaluator<M> for SegmentationEvaluator {
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
        let classes = module.backbone().out_channels();
        let protocol = Protocol {
            excluded: &self.excluded,
            answers: (0..classes as i32).collect(),
            vote: VoteRule {
                points_k: self.vote_k.unwrap_or(VOTE_K),
                gaussians_k: self.vote_k.unwrap_or(1),
                keep_withheld: false,
            },
        };
        let data = self.data.as_ref();
        let label = |_: &str, _: &FullScene, logits: &[f32]| {
            Ok(logits.chunks_exact(classes).map(largest).collect())
        };
        let (network, mut own) = (module.backbone(), self.own.fresh());
        let scores = protocol.run(&self.name, data, &self.features, network, &mut own, label)?;
        Ok([scores.measurements(), own.measure()].concat())
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

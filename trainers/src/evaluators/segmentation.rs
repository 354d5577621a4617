//! Supervised segmentation: the class with the largest logit, compared with the truth.

use super::own_metric::OwnMetrics;
use super::scene_evaluator::{Labelling, SceneEvaluator};
use super::scenes::VOTE_K;
use crate::TrainError;
use scenesplat_datasets::{Dataset, InputFeatures};
use scenesplat_metrics::VoteRule;
use std::sync::Arc;

/// Labels every Gaussian with the largest logit of its voxel and measures the numbers of
/// [`Scores`](super::Scores).
///
/// Where a scene has labeled points with classes, they are scored: each takes the majority of the
/// [`VOTE_K`] Gaussians nearest to it. Else every labeled Gaussian is, without a vote.
///
/// # Source
/// `SemSegEvaluator`, SceneSplat be9d5e1. Differs: averages are over the classes that occur, not
/// over all.
pub type SegmentationEvaluator = SceneEvaluator<LargestLogit>;

/// The class of the largest logit, the first of equal ones.
#[derive(Debug, Clone, Copy)]
pub struct LargestLogit;

impl SegmentationEvaluator {
    /// `data` ends with a grid sample; `excluded` classes are left out of the averages that begin
    /// with f.
    pub fn new(
        name: impl Into<String>,
        data: Arc<dyn Dataset>,
        features: InputFeatures,
        excluded: Vec<usize>,
    ) -> Self {
        let vote = VoteRule { gaussians_k: 1, ..VoteRule::of(VOTE_K) };
        let (name, labelling, own) = (name.into(), LargestLogit, OwnMetrics::default());
        Self { name, data, features, labelling, excluded, vote, own }
    }
}

impl Labelling for LargestLogit {
    fn classify(&self, rows: &[f32], width: usize) -> Result<Vec<i32>, TrainError> {
        Ok(rows.chunks_exact(width).map(largest).collect())
    }

    fn answers(&self, width: usize) -> Result<Vec<i32>, TrainError> {
        Ok((0..width as i32).collect())
    }
}

fn largest(row: &[f32]) -> i32 {
    let mut best = 0;
    for (i, value) in row.iter().enumerate() {
        if *value > row[best] {
            best = i;
        }
    }
    best as i32
}

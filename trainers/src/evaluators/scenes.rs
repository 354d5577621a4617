//! Scenes one by one through a network, in evaluation mode, and their labels against the truth.

use super::own_metric::OwnMetrics;
use crate::TrainError;
use crate::tasks::point_cloud;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{
    Dataset, FullScene, InputFeatures, Sample, TeacherRows, collate_samples,
};
use scenesplat_metrics::{SceneTruth, Scores, VoteRule};
use scenesplat_models::{Backbone, Forward};

/// Neighbors that vote, as the paper evaluates.
pub const VOTE_K: usize = 25;

/// How labels of voxels are brought to where the truth is known.
pub(super) struct Protocol<'a> {
    /// Classes left out of the averages that begin with f.
    pub excluded: &'a [usize],
    /// What a row of each class comes out as without an error: itself, but for classes whose texts
    /// are equal. `[C]`
    pub answers: Vec<i32>,
    /// Who votes on what is scored.
    pub vote: VoteRule,
}

impl Protocol<'_> {
    /// Scores every scene, in `own` metrics too: `label` turns the network's rows into classes; it also gets
    /// the name of the scene and what is scored there. A scene without rows is skipped.
    ///
    /// # Errors
    /// If a scene cannot be read or has no labels, no row of all is labeled, or the network fails.
    pub(super) fn run(
        &self,
        name: &str,
        data: &dyn Dataset,
        features: &InputFeatures,
        model: &dyn Backbone,
        own: &mut OwnMetrics,
        mut label: impl FnMut(&str, &FullScene, &[f32]) -> Result<Vec<i32>, TrainError>,
    ) -> Result<Scores, TrainError> {
        let mut scores = Scores::new(self.answers.len(), self.excluded)?;
        for index in 0..data.len() {
            // Always epoch 0: an evaluation sees the same rows each time.
            let mut sample = data.get(0, index)?;
            if sample.is_empty() {
                continue;
            }
            let full = sample.full.take().unwrap_or_else(|| as_sampled(&sample));
            let scene = sample.id.clone();
            let out = forward(sample, features, model)?;
            let classes = label(&scene, &full, &out)?;
            self.score(&full, &classes, &mut scores, own)?.ok_or(TrainError::NoLabels { scene })?;
        }
        if scores.model.num_labelled() > 0 {
            return Ok(scores);
        }
        Err(TrainError::NothingMeasured { name: name.to_owned(), scenes: data.len() })
    }

    /// Adds a scene to the counts; `None` if nothing of it has labels.
    fn score(
        &self,
        full: &FullScene,
        of_voxels: &[i32],
        scores: &mut Scores,
        own: &mut OwnMetrics,
    ) -> Result<Option<()>, TrainError> {
        let Some(truth) = self.truth(full)? else { return Ok(None) };
        let predicted = scores.add_labels(&truth, full.spread(of_voxels), &self.vote)?;
        own.update(&predicted, truth.scored())?;
        scores.add_oracle(&truth, &self.answers, &self.vote)?;
        Ok(Some(()))
    }

    /// Adds given classes of the Gaussians of a scene, `[N]`.
    pub(super) fn score_labels(
        &self,
        full: &FullScene,
        labels: Vec<i32>,
        scores: &mut Scores,
    ) -> Result<(), TrainError> {
        if let Some(truth) = self.truth(full)? {
            scores.add_labels(&truth, labels, &self.vote)?;
        }
        Ok(())
    }

    /// What a scene is scored on, and who votes there; `None` if nothing of it has labels.
    fn truth<'a>(&self, full: &'a FullScene) -> Result<Option<SceneTruth<'a>>, TrainError> {
        let (own_labels, points) = (full.segment.as_deref(), full.scored_points());
        let truth = SceneTruth::new(&full.coord, own_labels, points, self.answers.len())?;
        // Gaussians without a collected feature do not vote, as in the original; if there is not one,
        // the mask says nothing.
        let voters = full.valid_feat.as_deref().filter(|valid| valid.contains(&true));
        Ok(truth.map(|truth| truth.with_voters(voters)))
    }
}

/// The network's rows of a scene, row-major.
fn forward(
    sample: Sample,
    features: &InputFeatures,
    model: &dyn Backbone,
) -> Result<Vec<f32>, TrainError> {
    let batch = collate_samples(vec![sample], features)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut forward = || {
        let out = model.forward(&point_cloud(&batch)?, &mut Forward::eval(&mut rng))?;
        out.flatten_all()?.to_vec1()
    };
    forward().map_err(|source| TrainError::Forward { source })
}

/// The rows of a sample as the scene they are, for transforms that keep no other.
fn as_sampled(sample: &Sample) -> FullScene {
    FullScene {
        coord: sample.coord.clone(),
        voxel: (0..sample.len() as u32).collect(),
        segment: sample.segment.clone(),
        valid_feat: sample.valid_feat.clone(),
        points: sample.labelled_points.clone(),
        teacher: as_taught(sample),
        origin_row: None,
    }
}

/// The language features of a sample as those of a teacher.
fn as_taught(sample: &Sample) -> Option<TeacherRows> {
    let rows = sample.lang_feat.clone()?;
    let valid = |i: usize| sample.valid_feat.as_ref().is_none_or(|valid| valid[i]);
    let row_of = (0..sample.len()).map(|i| if valid(i) { i as u32 } else { TeacherRows::NONE });
    Some(TeacherRows { rows, row_of: row_of.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::LabelledPoints;

    fn protocol(points_k: usize, gaussians_k: usize) -> Protocol<'static> {
        let vote = VoteRule { points_k, gaussians_k, keep_withheld: false };
        Protocol { excluded: &[], answers: vec![0, 1, 2], vote }
    }

    fn on_a_line(x: &[f32]) -> Vec<[f32; 3]> {
        x.iter().map(|&x| [x, 0.0, 0.0]).collect()
    }

    fn scored(protocol: &Protocol<'_>, full: &FullScene, of_voxels: &[i32]) -> Scores {
        let mut scores = Scores::new(3, &[]).unwrap();
        protocol.score(full, of_voxels, &mut scores, &mut OwnMetrics::default()).unwrap().unwrap();
        scores
    }

    /// Seven Gaussians in three voxels, and three points between them.
    fn scene() -> FullScene {
        FullScene {
            coord: on_a_line(&[0.0, 0.1, 0.2, 1.0, 1.1, 2.0, 2.1]),
            voxel: vec![0, 0, 0, 1, 1, 2, 2],
            segment: Some(vec![0, 0, 1, 1, 1, 2, 2]),
            valid_feat: None,
            points: Some(LabelledPoints {
                coord: on_a_line(&[0.05, 0.15, 2.05]),
                segment: Some(vec![0, 1, 2]),
                instance: None,
            }),
            ..FullScene::default()
        }
    }

    #[test]
    fn points_take_the_majority_of_all_gaussians_around_them() {
        // Voxels say 0, 1, 1. Of the three nearest to each point: 0 0 0 → 0; 0 0 0 → 0, wrong;
        // 2.0, 2.1, 1.1 → 1, wrong.
        let scores = scored(&protocol(3, 1), &scene(), &[0, 1, 1]);
        let report = scores.model.tester_report();
        assert_eq!(scores.model.num_labelled(), 3, "three points, not seven Gaussians");
        assert!((report.all_accuracy.unwrap() - 1.0 / 3.0).abs() < 1e-9);
        // IoU of class 0: 1 hit of 2; 1 and 2: none. 1 is predicted for 2 and missed once.
        assert!((report.mean_iou.unwrap() - 0.5 / 3.0).abs() < 1e-9);
        // The truth of the Gaussians through the same vote: 0 0 1 → 0; 0 0 1 → 0, wrong; 2 2 1 → 2.
        let oracle = scores.oracle.tester_report();
        assert!((oracle.all_accuracy.unwrap() - 2.0 / 3.0).abs() < 1e-9);
        // Voters beyond the scene are not asked for.
        let all = scored(&protocol(25, 1), &scene(), &[0, 1, 1]);
        assert!((all.model.tester_report().all_accuracy.unwrap() - 1.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn gaussians_without_a_feature_do_not_vote() {
        let mut full = scene();
        full.valid_feat = Some(vec![false, false, true, true, true, true, true]);
        // Nearest three of those with a feature: 0.2, 1.0, 1.1 → 1, for the first two points.
        let scores = scored(&protocol(3, 1), &full, &[0, 1, 2]);
        let hits = scores.model.tester_report().all_accuracy.unwrap();
        assert!((hits - 2.0 / 3.0).abs() < 1e-9, "{hits}");
        full.valid_feat = Some(vec![false; 7]);
        let scores = scored(&protocol(3, 1), &full, &[0, 1, 2]);
        assert!((scores.model.tester_report().all_accuracy.unwrap() - 2.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn scenes_with_labelled_points_only_are_scored() {
        let full = FullScene { segment: None, ..scene() };
        let scores = scored(&protocol(1, 1), &full, &[0, 1, 2]);
        assert_eq!(scores.model.num_labelled(), 3);
        // Nearest points of the Gaussians: 0, 0|1, 1, 1, … so the oracle misses nothing at k = 1 but
        // what ties take: 0.05 ← 0.0 (equally near 0.1; the first row), 0.15 ← 0.1, 2.05 ← 2.0.
        assert!(scores.oracle.tester_report().all_accuracy.unwrap() > 0.6);
    }

    #[test]
    fn without_points_every_gaussian_is_scored() {
        let full = FullScene { points: None, ..scene() };
        let plain = scored(&protocol(25, 1), &full, &[0, 1, 2]);
        assert_eq!(plain.model.num_labelled(), 7);
        assert!((plain.model.tester_report().all_accuracy.unwrap() - 6.0 / 7.0).abs() < 1e-9);
        assert!((plain.oracle.tester_report().all_accuracy.unwrap() - 1.0).abs() < 1e-9);
        let voted = scored(&protocol(25, 3), &full, &[0, 1, 2]);
        // 1.0: of 1.0, 1.1 and 0.2 two say 1. 2.0 and 2.1: with 1.1, two say 2.
        assert!((voted.model.tester_report().all_accuracy.unwrap() - 6.0 / 7.0).abs() < 1e-9);
        let none = FullScene { points: None, segment: None, ..scene() };
        let mut scores = Scores::new(3, &[]).unwrap();
        assert!(
            protocol(1, 1)
                .score(&none, &[0, 1, 2], &mut scores, &mut OwnMetrics::default())
                .unwrap()
                .is_none()
        );
    }

    #[test]
    fn labels_of_no_class_are_an_error() {
        let full = FullScene { points: None, segment: Some(vec![7; 7]), ..scene() };
        let mut scores = Scores::new(3, &[]).unwrap();
        assert!(
            protocol(1, 1)
                .score(&full, &[0, 1, 2], &mut scores, &mut OwnMetrics::default())
                .is_err()
        );
    }

    #[test]
    fn a_sample_without_its_scene_is_the_scene() {
        use half::f16;
        use scenesplat_scene::LanguageFeatures;
        let rows = LanguageFeatures { values: vec![f16::ONE; 6], dim: 2 };
        let points =
            LabelledPoints { coord: on_a_line(&[7.0]), segment: Some(vec![1]), instance: None };
        let sample = Sample {
            coord: on_a_line(&[0.0, 1.0, 2.0]),
            segment: Some(vec![2, -1, 0]),
            valid_feat: Some(vec![true, false, true]),
            lang_feat: Some(rows.clone()),
            labelled_points: Some(points.clone()),
            ..Sample::default()
        };
        let full = as_sampled(&sample);
        assert_eq!((full.coord, full.voxel), (sample.coord.clone(), vec![0, 1, 2]));
        assert_eq!((full.segment, full.points), (Some(vec![2, -1, 0]), Some(points)));
        assert_eq!((full.valid_feat, full.origin_row), (sample.valid_feat.clone(), None));
        // A row that is marked as none is none of the teacher's.
        let teacher = full.teacher.unwrap();
        assert_eq!((teacher.rows, teacher.row_of), (rows, vec![0, TeacherRows::NONE, 2]));
        let all = as_sampled(&Sample { valid_feat: None, ..sample.clone() });
        assert_eq!(all.teacher.unwrap().row_of, [0, 1, 2]);
        assert!(as_sampled(&Sample { lang_feat: None, ..sample }).teacher.is_none());
    }

    #[test]
    fn given_labels_are_scored_by_the_same_vote() {
        let (protocol, full) = (protocol(3, 1), scene());
        let mut scores = Scores::new(3, &[]).unwrap();
        // Points 0, 1, 2 get the majority of their three nearest Gaussians: 0 1 1, 0 1 1, and of 2.0, 2.1, 1.1: 2 2 0.
        protocol.score_labels(&full, vec![0, 1, 1, 0, 0, 2, 2], &mut scores).unwrap();
        assert_eq!(scores.model.counts(), [0, 1, 0, 0, 1, 0, 0, 0, 1]);
        assert_eq!(scores.oracle.num_labelled(), 0);
        let none = FullScene { points: None, segment: None, ..scene() };
        protocol.score_labels(&none, vec![0; 7], &mut scores).unwrap();
        assert_eq!(scores.model.num_labelled(), 3);
    }
}

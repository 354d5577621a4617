//! A student and its teacher: zero-shot segmentation of both, and how far they agree.

use super::own_metric::OwnMetrics;
use super::scene_evaluator::Labelling;
use super::zero_shot::ZeroShotEvaluator;
use crate::TrainError;
use crate::event::{Evaluator, Progress};
use crate::module::HasBackbone;
use rayon::prelude::*;
use scenesplat_datasets::{FullScene, LeftOut};
use scenesplat_metrics::{ConfusionMatrix, Measurement, Metric, Scores, TesterReport};
use scenesplat_models::Backbone;

/// How far the rows of two networks agree, over the Gaussians that both have a row for.
///
/// | measurement | |
/// |---|---|
/// | `agreement/cosine` | mean cosine of the two rows of a Gaussian |
/// | `agreement/top1` | share of the Gaussians to which both give the same class |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Agreement {
    cosines: f64,
    same: u64,
    rows: u64,
}

impl Agreement {
    const NAMES: [&'static str; 2] = ["agreement/cosine", "agreement/top1"];

    /// Gaussians compared so far.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Adds a scene: rows and classes of the voxels of the student, `[M, D]` and `[M]`, and of the
    /// teacher, `[T, D]` and `[T]`. Rows of no direction are left out.
    pub(super) fn add(
        &mut self,
        full: &FullScene,
        row_of: &[u32],
        student: (&[f32], &[i32]),
        teacher: (&[f32], &[i32]),
        dim: usize,
    ) {
        let compare = |(&voxel, &row): (&u32, &u32)| {
            let (voxel, row) = (voxel as usize, row as usize);
            let class = *teacher.1.get(row)?;
            let cosine = cosine(&student.0[voxel * dim..][..dim], &teacher.0[row * dim..][..dim])?;
            Some((cosine, class >= 0 && student.1[voxel] == class))
        };
        let pairs = full.voxel.par_iter().zip(row_of).with_min_len(1024);
        let compared: Vec<Option<(f64, bool)>> = pairs.map(compare).collect();
        // In the order of the Gaussians, whatever the number of threads.
        for (cosine, same) in compared.into_iter().flatten() {
            self.cosines += cosine;
            self.same += u64::from(same);
            self.rows += 1;
        }
    }

    fn measurements(&self) -> Vec<Measurement> {
        if self.rows == 0 {
            return Vec::new();
        }
        let rows = self.rows as f64;
        let values = [self.cosines / rows, self.same as f64 / rows];
        Self::NAMES.iter().zip(values).map(|(name, v)| Measurement::new(*name, v)).collect()
    }
}

/// The cosine of two rows; `None` if one has no direction.
fn cosine(a: &[f32], b: &[f32]) -> Option<f64> {
    let [mut aa, mut bb, mut ab] = [0f64; 3];
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (f64::from(*a), f64::from(*b));
        aa += a * a;
        bb += b * b;
        ab += a * b;
    }
    let cosine = ab / (aa.sqrt() * bb.sqrt());
    cosine.is_finite().then_some(cosine)
}

/// Result of an evaluation of a student.
#[derive(Debug, Clone)]
pub struct DistillationScores {
    /// The student, and the truth itself.
    pub student: Scores,
    /// The teacher, each Gaussian with the class of its own row, through the same vote.
    pub teacher: ConfusionMatrix,
    /// The two compared.
    pub agreement: Agreement,
}

impl DistillationScores {
    /// Names of the [`measurements`](Self::measurements): those of [`Scores`], those of the teacher after
    /// `teacher/`, and those of [`Agreement`].
    pub fn names() -> Vec<String> {
        let teacher = TesterReport::NAMES.iter().map(|name| format!("teacher/{name}"));
        let agreement = Agreement::NAMES.iter().map(|&name| name.to_owned());
        Scores::names().into_iter().chain(teacher).chain(agreement).collect()
    }

    /// All numbers, undefined ones left out.
    pub fn measurements(&self) -> Vec<Measurement> {
        let teacher = self.teacher.measure().into_iter();
        let teacher = teacher.map(|m| Measurement::new(format!("teacher/{}", m.name), m.value));
        let own = self.student.measurements().into_iter();
        own.chain(teacher).chain(self.agreement.measurements()).collect()
    }
}

/// Scores a student as a [`ZeroShotEvaluator`] does, its teacher by the same protocol, and how far
/// they agree.
///
/// The teacher's rows come with the data: from a [teacher](scenesplat_datasets::SceneTeacher) of the scenes,
/// each Gaussian with the row of its own voxel there. So these are the teacher's own numbers, not those of its
/// rows on the student's voxels. The data decide who votes, whether the teacher has a row for it or not.
pub struct DistillationEvaluator {
    own: ZeroShotEvaluator,
}

impl DistillationEvaluator {
    /// `own`: how the student is scored; its data come with rows of a teacher.
    pub fn new(own: ZeroShotEvaluator) -> Self {
        Self { own }
    }

    /// The counts over all scenes.
    ///
    /// # Errors
    /// As [`ZeroShotEvaluator::scores`], and if a scene has no rows of a teacher, or rows of another
    /// width.
    pub fn scores(&self, model: &dyn Backbone) -> Result<DistillationScores, TrainError> {
        self.scores_and_own(model, &mut self.own.own.fresh())
    }

    fn scores_and_own(
        &self,
        model: &dyn Backbone,
        own: &mut OwnMetrics,
    ) -> Result<DistillationScores, TrainError> {
        let mut agreement = Agreement::default();
        let width = model.out_channels();
        let protocol = self.own.protocol(width)?;
        let mut teacher = Scores::new(protocol.answers.len(), protocol.excluded)?;
        let student = self.own.run_with(model, own, |id, full, student| {
            let Some(taught) = &full.teacher else {
                return Err(TrainError::NoTeacher { scene: id.to_owned() });
            };
            if taught.rows.dim != width {
                return Err(TrainError::Mismatch {
                    what: "width of the teacher's rows",
                    name: id.to_owned(),
                    expected: width.to_string(),
                    got: taught.rows.dim.to_string(),
                });
            }
            let values: Vec<f32> = taught.rows.values.iter().map(|v| v.to_f32()).collect();
            let of_rows = self.own.labelling.classify(&values, width)?;
            agreement.add(full, &taught.row_of, student, (&values, &of_rows), width);
            let of = |row: &u32| of_rows.get(*row as usize).copied().unwrap_or(-1);
            let labels = taught.row_of.iter().map(of).collect();
            protocol.score_labels(full, labels, &mut teacher)
        })?;
        Ok(DistillationScores { student, teacher: teacher.model, agreement })
    }
}

impl<M: HasBackbone> Evaluator<M> for DistillationEvaluator {
    fn name(&self) -> &str {
        &self.own.name
    }

    fn left_out(&self) -> LeftOut {
        self.own.data.left_out()
    }

    fn measurements(&self) -> Vec<String> {
        [DistillationScores::names(), self.own.own.names()].concat()
    }

    fn run(&mut self, module: &M, _: Progress) -> Result<Vec<Measurement>, TrainError> {
        let mut own = self.own.own.fresh();
        let scores = self.scores_and_own(module.backbone(), &mut own)?;
        Ok([scores.measurements(), own.measure()].concat())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_agree_by_direction_and_by_a_class_that_both_have() {
        let full = FullScene { voxel: vec![1, 0, 0, 1, 1], ..FullScene::default() };
        // Voxels of the student point along (3, 4) and (0, 1); classes none and 2.
        let student = (&[3.0f32, 4.0, 0.0, 1.0][..], &[-1, 2][..]);
        // Rows of the teacher: (0, 2), (1, 0), none at all; classes 2, none, 2.
        let teacher = (&[0.0f32, 2.0, 1.0, 0.0, 0.0, 0.0][..], &[2, -1, 2][..]);
        let mut agreement = Agreement::default();
        assert!(agreement.measurements().is_empty());
        // Cosines 1, 0.6, 0.8, a row of no direction, and a Gaussian without a row.
        agreement.add(&full, &[0, 1, 0, 2, 9], student, teacher, 2);
        assert_eq!(agreement.rows(), 3);
        let found = agreement.measurements();
        assert!((found[0].value - 2.4 / 3.0).abs() < 1e-9, "{found:?}");
        // The first alone: two Gaussians without a class do not agree.
        assert!((found[1].value - 1.0 / 3.0).abs() < 1e-9, "{found:?}");
        agreement.add(&full, &[0, 9, 9, 9, 9], student, teacher, 2);
        assert_eq!((agreement.rows(), agreement.measurements()[1].value), (4, 0.5));
        let names: Vec<String> = found.into_iter().map(|m| m.name).collect();
        assert_eq!(names, ["agreement/cosine", "agreement/top1"]);
        let all = DistillationScores::names();
        assert!(all.contains(&"teacher/mIoU".to_owned()) && all.ends_with(&names));
        assert_eq!(cosine(&[1.0, 0.0], &[-2.0, 0.0]), Some(-1.0));
        assert_eq!(cosine(&[0.0, 0.0], &[1.0, 0.0]), None);
    }
}

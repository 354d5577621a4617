use crate::error::{check_labels, check_rows};
use crate::{
    ConfusionMatrix, IGNORE, Measurement, Metric, MetricError, OracleCheck, OracleVote,
    TesterReport, TextRows, keep_withheld, vote,
};
use std::borrow::Cow;

const LABELS: &str = "labels";
const POINT_LABELS: &str = "labels of points";

/// Positions, meters, with their classes. `[M, 3]` and `[M]`
type LabelledAt<'a> = (&'a [[f32; 3]], Cow<'a, [i32]>);

/// How the labels of Gaussians get to where a scene is scored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoteRule {
    /// Neighbors that vote for a labeled point; at least one does.
    pub points_k: usize,
    /// Neighbors that vote for a Gaussian, where the Gaussians themselves are scored; below 2 none
    /// do.
    pub gaussians_k: usize,
    /// Whether Gaussians whose class was withheld stay without one after a vote among themselves.
    pub keep_withheld: bool,
}

impl VoteRule {
    /// The same number of neighbors for points and Gaussians.
    pub fn of(k: usize) -> Self {
        Self { points_k: k, gaussians_k: k, keep_withheld: false }
    }
}

/// What is known of the classes of one scene, and where: one scene of an evaluation.
///
/// A scene with labeled points of its own is scored there, each point by the vote of the Gaussians
/// around it; any other at its Gaussians. Evaluations of whole scenes and evaluations inside training
/// both score by this, so their numbers are the same.
///
/// ```
/// use scenesplat_metrics::{SceneTruth, Scores, VoteRule};
///
/// let coord = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
/// let points = [[0.1, 0.0, 0.0], [0.9, 0.0, 0.0], [1.1, 0.0, 0.0]];
/// let truth = SceneTruth::new(&coord, None, Some((&points, &[0, 1, 1])), 2)?.expect("has labels");
/// let mut scores = Scores::new(2, &[])?;
/// scores.add_labels(&truth, vec![0, 0], &VoteRule::of(1))?;
/// assert_eq!(scores.model.tester_report().all_accuracy, Some(1.0 / 3.0));
/// # Ok::<(), scenesplat_metrics::MetricError>(())
/// ```
#[derive(Debug, Clone)]
pub struct SceneTruth<'a> {
    coord: &'a [[f32; 3]],
    labels: Cow<'a, [i32]>,
    points: Option<LabelledAt<'a>>,
    voters: Option<&'a [bool]>,
    num_classes: usize,
}

impl<'a> SceneTruth<'a> {
    /// `points` are scored if given, else the Gaussians. Where no Gaussian has a class, each is taken
    /// to have that of the labeled point nearest to it. `None` if there are no labels at all.
    ///
    /// # Shapes
    /// - `coord`: `[N, 3]` meters · `labels`: `[N]` · `points`: `[M, 3]` meters and `[M]`
    /// - labels are below `num_classes`, or -1
    ///
    /// # Errors
    /// If lengths differ, a label is no class, or a position is not finite.
    pub fn new(
        coord: &'a [[f32; 3]],
        labels: Option<&'a [i32]>,
        points: Option<(&'a [[f32; 3]], &'a [i32])>,
        num_classes: usize,
    ) -> Result<Option<Self>, MetricError> {
        let points = points.map(|(at, labels)| (at, Cow::Borrowed(labels)));
        Self::checked(coord, labels.map(Cow::Borrowed), points, num_classes)
    }

    /// As [`new`](Self::new), for labels of other names: `class_of` is the class that each label
    /// means, -1 for none. Any label below 0 is none.
    ///
    /// # Errors
    /// As [`new`](Self::new); [`MetricError::LabelRange`] also for a label that `class_of` does not
    /// know.
    pub fn mapped(
        coord: &'a [[f32; 3]],
        labels: Option<&[i32]>,
        points: Option<(&'a [[f32; 3]], &[i32])>,
        class_of: &[i32],
        num_classes: usize,
    ) -> Result<Option<Self>, MetricError> {
        let map = |what, labels: &[i32]| -> Result<Cow<'a, [i32]>, MetricError> {
            let class = |(row, &value): (usize, &i32)| match usize::try_from(value) {
                Err(_) => Ok(IGNORE),
                Ok(label) => class_of.get(label).copied().ok_or(MetricError::LabelRange {
                    what,
                    row,
                    value,
                    num_classes: class_of.len(),
                }),
            };
            labels.iter().enumerate().map(class).collect::<Result<Vec<i32>, _>>().map(Cow::Owned)
        };
        let labels = labels.map(|labels| map(LABELS, labels)).transpose()?;
        let points = points
            .map(|(at, labels)| Ok::<_, MetricError>((at, map(POINT_LABELS, labels)?)))
            .transpose()?;
        Self::checked(coord, labels, points, num_classes)
    }

    fn checked(
        coord: &'a [[f32; 3]],
        labels: Option<Cow<'a, [i32]>>,
        points: Option<LabelledAt<'a>>,
        num_classes: usize,
    ) -> Result<Option<Self>, MetricError> {
        if let Some(labels) = &labels {
            check_rows(LABELS, labels.len(), coord.len())?;
            check_labels(LABELS, labels, num_classes)?;
        }
        if let Some((at, labels)) = &points {
            check_rows(POINT_LABELS, labels.len(), at.len())?;
            check_labels(POINT_LABELS, labels, num_classes)?;
        }
        let known = |labels: &[i32]| labels.iter().any(|&label| label != IGNORE);
        let labels = match (labels, &points) {
            (Some(own), _) if known(&own) => own,
            (_, Some((at, of))) => Cow::Owned(vote(at, of, None, coord, 1, num_classes)?),
            (Some(none), None) => none,
            (None, None) => return Ok(None),
        };
        Ok(Some(Self { coord, labels, points, voters: None, num_classes }))
    }

    /// Only these Gaussians vote, `[N]`; all do if `None`.
    #[must_use]
    pub fn with_voters(self, voters: Option<&'a [bool]>) -> Self {
        Self { voters, ..self }
    }

    /// The class of each Gaussian, -1 for none. `[N]`
    pub fn labels(&self) -> &[i32] {
        &self.labels
    }

    /// The true classes of what is scored: of the points, or of the Gaussians.
    pub fn scored(&self) -> &[i32] {
        self.points.as_ref().map_or(&self.labels, |(_, labels)| labels)
    }

    /// Where it is scored: the places of the points, or of the Gaussians, meters.
    pub fn places(&self) -> &[[f32; 3]] {
        self.points.as_ref().map_or(self.coord, |(at, _)| at)
    }

    /// Who votes, if not all do. `[N]`
    pub fn voters(&self) -> Option<&[bool]> {
        self.voters
    }

    /// Whether anything that is scored has a class.
    pub fn is_labelled(&self) -> bool {
        self.scored().iter().any(|&label| label != IGNORE)
    }

    /// Whether labeled points are scored rather than Gaussians.
    pub fn scores_points(&self) -> bool {
        self.points.is_some()
    }

    /// Number of classes that the labels index.
    pub fn num_classes(&self) -> usize {
        self.num_classes
    }

    /// Neighbors that vote on what is scored; `None` for no vote.
    fn k(&self, rule: &VoteRule) -> Option<usize> {
        match self.points {
            Some(_) => Some(rule.points_k.max(1)),
            None => Some(rule.gaussians_k).filter(|&k| k > 1),
        }
    }

    /// Brings classes of the Gaussians, `[N]`, to what is scored.
    ///
    /// # Errors
    /// As [`vote`].
    pub fn carry(&self, labels: Vec<i32>, rule: &VoteRule) -> Result<Vec<i32>, MetricError> {
        let Some(k) = self.k(rule) else { return Ok(labels) };
        let mut after = vote(self.coord, &labels, self.voters, self.places(), k, self.num_classes)?;
        if rule.keep_withheld && self.points.is_none() {
            keep_withheld(&labels, &mut after);
        }
        Ok(after)
    }

    /// A check of the chain on this truth, with this vote.
    pub fn check<'b>(&'b self, text: TextRows<'b>, rule: &VoteRule) -> OracleCheck<'b> {
        let check = OracleCheck::new(&self.labels, text);
        let Some(k) = self.k(rule) else { return check };
        check.with_vote(OracleVote {
            coord: self.coord,
            valid: self.voters,
            query: self.points.as_ref().map(|(at, labels)| (*at, labels.as_ref())),
            k,
            keep_unknown: rule.keep_withheld,
        })
    }
}

/// Counts of an evaluation over scenes.
#[derive(Debug, Clone)]
pub struct Scores {
    /// What the network said, against the truth.
    pub model: ConfusionMatrix,
    /// The truth of the Gaussians through the same vote, against the truth: what a network without
    /// an error would score.
    pub oracle: ConfusionMatrix,
}

impl Scores {
    /// No scene yet; `excluded` classes are left out of the averages that begin with f.
    ///
    /// # Errors
    /// If there is no class, there are more than 4096, or an excluded one does not exist.
    pub fn new(num_classes: usize, excluded: &[usize]) -> Result<Self, MetricError> {
        let matrix = ConfusionMatrix::new(num_classes)?.with_excluded(excluded)?;
        Ok(Self { model: matrix.clone(), oracle: matrix })
    }

    /// Scores the classes that a network gave the Gaussians of a scene, `[N]`. Gives what became of
    /// them where the scene is scored.
    ///
    /// # Errors
    /// If they are not as many as Gaussians, or one is no class.
    pub fn add_labels(
        &mut self,
        truth: &SceneTruth<'_>,
        labels: Vec<i32>,
        rule: &VoteRule,
    ) -> Result<Vec<i32>, MetricError> {
        let predicted = truth.carry(labels, rule)?;
        self.model.update((&predicted, truth.scored()))?;
        Ok(predicted)
    }

    /// Scores the truth itself. `answers`: what a row of each class comes out as without an error,
    /// itself but for classes of equal texts. `[C]`
    ///
    /// # Errors
    /// If there are other answers than classes, or one is no class.
    pub fn add_oracle(
        &mut self,
        truth: &SceneTruth<'_>,
        answers: &[i32],
        rule: &VoteRule,
    ) -> Result<(), MetricError> {
        let (expected, got) = (truth.num_classes(), answers.len());
        if expected != got {
            return Err(MetricError::ClassCount { what: "answers", expected, got });
        }
        let answer = |&label: &i32| usize::try_from(label).map_or(IGNORE, |class| answers[class]);
        let ideal = truth.carry(truth.labels().iter().map(answer).collect(), rule)?;
        self.oracle.update((&ideal, truth.scored()))
    }

    /// Names of the [`measurements`](Self::measurements): those of a [`TesterReport`], and the same
    /// after `oracle/`.
    pub fn names() -> Vec<String> {
        let own = TesterReport::NAMES.iter().map(|&name| name.to_owned());
        own.chain(TesterReport::NAMES.iter().map(|name| format!("oracle/{name}"))).collect()
    }

    /// The numbers of both, undefined ones left out.
    pub fn measurements(&self) -> Vec<Measurement> {
        let mut all = self.model.measure();
        let oracle = self.oracle.measure().into_iter();
        all.extend(oracle.map(|m| Measurement::new(format!("oracle/{}", m.name), m.value)));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on_a_line(x: &[f32]) -> Vec<[f32; 3]> {
        x.iter().map(|&x| [x, 0.0, 0.0]).collect()
    }

    #[test]
    fn gaussians_without_a_class_take_that_of_the_nearest_point() {
        let coord = on_a_line(&[0.0, 1.0, 2.0]);
        let at = on_a_line(&[0.3, 1.9]);
        for own in [None, Some([IGNORE; 3].as_slice())] {
            let truth = SceneTruth::new(&coord, own, Some((&at, &[1, 0])), 2).unwrap().unwrap();
            assert_eq!(truth.labels(), [1, 1, 0]);
            assert_eq!(truth.scored(), [1, 0]);
        }
        let own: &[i32] = &[IGNORE, 0, IGNORE];
        let truth = SceneTruth::new(&coord, Some(own), Some((&at, &[1, 0])), 2).unwrap().unwrap();
        assert_eq!(truth.labels(), own);
        assert!(SceneTruth::new(&coord, None, None, 2).unwrap().is_none());
    }

    #[test]
    fn the_check_and_the_counts_use_the_same_vote() {
        let coord = on_a_line(&[0.0, 1.0, 2.0, 3.0]);
        let labels: &[i32] = &[0, 1, 1, 1];
        let text = TextRows::new(&[1.0, 0.0, 0.0, 1.0], 2).unwrap();
        let voters = [true, true, false, false];
        for rule in [VoteRule::of(0), VoteRule::of(3)] {
            let truth = SceneTruth::new(&coord, Some(labels), None, 2)
                .unwrap()
                .unwrap()
                .with_voters(Some(&voters));
            let report = truth.check(text, &rule).run().unwrap();
            let mut scores = Scores::new(2, &[]).unwrap();
            scores.add_oracle(&truth, &[0, 1], &rule).unwrap();
            assert_eq!(scores.oracle.tester_report(), report.metrics);
            // The two voters disagree, and the smaller class wins everywhere.
            let accuracy = if rule.gaussians_k > 1 { 0.25 } else { 1.0 };
            assert_eq!(report.metrics.all_accuracy, Some(accuracy));
        }
    }

    #[test]
    fn what_was_withheld_stays_so_among_gaussians_only() {
        let coord = on_a_line(&[0.0, 1.0, 2.0]);
        let rule = VoteRule { keep_withheld: true, ..VoteRule::of(3) };
        let labels: &[i32] = &[1, 1, 1];
        let truth = SceneTruth::new(&coord, Some(labels), None, 2).unwrap().unwrap();
        assert_eq!(truth.carry(vec![1, IGNORE, 1], &rule).unwrap(), [1, IGNORE, 1]);
        assert_eq!(truth.carry(vec![1, IGNORE, 1], &VoteRule::of(3)).unwrap(), [1, 1, 1]);
        let points = Some((coord.as_slice(), labels));
        let truth = SceneTruth::new(&coord, Some(labels), points, 2).unwrap().unwrap();
        assert_eq!(truth.carry(vec![1, IGNORE, 1], &rule).unwrap(), [1, 1, 1]);
    }

    #[test]
    fn labels_of_other_names_are_mapped_before_anything_else() {
        let coord = on_a_line(&[0.0, 1.0, 2.0]);
        let labels: &[i32] = &[0, 2, -100];
        let of = |class_of: &[i32]| {
            SceneTruth::mapped(&coord, Some(labels), Some((&coord, labels)), class_of, 2)
        };
        let truth = of(&[1, 9, 0]);
        assert!(truth.is_ok_and(|t| t.unwrap().labels() == [1, 0, IGNORE]));
        // No class of the Gaussians is left, nor of the points.
        let truth = of(&[IGNORE; 3]).unwrap().unwrap();
        assert_eq!((truth.labels(), truth.is_labelled()), ([IGNORE; 3].as_slice(), false));
        let error = of(&[1, 0]).unwrap_err();
        assert!(
            matches!(error, MetricError::LabelRange { row: 1, value: 2, num_classes: 2, .. }),
            "{error}"
        );
        assert!(of(&[7, 0, 0]).is_err());
    }

    #[test]
    fn what_does_not_belong_together_is_refused() {
        let coord = on_a_line(&[0.0, 1.0]);
        assert!(SceneTruth::new(&coord, Some(&[0]), None, 2).is_err());
        assert!(SceneTruth::new(&coord, Some(&[0, 2]), None, 2).is_err());
        assert!(SceneTruth::new(&coord, None, Some((&coord, &[0])), 2).is_err());
        assert!(SceneTruth::new(&coord, None, Some((&coord, &[0, 9])), 2).is_err());
        let truth = SceneTruth::new(&coord, Some(&[0, 1]), None, 2).unwrap().unwrap();
        let mut scores = Scores::new(2, &[]).unwrap();
        assert!(scores.add_labels(&truth, vec![0], &VoteRule::of(1)).is_err());
        assert!(scores.add_oracle(&truth, &[0], &VoteRule::of(1)).is_err());
    }
}

//! Labels of scenes against the truth that the scenes carry.

#[cfg(test)]
mod by_hand;
mod classes;
mod error;
mod neighboring_ids;

pub use classes::{background, classes_of_labels, classes_of_rooms, own_directions};
pub use error::EvaluationError;
pub use neighboring_ids::{OtherIds, other_ids};

use crate::inference::{EncodeError, EncodeProgress, SceneEncoder, SceneFeatures};
use crate::labels::{Agreement, Classes, agreed_labels};
use crate::network::Network;
use crate::text::text_rows;
use scenesplat_metrics::{
    ConfusionMatrix, Fault, IGNORE, Metric, MetricError, OracleReport, SceneTruth, Scores,
    TesterReport, TextRows, UnknownRule, VoteRule, ZeroShotOptions, random_labels,
};
use scenesplat_scene::{GaussianScene, TextTable};

/// How scenes are scored.
#[derive(Debug, Clone, PartialEq)]
pub struct EvaluationSettings {
    /// Classes left out of the averages that begin with f, such as [`background`].
    pub excluded: Vec<usize>,
    /// Which classes compete, and when none wins.
    pub options: ZeroShotOptions,
    /// Neighbors that vote on each label; below 2 none do, but where labeled points are scored one
    /// does.
    pub vote_k: usize,
    /// Lets only Gaussians vote that have a collected language feature, as the original does.
    pub voters_with_feature: bool,
    /// Whether what comes without a label stays so in the vote, as it does where [`options`](Self::options)
    /// withholds labels.
    pub keeps_unknown: bool,
    /// Seed of the random labels.
    pub seed: u64,
}

impl Default for EvaluationSettings {
    /// The paper's vote; no class is left out.
    fn default() -> Self {
        Self {
            excluded: Vec::new(),
            options: ZeroShotOptions::default(),
            vote_k: 25,
            voters_with_feature: false,
            keeps_unknown: false,
            seed: 0,
        }
    }
}

/// The numbers of an evaluation.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EvaluationReport {
    /// The truth of the Gaussians through the same chain: the ceiling of what any labels can reach.
    pub oracle: TesterReport,
    /// Labels drawn evenly from all classes: what any labels have to beat.
    pub random: TesterReport,
    /// The labels that were scored; `None` if none were. Withheld ones are wrong.
    pub model: Option<TesterReport>,
    /// The same without what was withheld, as if nobody had asked there; `None` if nothing was.
    pub given: Option<TesterReport>,
    /// How many labels of what has a class were withheld.
    pub withheld: u64,
}

impl EvaluationReport {
    /// The evaluation of all scenes that several evaluations are of, each scene in one of them: what one
    /// run over all of them would have said. `None` without one, or if they are of other classes, or only
    /// some of them scored labels.
    pub fn sum<'r>(reports: impl IntoIterator<Item = &'r Self>) -> Option<Self> {
        let reports: Vec<&Self> = reports.into_iter().collect();
        let all = |row: fn(&Self) -> Option<&TesterReport>| {
            let rows: Option<Vec<&TesterReport>> =
                reports.iter().map(|report| row(report)).collect();
            TesterReport::sum(rows?)
        };
        let withheld = reports.iter().try_fold(0_u64, |sum, r| sum.checked_add(r.withheld))?;
        let any_labels = reports.iter().any(|report| report.model.is_some());
        let model = if any_labels { Some(all(|report| report.model.as_ref())?) } else { None };
        // Where nothing was withheld, all that was scored was given.
        let given = all(|report| report.given.as_ref().or(report.model.as_ref()));
        Some(Self {
            oracle: all(|report| Some(&report.oracle))?,
            random: all(|report| Some(&report.random))?,
            model,
            given: given.filter(|_| withheld > 0),
            withheld,
        })
    }
}

/// Whose labels count where something is done about the effects of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Restraint<'a> {
    /// Gaussians that vote; all if `None`. `[N]`
    pub voters: Option<&'a [bool]>,
    /// Whether no label is given at a place that is scored ([`SceneTruth::places`]); empty: one is everywhere. `[M]`
    pub withheld: &'a [bool],
}

/// An evaluation over scenes, one after the other: [`truth`](Self::truth), then
/// [`check`](Self::check), then [`add_truth`](Self::add_truth) and [`add_labels`](Self::add_labels).
/// [`evaluate`] does all of it.
#[derive(Debug)]
pub struct Evaluation<'a> {
    text: &'a TextTable,
    rows: TextRows<'a>,
    settings: EvaluationSettings,
    rule: VoteRule,
    scores: Scores,
    random: ConfusionMatrix,
    has_labels: bool,
    /// Of what was not withheld.
    given: ConfusionMatrix,
    withheld: u64,
}

impl<'a> Evaluation<'a> {
    /// No scene yet. `text`: the classes; for a network with classes of its own,
    /// [`own_directions`].
    ///
    /// # Errors
    /// If a text has no direction, or an excluded class does not exist.
    pub fn new(text: &'a TextTable, settings: EvaluationSettings) -> Result<Self, EvaluationError> {
        let scores = Scores::new(text.len(), &settings.excluded)?;
        // What a threshold withheld stays unknown; rows without a usable feature may be filled.
        let keep_withheld =
            settings.keeps_unknown || settings.options.unknown != UnknownRule::default();
        let rule = VoteRule { keep_withheld, ..VoteRule::of(settings.vote_k) };
        let (rows, random, given) =
            (text_rows(text)?, scores.oracle.clone(), scores.oracle.clone());
        let (has_labels, withheld) = (false, 0);
        Ok(Self { text, rows, settings, rule, scores, random, has_labels, given, withheld })
    }

    /// Names of the classes.
    pub fn names(&self) -> &[String] {
        &self.text.names
    }

    /// What a scene says of its classes. `class_of`: the class that each of its labels means, -1 for
    /// none; without it, labels are rows of the texts.
    ///
    /// # Errors
    /// If nothing is labeled, a label stands for nothing, or the scene does not say who votes.
    pub fn truth<'s>(
        &self,
        scene: &'s GaussianScene,
        class_of: Option<&[i32]>,
    ) -> Result<SceneTruth<'s>, EvaluationError> {
        let classes = self.text.len();
        let same: Vec<i32>;
        let class_of = match class_of {
            Some(map) => map,
            None => {
                same = (0..classes as i32).collect();
                &same
            }
        };
        let points = scene.labelled_points.as_ref();
        let points = points.and_then(|p| Some((p.coord.as_slice(), p.segment.as_deref()?)));
        let segment = scene.segment.as_deref();
        let truth = SceneTruth::mapped(&scene.coord, segment, points, class_of, classes);
        let truth = truth.map_err(|error| match error {
            MetricError::LabelRange { row, value, num_classes, .. } => {
                EvaluationError::UnknownLabel { row, label: value, known: num_classes }
            }
            other => other.into(),
        })?;
        let truth = truth
            .filter(|truth| truth.scores_points() || truth.is_labelled())
            .ok_or(EvaluationError::NoLabels)?;
        if !self.settings.voters_with_feature {
            return Ok(truth);
        }
        let voters = scene.valid_feat_mask.as_deref().ok_or(EvaluationError::NoVoters)?;
        Ok(truth.with_voters(Some(voters)))
    }

    /// Runs the truth through the chain and compares with what must come out. `spoiled`: a row that
    /// gets the text of another class, to see that the check notices.
    ///
    /// # Errors
    /// [`EvaluationError::Oracle`] if anything comes out other than it must.
    pub fn check(
        &self,
        truth: &SceneTruth<'_>,
        spoiled: Option<usize>,
    ) -> Result<OracleReport, EvaluationError> {
        let mut check = truth
            .check(self.rows, &self.rule)
            .with_class_names(&self.text.names)
            .with_excluded(&self.settings.excluded)
            .with_options(self.settings.options.clone());
        if let Some(row) = spoiled {
            check = check.with_fault(fault(truth.labels(), row)?);
        }
        check.run().map_err(EvaluationError::Oracle)
    }

    /// Scores the truth that passed its check, and random labels.
    ///
    /// # Errors
    /// If they cannot be counted.
    pub fn add_truth(
        &mut self,
        truth: &SceneTruth<'_>,
        checked: &OracleReport,
    ) -> Result<(), EvaluationError> {
        self.add_oracle(truth, checked)?;
        self.add_random(truth)
    }

    /// Scores the truth that passed its check.
    ///
    /// # Errors
    /// If it cannot be counted.
    pub fn add_oracle(
        &mut self,
        truth: &SceneTruth<'_>,
        checked: &OracleReport,
    ) -> Result<(), EvaluationError> {
        // What each class comes out as: itself, except for aliases.
        let mut answers: Vec<i32> = (0..self.text.len() as i32).collect();
        for &(class, becomes) in &checked.aliases {
            answers[class] = becomes;
        }
        Ok(self.scores.add_oracle(truth, &answers, &self.rule)?)
    }

    /// Scores random labels.
    ///
    /// # Errors
    /// If they cannot be counted.
    pub fn add_random(&mut self, truth: &SceneTruth<'_>) -> Result<(), EvaluationError> {
        let scored = truth.scored();
        let random = random_labels(scored.len(), self.text.len(), self.settings.seed)?;
        Ok(self.random.update((&random, scored))?)
    }

    /// The class of each Gaussian by its features; `classifier` if they are probabilities of the
    /// classes. `[N]`
    ///
    /// # Errors
    /// If features and texts differ in width, or features cannot be read.
    pub fn label(
        &self,
        features: &SceneFeatures,
        classifier: bool,
    ) -> Result<Vec<i32>, EvaluationError> {
        self.label_agreeing(features, classifier, &Agreement::default())
    }

    /// As [`label`](Self::label), and then labels agree ([`label_agreeing`](crate::labels::label_agreeing)). `[N]`
    ///
    /// # Errors
    /// As [`label`](Self::label) and [`label_agreeing`](crate::labels::label_agreeing).
    pub fn label_agreeing(
        &self,
        features: &SceneFeatures,
        classifier: bool,
        agreement: &Agreement<'_>,
    ) -> Result<Vec<i32>, EvaluationError> {
        let classes = match classifier {
            true => Classes::Probabilities(self.text.len()),
            false => Classes::Texts(self.text),
        };
        Ok(agreed_labels(features, classes, &self.settings.options, agreement)?.labels)
    }

    /// Scores classes of the Gaussians, -1 for none. `[N]` Gives what became of them where the scene is scored. `[M]`
    ///
    /// # Errors
    /// If they are not as many as Gaussians, or one is no class.
    pub fn add_labels(
        &mut self,
        truth: &SceneTruth<'_>,
        labels: Vec<i32>,
    ) -> Result<Vec<i32>, EvaluationError> {
        self.add_some_labels(truth, labels, Restraint::default())
    }

    /// As [`add_labels`](Self::add_labels), where some Gaussians do not vote, or no label is given at some places.
    ///
    /// # Errors
    /// As [`add_labels`](Self::add_labels), and if `about` is of another number of Gaussians or places.
    pub fn add_some_labels(
        &mut self,
        truth: &SceneTruth<'_>,
        labels: Vec<i32>,
        about: Restraint<'_>,
    ) -> Result<Vec<i32>, EvaluationError> {
        let voters: Option<Vec<bool>> = match (truth.voters(), about.voters) {
            (Some(a), Some(b)) => Some(a.iter().zip(b).map(|(a, b)| *a && *b).collect()),
            (a, b) => a.or(b).map(<[bool]>::to_vec),
        };
        let voting = truth.clone().with_voters(voters.as_deref());
        let mut predicted = voting.carry(labels, &self.rule)?;
        let mut answered = truth.scored().to_vec();
        if !about.withheld.is_empty() {
            let (expected, got) = (answered.len(), about.withheld.len());
            if expected != got {
                let what = "places without a label";
                return Err(MetricError::RowCount { what, expected, got }.into());
            }
            for (place, _) in about.withheld.iter().enumerate().filter(|(_, is)| **is) {
                predicted[place] = IGNORE;
                self.withheld += u64::from(answered[place] != IGNORE);
                answered[place] = IGNORE;
            }
        }
        self.scores.model.update((&predicted, truth.scored()))?;
        self.given.update((&predicted, &answered))?;
        self.has_labels = true;
        Ok(predicted)
    }

    /// The numbers over all scenes so far.
    pub fn report(&self) -> EvaluationReport {
        EvaluationReport {
            oracle: self.scores.oracle.tester_report(),
            random: self.random.tester_report(),
            model: self.has_labels.then(|| self.scores.model.tester_report()),
            given: (self.withheld > 0).then(|| self.given.tester_report()),
            withheld: self.withheld,
        }
    }
}

/// Evaluates a network on scenes, of which one is held at a time: name and scene each.
///
/// `class_of`: as in [`Evaluation::truth`]. `progress` is called while the network runs, and may stop
/// it.
///
/// ```
/// use scenesplat::embedded;
/// use scenesplat::evaluation::{EvaluationSettings, background, evaluate};
/// use scenesplat::prelude::*;
/// use scenesplat::rooms::{SyntheticRoomSettings, generate};
/// use scenesplat::scene::LabelSet;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let network = Network::load(embedded::config()?, &Weights::Embedded, WeightOptions::default())?;
/// let text = embedded::vocabulary()?.class_table();
/// let excluded = background(&LabelSet::new(text.names.clone())?);
/// let settings = EvaluationSettings { excluded, ..EvaluationSettings::default() };
/// let room = generate(&SyntheticRoomSettings::with_count(800, 1))?.scene;
/// let scenes = [("room".to_owned(), room)];
/// let report = evaluate(&network, &text, settings, scenes, None, &mut |_| Ok(()))?;
/// assert!(report.model.unwrap().all_accuracy > report.random.all_accuracy);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// Names the first scene that cannot be scored, and why.
pub fn evaluate(
    network: &Network,
    text: &TextTable,
    settings: EvaluationSettings,
    scenes: impl IntoIterator<Item = (String, GaussianScene)>,
    class_of: Option<&[i32]>,
    progress: &mut dyn FnMut(EncodeProgress) -> Result<(), EncodeError>,
) -> Result<EvaluationReport, EvaluationError> {
    let mut evaluation = Evaluation::new(text, settings)?;
    let encoder = SceneEncoder::new(network);
    let mut add = |scene: &GaussianScene| {
        let truth = evaluation.truth(scene, class_of)?;
        let checked = evaluation.check(&truth, None)?;
        evaluation.add_truth(&truth, &checked)?;
        let features = encoder.encode(scene, progress)?;
        let labels = evaluation.label(&features, network.is_classifier())?;
        evaluation.add_labels(&truth, labels).map(drop)
    };
    for (name, scene) in scenes {
        add(&scene).map_err(|source| match source {
            EvaluationError::Encode(EncodeError::Stopped) => source,
            _ => EvaluationError::Scene { scene: name, source: Box::new(source) },
        })?;
    }
    Ok(evaluation.report())
}

/// A row with the text of another class.
fn fault(labels: &[i32], row: usize) -> Result<Fault, EvaluationError> {
    let own = labels.get(row).copied().unwrap_or(-1);
    let other = labels.iter().copied().find(|l| *l >= 0 && *l != own);
    match (own >= 0, other) {
        (true, Some(other)) => Ok(Fault { row, class: other as usize }),
        _ => Err(EvaluationError::Fault { row }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_scene::LabelledPoints;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    fn scene() -> GaussianScene {
        GaussianScene {
            coord: (0..4).map(|i| [i as f32, 0.0, 0.0]).collect(),
            segment: Some(vec![0, 1, 1, -5]),
            ..GaussianScene::default()
        }
    }

    fn settings(vote_k: usize) -> EvaluationSettings {
        EvaluationSettings { vote_k, ..EvaluationSettings::default() }
    }

    #[test]
    fn labels_are_scored_beside_the_truth_and_chance() {
        let text = own_directions(names(&["wall", "chair"])).unwrap();
        let mut evaluation = Evaluation::new(&text, settings(0)).unwrap();
        let scene = scene();
        let truth = evaluation.truth(&scene, None).unwrap();
        let checked = evaluation.check(&truth, None).unwrap();
        evaluation.add_truth(&truth, &checked).unwrap();
        assert!(evaluation.report().model.is_none());
        evaluation.add_labels(&truth, vec![0, 0, 1, 1]).unwrap();
        let report = evaluation.report();
        assert_eq!(report.oracle.all_accuracy, Some(1.0));
        assert_eq!(report.model.unwrap().all_accuracy, Some(2.0 / 3.0));
        let error = evaluation.check(&truth, Some(0)).unwrap_err();
        assert!(matches!(error, EvaluationError::Oracle(_)), "{error}");
        let error = evaluation.check(&truth, Some(3)).unwrap_err();
        assert!(matches!(error, EvaluationError::Fault { row: 3 }), "{error}");
    }

    #[test]
    fn evaluations_of_parts_add_up_to_that_of_all() {
        let text = own_directions(names(&["wall", "chair"])).unwrap();
        let settings = EvaluationSettings { excluded: vec![0], ..settings(0) };
        let scenes = [vec![0, 1, 1, -5], vec![1, 1, 1, 1], vec![0, 0, 1, 0]]
            .map(|labels| GaussianScene { segment: Some(labels), ..scene() });
        let labels = [vec![0, 0, 1, 1], vec![1, 0, 1, -1], vec![1, 0, 1, 0]];
        let withheld = [&[false, true, false, true][..], &[], &[true, false, false, false]];
        let of = |which: &[usize]| {
            let mut evaluation = Evaluation::new(&text, settings.clone()).unwrap();
            for &i in which {
                let truth = evaluation.truth(&scenes[i], None).unwrap();
                let checked = evaluation.check(&truth, None).unwrap();
                evaluation.add_truth(&truth, &checked).unwrap();
                let about = Restraint { voters: None, withheld: withheld[i] };
                evaluation.add_some_labels(&truth, labels[i].clone(), about).unwrap();
            }
            evaluation.report()
        };
        let all = of(&[0, 1, 2]);
        assert!(all.given.is_some() && all.withheld == 2, "{all:?}");
        let parts = [of(&[0]), of(&[1]), of(&[2])];
        // As they come back from files.
        let parts = parts.map(|part| {
            let text = serde_json::to_string(&part).unwrap();
            serde_json::from_str::<EvaluationReport>(&text).unwrap()
        });
        assert_eq!(EvaluationReport::sum(&parts).unwrap(), all);
        assert_eq!(EvaluationReport::sum([&parts[2], &of(&[0, 1])]).unwrap(), all);
        assert_eq!(EvaluationReport::sum(&[]), None);
        let without = EvaluationReport { model: None, ..parts[0].clone() };
        assert_eq!(EvaluationReport::sum([&without, &parts[1]]), None, "half of the labels");
        let mut other = parts[0].clone();
        other.oracle.classes[0].excluded = false;
        assert_eq!(EvaluationReport::sum([&other, &parts[1]]), None, "other classes left out");
        let mut hostile = parts[0].clone();
        hostile.random.classes[1].union = u64::MAX;
        assert_eq!(EvaluationReport::sum([&hostile, &parts[1]]), None, "too many rows");
    }

    #[test]
    fn withheld_labels_are_wrong_in_one_row_and_not_asked_for_in_the_other() {
        let text = own_directions(names(&["wall", "chair"])).unwrap();
        let scene = scene();
        let score = |withheld: &[bool], voters: Option<&[bool]>, k| {
            let mut evaluation = Evaluation::new(&text, settings(k)).unwrap();
            let truth = evaluation.truth(&scene, None).unwrap();
            let about = Restraint { voters, withheld };
            evaluation.add_some_labels(&truth, vec![0, 0, 1, 1], about).map(|_| evaluation.report())
        };
        let plain = score(&[], None, 0).unwrap();
        assert!(plain.given.is_none() && plain.withheld == 0);
        // The second is wrong, the last has no class: withholding both takes one of three.
        let some = score(&[false, true, false, true], None, 0).unwrap();
        assert_eq!(some.withheld, 1);
        assert_eq!(some.model.unwrap().all_accuracy, Some(2.0 / 3.0));
        assert_eq!(some.given.unwrap().all_accuracy, Some(1.0));
        // The right one in its place.
        let right = score(&[true, false, false, false], None, 0).unwrap();
        assert_eq!(right.model.unwrap().all_accuracy, Some(1.0 / 3.0));
        assert_eq!(right.given.unwrap().all_accuracy, Some(0.5));
        // Only the third votes: all are chairs.
        let voted = score(&[], Some(&[false, false, true, false]), 3).unwrap();
        assert_eq!(voted.model.unwrap().all_accuracy, Some(2.0 / 3.0));
        let error = score(&[true], None, 0).unwrap_err().to_string();
        assert!(error.contains("places without a label"), "{error}");
    }

    #[test]
    fn a_scene_with_labelled_points_only_has_an_oracle() {
        let text = own_directions(names(&["wall", "chair"])).unwrap();
        let mut evaluation = Evaluation::new(&text, settings(1)).unwrap();
        let points = LabelledPoints {
            coord: vec![[0.1, 0.0, 0.0], [2.9, 0.0, 0.0]],
            segment: Some(vec![1, 0]),
            instance: None,
        };
        let scene = GaussianScene { segment: None, labelled_points: Some(points), ..scene() };
        let truth = evaluation.truth(&scene, None).unwrap();
        let checked = evaluation.check(&truth, None).unwrap();
        evaluation.add_truth(&truth, &checked).unwrap();
        // Each Gaussian has the class of its nearest point, and each point that of its nearest Gaussian.
        assert_eq!(evaluation.report().oracle.all_accuracy, Some(1.0));
    }

    #[test]
    fn scenes_without_a_truth_are_refused() {
        let text = own_directions(names(&["wall", "chair"])).unwrap();
        let evaluation = Evaluation::new(&text, settings(0)).unwrap();
        let refused = |scene: &GaussianScene, class_of: Option<&[i32]>| {
            evaluation.truth(scene, class_of).unwrap_err()
        };
        let none = GaussianScene { segment: None, ..scene() };
        assert!(matches!(refused(&none, None), EvaluationError::NoLabels));
        assert!(matches!(refused(&scene(), Some(&[-1, -1])), EvaluationError::NoLabels));
        let error = refused(&scene(), Some(&[0]));
        assert!(
            matches!(error, EvaluationError::UnknownLabel { row: 1, label: 1, known: 1 }),
            "{error}"
        );
        let voters = EvaluationSettings { voters_with_feature: true, ..settings(3) };
        let evaluation = Evaluation::new(&text, voters).unwrap();
        let error = evaluation.truth(&scene(), None).unwrap_err();
        assert!(matches!(error, EvaluationError::NoVoters), "{error}");
        let masked = GaussianScene { valid_feat_mask: Some(vec![true; 4]), ..scene() };
        evaluation.truth(&masked, None).unwrap();
    }
}

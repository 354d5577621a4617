//! Features and classes in, labels and scores out.

use crate::inference::{EncodeError, SceneFeatures};
use crate::text::text_rows;
use scenesplat_metrics::{
    FeatureFn, FeatureRows, MetricError, TextRows, UnknownRule, ZeroShotOptions,
    class_probabilities, classify, keep_withheld, vote,
};
use scenesplat_objects::ObjectError;
use scenesplat_objects::surfaces::{AgreeSettings, ClassShares, SceneSurfaces, agree};
use scenesplat_scene::TextTable;
use std::borrow::Cow;

/// Neighbors that vote on a label, where nobody says how many.
pub const VOTE_K: usize = 25;

/// Why a scene could not be labeled.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LabelError {
    /// Texts and features are of different networks.
    #[error(
        "the texts have {texts} values, the features {features}: they belong to different networks; \
         give the texts of this network, or the network of these texts"
    )]
    Width {
        /// Values of a text row.
        texts: usize,
        /// Values of a feature row.
        features: usize,
    },
    /// Features that went to a file could not be read.
    #[error(transparent)]
    Features(#[from] EncodeError),
    /// Surfaces that cannot be found, or are of another scene.
    #[error(transparent)]
    Surfaces(#[from] ObjectError),
    /// A probability is asked for, and nothing says what cosines have to be divided by for one.
    #[error(
        "a least probability needs a temperature, such as the network inside the program comes with; \
         give a least cosine (--min-score)"
    )]
    NoTemperature,
    /// Texts, votes or settings that cannot be used.
    #[error(transparent)]
    Metric(#[from] MetricError),
}

/// What the numbers of a feature row are compared with.
#[derive(Debug, Clone, Copy)]
pub enum Classes<'a> {
    /// The row of the nearest text by cosine is the class.
    Texts(&'a TextTable),
    /// The features are the probabilities of so many classes.
    Probabilities(usize),
}

impl Classes<'_> {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Texts(table) => table.len(),
            Self::Probabilities(count) => *count,
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Labels and scores of some rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// Class or −1. `[N]`
    pub labels: Vec<i32>,
    /// Cosine with the class's text, −1..=1, or its probability. `[N]`
    pub scores: Vec<f32>,
    /// Distinct rows without a usable feature.
    pub num_unusable: usize,
    /// Distinct rows that the thresholds left without a class.
    pub num_withheld: usize,
}

impl Labels {
    /// Takes the labels of some Gaussians (−1), whose scores stay; gives the number that had one. `rows`: whose;
    /// shorter than the labels, the rest keep theirs.
    pub fn withhold(&mut self, rows: &[bool]) -> usize {
        let mut taken = 0;
        for (label, _) in self.labels.iter_mut().zip(rows).filter(|(_, is)| **is) {
            taken += usize::from(*label >= 0);
            *label = -1;
        }
        taken
    }
}

/// Feature rows of a scene as the metrics read them: the distinct ones, `[S, width]`.
///
/// # Errors
/// If a row has no value.
pub fn distinct_rows(features: &SceneFeatures) -> Result<impl FeatureRows + '_, MetricError> {
    FeatureFn::new(features.num_slots(), features.width(), |rows, out: &mut [f32]| {
        out.copy_from_slice(&features.slot_rows(rows)?);
        Ok(())
    })
}

/// Texts as the rows of features can be compared with them: along the same directions.
#[derive(Debug)]
pub struct ComparableTexts<'t> {
    values: Cow<'t, [f32]>,
    dim: usize,
}

impl<'t> ComparableTexts<'t> {
    /// Texts for the features of a scene.
    ///
    /// # Errors
    /// If texts and features are of different networks.
    pub fn new(features: &SceneFeatures, text: &'t TextTable) -> Result<Self, LabelError> {
        check_width(text.dim, features.text_width())?;
        let Some(codes) = features.codes() else {
            return Ok(Self { values: Cow::Borrowed(&text.values), dim: text.dim });
        };
        // What is wrong with a text is said of the text.
        text_rows(text)?;
        Ok(Self { values: Cow::Owned(codes.project(&text.values)), dim: codes.codes() })
    }

    /// As the metrics read them.
    ///
    /// # Errors
    /// If a text has no direction.
    pub fn rows(&self) -> Result<TextRows<'_>, MetricError> {
        match &self.values {
            Cow::Borrowed(values) => TextRows::new(values, self.dim),
            Cow::Owned(values) => TextRows::projected(values, self.dim),
        }
    }

    /// One after the other, as wide as the features. `[classes, width]`
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The text of a class, as wide as the features.
    pub fn row(&self, class: usize) -> Option<&[f32]> {
        self.values.chunks_exact(self.dim).nth(class)
    }
}

/// Labels each Gaussian by its own feature. `[N]`
///
/// # Errors
/// If texts and features differ in width, or features cannot be read.
pub fn label_gaussians(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
) -> Result<Labels, LabelError> {
    Ok(of_gaussians(features, &label_distinct(features, classes, options)?))
}

/// Labels of the distinct rows, given to the Gaussians that have them.
fn of_gaussians(features: &SceneFeatures, distinct: &Labels) -> Labels {
    let of = |slot: &u32| *slot as usize;
    Labels {
        labels: features.inverse().iter().map(|s| distinct.labels[of(s)]).collect(),
        scores: features.inverse().iter().map(|s| distinct.scores[of(s)]).collect(),
        num_unusable: distinct.num_unusable,
        num_withheld: distinct.num_withheld,
    }
}

/// As [`label_gaussians`], and then each Gaussian takes the class that most of its `k` nearest have
/// (none for `k` below 2); what a threshold withheld stays unknown. Gaussians that no network read have no
/// say ([`SceneFeatures::voters`]).
///
/// `coord`: positions of the same Gaussians, meters. `[N, 3]`
///
/// # Errors
/// As [`label_gaussians`]; also if positions and features differ in number.
pub fn label_with_vote(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
    coord: &[[f32; 3]],
    k: usize,
) -> Result<Labels, LabelError> {
    label_agreeing_with_vote(features, classes, options, &Agreement::default(), coord, k)
}

/// What labels agree on, and their least probability. The default: nothing, and none.
#[derive(Debug, Clone, Copy, Default)]
pub struct Agreement<'a> {
    /// Surfaces that are of one class each.
    pub surfaces: Option<&'a SceneSurfaces>,
    /// What cosines are divided by for the softmax that makes them probabilities; without it, all that speaks for a
    /// class is that it is the best one. Of no effect on features that are probabilities.
    pub temperature: Option<f32>,
    /// Gaussians whose best class is less probable stay without one, 0..=1.
    pub min_probability: Option<f32>,
    /// Least surface of a piece of each class, square meters (see [`AgreeSettings::least_area`]); empty: any.
    pub least_area: &'a [f64],
}

/// As [`label_gaussians`], and then labels agree on surfaces ([`agree`]). `[N]`
///
/// # Errors
/// As [`label_gaussians`]; also if the surfaces are of other Gaussians, a probability is asked for without a
/// temperature, or one of the two is out of range.
pub fn label_agreeing(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
    agreement: &Agreement<'_>,
) -> Result<Labels, LabelError> {
    let mut found = agreed_labels(features, classes, options, agreement)?;
    if agreement.surfaces.is_some() {
        rescore(features, classes, &found.labels, &mut found.scores)?;
    }
    Ok(found)
}

/// As [`label_agreeing`], but scores are those of the labels before they agreed.
pub(crate) fn agreed_labels(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
    agreement: &Agreement<'_>,
) -> Result<Labels, LabelError> {
    if agreement.surfaces.is_none() && agreement.min_probability.is_none() {
        return label_gaussians(features, classes, options);
    }
    let mut distinct = label_distinct(features, classes, options)?;
    let shares = class_shares(features, classes, options, agreement, &distinct.labels)?;
    if let Some(least) = agreement.min_probability {
        if !(0.0..=1.0).contains(&least) {
            let (field, value) = ("min_probability", f64::from(least));
            return Err(MetricError::Setting { field, value, expected: "a number in 0..=1" }.into());
        }
        for (row, label) in distinct.labels.iter_mut().enumerate() {
            let best = usize::try_from(*label).map_or(1.0, |c| shares[row * classes.len() + c]);
            if best < least {
                *label = -1;
                distinct.num_withheld += 1;
            }
        }
    }
    let mut found = of_gaussians(features, &distinct);
    if let Some(surfaces) = agreement.surfaces {
        let (row_of, num_classes) = (features.inverse(), classes.len());
        let shares = ClassShares { row_of, rows: &shares, num_classes };
        let settings =
            AgreeSettings { least_area: agreement.least_area, ..AgreeSettings::default() };
        agree(&mut found.labels, &shares, surfaces, &settings)?;
    }
    Ok(found)
}

/// As [`label_with_vote`], and before the vote labels agree as [`label_agreeing`] has it.
///
/// # Errors
/// As [`label_with_vote`] and [`label_agreeing`].
pub fn label_agreeing_with_vote(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
    agreement: &Agreement<'_>,
    coord: &[[f32; 3]],
    k: usize,
) -> Result<Labels, LabelError> {
    if k < 2 {
        return label_agreeing(features, classes, options, agreement);
    }
    let mut found = agreed_labels(features, classes, options, agreement)?;
    let mut voted = vote(coord, &found.labels, features.voters(), coord, k, classes.len())?;
    if options.unknown != UnknownRule::default() || agreement.min_probability.is_some() {
        keep_withheld(&found.labels, &mut voted);
    }
    rescore(features, classes, &voted, &mut found.scores)?;
    found.labels = voted;
    Ok(found)
}

/// How much speaks for each class in each distinct row. `[rows, classes]`
fn class_shares(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
    agreement: &Agreement<'_>,
    labels: &[i32],
) -> Result<Vec<f32>, LabelError> {
    let count = classes.len();
    match (classes, agreement.temperature) {
        (Classes::Texts(text), Some(temperature)) => {
            let text = ComparableTexts::new(features, text)?;
            let rows = distinct_rows(features)?;
            Ok(class_probabilities(&rows, text.rows()?, options, temperature)?)
        }
        (Classes::Texts(_), None) => {
            if agreement.min_probability.is_some() {
                return Err(LabelError::NoTemperature);
            }
            let mut shares = vec![0.0; labels.len() * count];
            for (row, label) in labels.iter().enumerate() {
                if let Ok(class) = usize::try_from(*label) {
                    shares[row * count + class] = 1.0;
                }
            }
            Ok(shares)
        }
        (Classes::Probabilities(_), _) => {
            let mut shares = features.slot_rows(0..features.num_slots())?;
            for row in shares.chunks_exact_mut(count) {
                for (class, share) in row.iter_mut().enumerate() {
                    let is_allowed = options.candidates.as_ref().is_none_or(|m| m[class]);
                    if !is_allowed || !share.is_finite() {
                        *share = 0.0;
                    }
                }
            }
            Ok(shares)
        }
    }
}

/// Labels each distinct row.
fn label_distinct(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
) -> Result<Labels, LabelError> {
    match classes {
        Classes::Texts(text) => {
            let text = ComparableTexts::new(features, text)?;
            let found = classify(&distinct_rows(features)?, text.rows()?, options)?;
            Ok(Labels {
                labels: found.labels,
                scores: found.scores,
                num_unusable: found.num_unusable,
                num_withheld: found.num_withheld,
            })
        }
        Classes::Probabilities(count) => {
            check_width(count, features.width())?;
            most_probable(features, options)
        }
    }
}

/// Refuses texts of another network.
fn check_width(texts: usize, features: usize) -> Result<(), LabelError> {
    if texts == features { Ok(()) } else { Err(LabelError::Width { texts, features }) }
}

/// The class of the largest probability in each distinct row, the first of equal ones.
fn most_probable(
    features: &SceneFeatures,
    options: &ZeroShotOptions,
) -> Result<Labels, LabelError> {
    let mut out = Labels::default();
    let allowed = |c: usize| options.candidates.as_ref().is_none_or(|m| m[c]);
    let UnknownRule { min_cosine, min_margin } = options.unknown;
    for row in 0..features.num_slots() {
        let p = features.slot_rows(row..row + 1)?;
        let mut best: Option<usize> = None;
        let mut second = 0.0;
        for c in (0..p.len()).filter(|&c| allowed(c) && p[c].is_finite()) {
            if best.is_none_or(|b| p[c] > p[b]) {
                second = best.map_or(0.0, |b| p[b]);
                best = Some(c);
            } else {
                second = p[c].max(second);
            }
        }
        let score = best.map_or(0.0, |b| p[b]);
        let withheld = best.is_some()
            && (min_cosine.is_some_and(|m| score < m)
                || min_margin.is_some_and(|m| score - second < m));
        out.labels.push(best.filter(|_| !withheld).map_or(-1, |b| b as i32));
        out.scores.push(score);
        out.num_unusable += usize::from(best.is_none());
        out.num_withheld += usize::from(withheld);
    }
    Ok(out)
}

/// The score of each Gaussian's label after a vote: cosine of its own feature with the text, or its
/// probability of the class. Unlabeled Gaussians keep the score that was too low.
fn rescore(
    features: &SceneFeatures,
    classes: Classes<'_>,
    labels: &[i32],
    scores: &mut [f32],
) -> Result<(), LabelError> {
    const BLOCK: usize = 4096;
    let width = features.width();
    let text = match classes {
        Classes::Texts(text) => Some(ComparableTexts::new(features, text)?),
        Classes::Probabilities(_) => None,
    };
    for start in (0..labels.len()).step_by(BLOCK) {
        let end = (start + BLOCK).min(labels.len());
        let rows = features.gaussian_rows(start..end)?;
        for (i, row) in (start..end).zip(rows.chunks_exact(width)) {
            let Ok(label) = usize::try_from(labels[i]) else { continue };
            scores[i] = match &text {
                None => row[label],
                Some(table) => table
                    .row(label)
                    .map_or(0.0, |text| row.iter().zip(text).map(|(a, b)| a * b).sum()),
            };
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_objects::surfaces::{SurfaceSettings, surfaces};

    /// Two directions; the rows lie between them, the first for 1, the others for 0, some hardly.
    fn case() -> (SceneFeatures, TextTable) {
        let row = |degrees: f32| [degrees.to_radians().cos(), degrees.to_radians().sin()];
        let rows: Vec<f32> = [47.0, 46.0, 10.0, 44.5, 0.0].into_iter().flat_map(row).collect();
        let text = TextTable {
            values: vec![1.0, 0.0, 0.0, 1.0],
            dim: 2,
            names: vec!["floor".to_owned(), "mug".to_owned()],
        };
        (SceneFeatures::from_rows(rows, 2).unwrap(), text)
    }

    fn labels(agreement: &Agreement<'_>) -> Result<Labels, LabelError> {
        let (features, text) = case();
        label_agreeing(&features, Classes::Texts(&text), &ZeroShotOptions::default(), agreement)
    }

    #[test]
    fn least_probabilities_are_those_of_the_softmax() {
        assert_eq!(labels(&Agreement::default()).unwrap().labels, [1, 1, 0, 0, 0]);
        // At 0.1 the first has 1 / (1 + exp(−(sin 47° − cos 47°) / 0.1)) = 0.621, the second 0.561, the fourth 0.531.
        let at = |least| Agreement {
            temperature: Some(0.1),
            min_probability: Some(least),
            ..Agreement::default()
        };
        let of = |least| {
            let found = labels(&at(least)).unwrap();
            (found.labels, found.num_withheld)
        };
        assert_eq!(of(0.5), (vec![1, 1, 0, 0, 0], 0));
        assert_eq!(of(0.55), (vec![1, 1, 0, -1, 0], 1));
        assert_eq!(of(0.6), (vec![1, -1, 0, -1, 0], 2));
        assert_eq!(of(0.63), (vec![-1, -1, 0, -1, 0], 3));
        let scores = labels(&at(0.63)).unwrap().scores;
        assert!((scores[0] - 47.0_f32.to_radians().sin()).abs() < 1e-6, "scores stay");
        assert!(matches!(
            labels(&Agreement { temperature: None, ..at(0.5) }),
            Err(LabelError::NoTemperature)
        ));
        for bad in [at(1.1), at(f32::NAN), Agreement { temperature: Some(0.0), ..at(0.5) }] {
            assert!(labels(&bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn with_a_temperature_what_is_surer_counts_for_more() {
        // One surface of all five: two are hardly for 1, one hardly for 0, two surely.
        let coord: Vec<[f32; 3]> = (0..5).map(|i| [0.001 * i as f32, 0.0, 0.0]).collect();
        let found = surfaces(&coord, &[[0.5; 3]; 5], &SurfaceSettings::default()).unwrap();
        let on = Agreement { surfaces: Some(&found), ..Agreement::default() };
        assert_eq!(labels(&on).unwrap().labels, [0; 5], "three to two");
        let (features, text) = case();
        let barred = ZeroShotOptions { candidates: Some(vec![false, true]), ..Default::default() };
        let of = |agreement| label_agreeing(&features, Classes::Texts(&text), &barred, agreement);
        let warm = Agreement { temperature: Some(0.05), ..on };
        assert_eq!(labels(&warm).unwrap().labels, [0; 5], "two are sure");
        assert_eq!(of(&warm).unwrap().labels, [1; 5], "what may not be predicted has no share");
        // One surely for 1, two hardly for 0.
        let rows = vec![0.6, 0.8, 0.714, 0.7, 0.72, 0.694];
        let features = SceneFeatures::from_rows(rows, 2).unwrap();
        let three = surfaces(&coord[..3], &[[0.5; 3]; 3], &SurfaceSettings::default()).unwrap();
        let on = Agreement { surfaces: Some(&three), ..Agreement::default() };
        let of = |agreement: &Agreement<'_>| {
            let options = ZeroShotOptions::default();
            label_agreeing(&features, Classes::Texts(&text), &options, agreement).unwrap().labels
        };
        assert_eq!(of(&Agreement::default()), [1, 0, 0]);
        assert_eq!(of(&on), [0; 3]);
        assert_eq!(of(&Agreement { temperature: Some(0.05), ..on }), [1; 3]);
        // What comes as probabilities counts as it is (here: at unit length).
        let rows = vec![0.4, 0.6, 0.45, 0.55, 0.9, 0.1];
        let features = SceneFeatures::from_rows(rows, 2).unwrap();
        let options = ZeroShotOptions::default();
        let of = |agreement: &Agreement<'_>| {
            label_agreeing(&features, Classes::Probabilities(2), &options, agreement)
                .unwrap()
                .labels
        };
        assert_eq!(of(&Agreement::default()), [1, 1, 0]);
        assert_eq!(of(&on), [0; 3], "2.18 to 1.72");
        let least = Agreement { min_probability: Some(0.8), ..Agreement::default() };
        assert_eq!(of(&least), [1, -1, 0]);
    }
}

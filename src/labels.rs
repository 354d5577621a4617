//! Features and classes in, labels and scores out.

use crate::inference::{EncodeError, SceneFeatures};
use crate::text::text_rows;
use scenesplat_metrics::{
    FeatureFn, FeatureRows, MetricError, TextRows, UnknownRule, ZeroShotOptions, classify,
    keep_withheld, vote,
};
use scenesplat_objects::ObjectError;
use scenesplat_objects::surfaces::{Surfaces, agree};
use scenesplat_scene::TextTable;
use std::borrow::Cow;

/// Why a scene could not be labelled.
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
pub(crate) struct ComparableTexts<'t> {
    values: Cow<'t, [f32]>,
    dim: usize,
}

impl<'t> ComparableTexts<'t> {
    /// # Errors
    /// If texts and features are of different networks.
    pub(crate) fn new(features: &SceneFeatures, text: &'t TextTable) -> Result<Self, LabelError> {
        check_width(text.dim, features.text_width())?;
        let Some(codes) = features.codes() else {
            return Ok(Self { values: Cow::Borrowed(&text.values), dim: text.dim });
        };
        // What is wrong with a text is said of the text.
        text_rows(text)?;
        Ok(Self { values: Cow::Owned(codes.project(&text.values)), dim: codes.codes() })
    }

    /// As the metrics read them.
    pub(crate) fn rows(&self) -> Result<TextRows<'_>, MetricError> {
        match &self.values {
            Cow::Borrowed(values) => TextRows::new(values, self.dim),
            Cow::Owned(values) => TextRows::projected(values, self.dim),
        }
    }

    /// One after the other, as wide as the features. `[classes, width]`
    pub(crate) fn values(&self) -> &[f32] {
        &self.values
    }

    pub(crate) fn row(&self, class: usize) -> Option<&[f32]> {
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
    let distinct = label_distinct(features, classes, options)?;
    let of = |slot: &u32| *slot as usize;
    Ok(Labels {
        labels: features.inverse().iter().map(|s| distinct.labels[of(s)]).collect(),
        scores: features.inverse().iter().map(|s| distinct.scores[of(s)]).collect(),
        ..distinct
    })
}

/// As [`label_gaussians`], and then each Gaussian takes the class that most of its `k` nearest have
/// (none for `k` below 2); what a threshold withheld stays unknown. Gaussians that no network read have no
/// say ([`SceneFeatures::voters`]).
///
/// `coord`: positions of the same Gaussians, metres. `[N, 3]`
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
    label_on_surfaces(features, classes, options, coord, k, &[])
}

/// As [`label_with_vote`], and before the vote, Gaussians take the class of most of their `surfaces` ([`agree`]; none
/// without any).
///
/// # Errors
/// As [`label_with_vote`]; also if the surfaces are of other Gaussians.
pub fn label_on_surfaces(
    features: &SceneFeatures,
    classes: Classes<'_>,
    options: &ZeroShotOptions,
    coord: &[[f32; 3]],
    k: usize,
    surfaces: &[Surfaces],
) -> Result<Labels, LabelError> {
    let mut found = label_gaussians(features, classes, options)?;
    if !surfaces.is_empty() {
        agree(&mut found.labels, classes.len(), surfaces)?;
        if k < 2 {
            rescore(features, classes, &found.labels, &mut found.scores)?;
        }
    }
    if k > 1 {
        let voters = features.voters();
        let mut voted = vote(coord, &found.labels, voters, coord, k, classes.len())?;
        if options.unknown != UnknownRule::default() {
            keep_withheld(&found.labels, &mut voted);
        }
        rescore(features, classes, &voted, &mut found.scores)?;
        found.labels = voted;
    }
    Ok(found)
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
/// probability of the class. Unlabelled Gaussians keep the score that was too low.
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

//! Contrast between the mean features of classes.

mod aggregate;
mod classes;
mod halves;

pub use aggregate::aggregated_contrastive;
pub use classes::{ClassSource, TextColumns, argmax_labels, pseudo_labels};
pub use halves::{ClassHalves, split_classes};

use crate::error::check_len;
use crate::loss::{Loss, LossInput};
use crate::rows::Reduction;
use candle_core::{Result, Tensor};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

const NAME: &str = "aggregated_contrastive";

/// When a term is on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TermSchedule {
    /// In every step.
    #[default]
    Always,
    /// Never.
    Skip,
    /// In the last part of the training, in percent: `Last(75.0)` is off up to and including a
    /// progress of 0.25. The original knows the progress of whole epochs only.
    Last(f64),
}

impl TermSchedule {
    /// Whether the term is on when this share (0..=1) of the training is done.
    pub fn is_on(self, progress: f64) -> bool {
        match self {
            Self::Always => true,
            Self::Skip => false,
            Self::Last(percent) => progress > 1.0 - percent / 100.0,
        }
    }
}

/// Pulls the two halves of each class together, and different classes apart.
///
/// The rows of a class that count (valid, labeled, class not too small) are cut at random into two
/// halves of ⌊n/2⌋ and ⌈n/2⌉ rows. With the unit sums `a`, `b` of the halves and `Z = a·bᵀ/τ`, the
/// loss is `½ [CE(Z, diagonal) + CE(Zᵀ, diagonal)]`. Classes are taken over the whole batch. One
/// class alone gives exactly 0.
///
/// Which labels these are matters for what may be claimed: with [`ClassSource::Labels`] the training
/// sees the ground truth that a "zero-shot" evaluation asks for later. [`Loss::settings`] says it.
///
/// # Source
/// `AggregatedContrastiveLoss` in `pointcept/models/losses/misc.py`, SceneSplat be9d5e1. Differs: it
/// is off (`None`) where the original gives a constant 0; sums are f64; halves come from the step's
/// seed; pseudo-labels are new. The same: a class whose features are all zero has the gradient that
/// the floor of its norm (1e-12) gives, which is large.
#[derive(Debug, Clone)]
pub struct AggregatedContrastive {
    /// τ, above 0. Default: the paper's 0.2.
    pub temperature: f64,
    /// Default: the last 75 %.
    pub schedule: TermSchedule,
    /// Classes with fewer rows are left out. At least 2; default: 100.
    pub min_points: usize,
    /// Where the classes come from. Default: the given labels, as in the paper.
    pub classes: ClassSource,
    /// Mean over the classes, or sum.
    pub reduction: Reduction,
}

impl Default for AggregatedContrastive {
    fn default() -> Self {
        Self {
            temperature: 0.2,
            schedule: TermSchedule::Last(75.0),
            min_points: 100,
            classes: ClassSource::Labels,
            reduction: Reduction::Mean,
        }
    }
}

impl AggregatedContrastive {
    /// Labels of this step; `None` without a source, or if the task gives none.
    fn labels<'a>(&self, input: &LossInput<'a>) -> Result<Option<Cow<'a, [i32]>>> {
        Ok(match &self.classes {
            ClassSource::Off => None,
            ClassSource::Labels => input.label.map(Cow::Borrowed),
            ClassSource::PseudoLabels(texts) => {
                Some(Cow::Owned(pseudo_labels(input.needs_target(NAME)?, texts, input.valid)?))
            }
            ClassSource::Argmax => {
                Some(Cow::Owned(argmax_labels(input.needs_target(NAME)?, input.valid)?))
            }
        })
    }
}

impl Loss for AggregatedContrastive {
    fn name(&self) -> &str {
        NAME
    }

    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        if !self.schedule.is_on(input.progress) {
            return Ok(None);
        }
        let Some(labels) = self.labels(input)? else { return Ok(None) };
        let rows = input.pred.dims2()?.0;
        check_len(NAME, "label", rows, labels.len())?;
        let halves = split_classes(&labels, input.valid, self.min_points, input.seed)?;
        aggregated_contrastive(input.pred, &halves, self.temperature, self.reduction)
    }

    fn off_reason(&self, input: &LossInput<'_>) -> String {
        match (self.schedule, &self.classes) {
            (TermSchedule::Skip, _) => "its schedule is to skip it".to_owned(),
            (TermSchedule::Last(percent), _) if !self.schedule.is_on(input.progress) => {
                format!("its schedule is the last {percent} % of the training")
            }
            (_, ClassSource::Off) => "it has no source of classes".to_owned(),
            (_, ClassSource::Labels) if input.label.is_none() => "there are no labels".to_owned(),
            _ => format!("no class has {} rows", self.min_points),
        }
    }

    fn settings(&self) -> String {
        let Self { temperature, schedule, min_points, classes, .. } = self;
        let schedule = match schedule {
            TermSchedule::Always => "always".to_owned(),
            TermSchedule::Skip => "never".to_owned(),
            TermSchedule::Last(percent) => format!("last {percent} %"),
        };
        format!("temperature {temperature}, {schedule}, from {min_points} rows, classes: {classes}")
    }
}

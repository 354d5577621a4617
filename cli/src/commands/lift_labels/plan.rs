//! The decisions of lifting as a part of the plan.

use super::args::{Args, DepthArg, FrameWeightsArg, RobustArg, RobustRuleArg};
use scenesplat::datasets::effects::plan::{EffectChoice, EffectDecision};
use scenesplat::rasterizer::lifting::{
    Aggregate, DepthEffect, Disagreement, FinaliseSettings, Robust,
};
use scenesplat_lab::capture::{CaptureFinding, CaptureReport};

/// The part of the plan that lifting decides.
pub const LIFTING: &str = "lifting";

/// Whether a level is guarded against wrong labels, and above which variance of them.
#[derive(Default)]
pub struct Guard {
    /// As the plan tells it.
    pub decision: EffectDecision,
    /// `None`: everywhere.
    pub above: Option<f32>,
}

impl Args {
    /// How features are made of them.
    pub(super) fn finalise(&self, guard: &Guard) -> FinaliseSettings {
        let robust = guard.decision.on;
        let base = if robust { FinaliseSettings::robust() } else { FinaliseSettings::default() };
        let aggregate = match self.robust_rule {
            RobustRuleArg::HeaviestGroup if robust => Aggregate::HEAVIEST_GROUP,
            _ => base.aggregate,
        };
        FinaliseSettings {
            aggregate,
            guard_above: guard.above,
            view_exponent: self.view_exponent,
            min_coverage: self.coverage,
            min_labelled_share: self.labelled_share,
            normalise: !self.unnormalised,
        }
    }

    /// Whether pixels of another depth label nothing; `measured`: what some pictures show, where they were asked.
    pub(super) fn about_depth(&self, on: bool, measured: Option<&DepthEffect>) -> EffectDecision {
        let choice = match &self.lifting.depth {
            DepthArg::Auto => EffectChoice::Auto,
            DepthArg::Off => EffectChoice::Off,
            DepthArg::Render | DepthArg::Folder(_) => EffectChoice::On,
        };
        let why = match (measured, choice) {
            (Some(found), _) => format!(
                "labels at another depth mislead by {}, {:.1} % of the weight is at its depth",
                found.misleading.map_or("an unknown amount".to_owned(), |m| format!("{m:.3}")),
                100.0 * found.kept
            ),
            (None, EffectChoice::Auto) => "the rule of center pixels has none".to_owned(),
            (None, _) => "by choice".to_owned(),
        };
        EffectDecision {
            effect: "depth".to_owned(),
            choice,
            on,
            measure: measured.and_then(|found| found.misleading),
            threshold: Some(DepthEffect::MISLEADING),
            action: Some("pixels of another depth label nothing".to_owned()),
            why,
            ..EffectDecision::default()
        }
    }

    /// Whether photos count by their motion; `less`: how many count less.
    pub(super) fn about_frames(
        &self,
        report: Option<&CaptureReport>,
        less: usize,
    ) -> EffectDecision {
        let blur = report.and_then(|report| report.finding("blur"));
        let auto = self.frame_weights == FrameWeightsArg::Auto;
        let on = auto && blur.is_some_and(CaptureFinding::is_present);
        EffectDecision {
            effect: "frame weights".to_owned(),
            choice: if auto { EffectChoice::Auto } else { EffectChoice::Off },
            on,
            level: if on { blur.map_or(0.0, |b| b.severity) } else { 0.0 },
            measure: blur.and_then(|b| b.measure),
            threshold: blur.map(|b| b.threshold),
            action: Some("pictures that count less for their motion".to_owned()),
            why: blur.map_or("no photos were given".to_owned(), ToString::to_string),
            regions: Vec::new(),
            changed: Some(less),
        }
    }

    /// Whether a level's labels are guarded where they contradict each other.
    pub(super) fn about_labels(
        &self,
        level: usize,
        on: bool,
        measured: &Disagreement,
    ) -> EffectDecision {
        let choice = match self.lifting.robust {
            RobustArg::Auto => EffectChoice::Auto,
            RobustArg::On => EffectChoice::On,
            RobustArg::Off => EffectChoice::Off,
        };
        let threshold = match Robust::default() {
            Robust::Auto { above } => Some(above),
            Robust::On | Robust::Off => None,
        };
        let why = match (measured.value(), measured.conflicting()) {
            (Some(value), Some(share)) => format!(
                "view-inconsistent labels: disagreement {value:.3}, severity {:.1}; the labels of {:.1} % of \
                 {} Gaussians contradict each other",
                measured.severity(),
                100.0 * share,
                measured.gaussians()
            ),
            _ => "too few Gaussians were seen twice to tell".to_owned(),
        };
        EffectDecision {
            effect: format!("robust[{level}]"),
            choice,
            on,
            level: if on { measured.severity() } else { 0.0 },
            measure: measured.value(),
            threshold,
            action: Some("Gaussians by a robust rule".to_owned()),
            why,
            regions: Vec::new(),
            changed: Some(0),
        }
    }
}

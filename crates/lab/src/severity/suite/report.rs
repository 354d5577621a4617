//! The suite in numbers.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A module comes on by itself that gains so much f-mIoU, …
const WORTH_QUALITY: f64 = 0.01;
/// … or takes this share off the calibration error.
const WORTH_CALIBRATION: f64 = 0.2;

/// What labels are worth in one mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// `off`, `auto`, `found` or `on`.
    pub mode: String,
    /// Mean intersection over union of the classes but for wall, floor and ceiling, 0..=1; a Gaussian without a
    /// label is wrong.
    pub f_miou: f64,
    /// Expected calibration error of the labels that there are, 0..=1.
    pub ece: f64,
    /// Share of the Gaussians without a label.
    pub unknown: f64,
    /// Share of the labels that are right.
    pub right: f64,
    /// Deciding, the network and the labels.
    pub seconds: f64,
    /// Gaussians that the network did not read.
    pub left_out: usize,
    /// Gaussians whose labels were withheld, whatever their truth.
    pub withheld: usize,
}

/// One scene of the mixed suite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneRow {
    /// What it has; `none` for a clean one.
    pub effects: String,
    /// In each mode.
    pub modes: Vec<Figures>,
}

/// One module where its effect is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Worth {
    /// The effect.
    pub effect: String,
    /// With nothing done.
    pub off: Figures,
    /// With this module alone.
    pub on: Figures,
}

/// Two effects together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRow {
    /// Which.
    pub effects: String,
    /// f-mIoU without any.
    pub clean: f64,
    /// With one alone, and with the other.
    pub alone: [f64; 2],
    /// With both.
    pub together: f64,
}

/// All of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SuiteReport {
    /// Scenes of the mixed suite.
    pub scenes: usize,
    /// Gaussians of each.
    pub gaussians: usize,
    /// Of each effect.
    pub severity: f64,
    /// All scenes together, in each mode.
    pub modes: Vec<Figures>,
    /// Each module where its effect is.
    pub worth: Vec<Worth>,
    /// Pairs of effects.
    pub pairs: Vec<PairRow>,
    /// Each scene.
    pub rows: Vec<SceneRow>,
}

impl Worth {
    /// Whether the module gains a point of f-mIoU, or takes a fifth off the calibration error.
    pub fn is_worth_it(&self) -> bool {
        self.on.f_miou - self.off.f_miou >= WORTH_QUALITY
            || self.on.ece <= (1.0 - WORTH_CALIBRATION) * self.off.ece
    }
}

impl PairRow {
    /// How much worse both together are than the losses of each alone added up, as a share; below 0: better.
    pub fn excess(&self) -> f64 {
        let lost = |quality: f64| self.clean - quality;
        lost(self.together) - lost(self.alone[0]) - lost(self.alone[1])
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:<6} f-mIoU {:5.2} %  ECE {:5.2} %  unknown {:5.2} %  right {:5.2} %  {:7.2} s  left out {}  \
             withheld {}",
            self.mode,
            100.0 * self.f_miou,
            100.0 * self.ece,
            100.0 * self.unknown,
            100.0 * self.right,
            self.seconds,
            self.left_out,
            self.withheld
        )
    }
}

impl fmt::Display for SuiteReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scenes, gaussians, severity, .. } = self;
        writeln!(
            f,
            "{scenes} unseen rooms of {gaussians} Gaussians, effects at severity {severity}"
        )?;
        self.modes.iter().try_for_each(|mode| writeln!(f, "  {mode}"))?;
        for worth in &self.worth {
            let said = if worth.is_worth_it() { "worth it" } else { "not worth it" };
            writeln!(
                f,
                "where there are {}: {said}\n  {}\n  {}",
                worth.effect, worth.off, worth.on
            )?;
        }
        if !self.pairs.is_empty() {
            writeln!(
                f,
                "f-mIoU without, with one, with the other, with both; worse than the sum by"
            )?;
        }
        for pair in &self.pairs {
            let [a, b, c, d] =
                [pair.clean, pair.alone[0], pair.alone[1], pair.together].map(|v| 100.0 * v);
            let excess = 100.0 * pair.excess();
            writeln!(f, "  {:<18} {a:5.1} {b:5.1} {c:5.1} {d:5.1}  {excess:+5.1}", pair.effects)?;
        }
        write!(f, "worst pair: {:+.1} points", 100.0 * self.worst_excess())
    }
}

impl SuiteReport {
    /// The largest [`PairRow::excess`]; 0 without pairs.
    pub fn worst_excess(&self) -> f64 {
        self.pairs.iter().map(PairRow::excess).reduce(f64::max).unwrap_or(0.0)
    }
}

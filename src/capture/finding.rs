//! Evidence for effects, from pictures.

use super::probe::FrameEvidence;
use scenesplat_datasets::effects::MOST_SEVERE;
use std::fmt;

/// A number with its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// What it is.
    pub name: &'static str,
    /// Its value, finite.
    pub value: f64,
    /// Its unit; empty for a plain number.
    pub unit: &'static str,
}

/// Whether pictures show an effect, and how strong.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureFinding {
    /// `blur`, `light`, `noise`, `saturation`, `coverage`.
    pub effect: &'static str,
    /// What is compared with the threshold; the same scale as the severity. `None`: the pictures do not say.
    pub measure: Option<f64>,
    /// Below it there is no effect.
    pub threshold: f64,
    /// 0 (absent) to 5.
    pub severity: f64,
    /// What it rests on.
    pub figures: Vec<Figure>,
}

impl CaptureFinding {
    pub(super) fn new(
        effect: &'static str,
        measure: Option<f64>,
        threshold: f64,
        figures: Vec<Figure>,
    ) -> Self {
        let severity = measure.filter(|m| *m >= threshold).map_or(0.0, |m| m.min(MOST_SEVERE));
        Self { effect, measure, threshold, severity, figures }
    }

    /// Whether the effect is there.
    pub fn is_present(&self) -> bool {
        self.severity > 0.0
    }
}

impl fmt::Display for CaptureFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.measure {
            None => write!(f, "{}: the pictures do not say", self.effect)?,
            Some(_) if self.is_present() => {
                write!(f, "{}: severity {:.1}", self.effect, self.severity)?
            }
            Some(measure) => {
                write!(f, "{}: absent ({measure:.2} below {})", self.effect, self.threshold)?;
            }
        }
        for figure in &self.figures {
            let space = if figure.unit.is_empty() { "" } else { " " };
            write!(f, "; {} {:.3}{space}{}", figure.name, figure.value, figure.unit)?;
        }
        Ok(())
    }
}

/// What the pictures of a capture say.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureReport {
    /// One for each picture, in the order in which they were added.
    pub frames: Vec<FrameEvidence>,
    /// One for each effect that was looked for.
    pub findings: Vec<CaptureFinding>,
}

impl CaptureReport {
    /// The finding about an effect.
    pub fn finding(&self, effect: &str) -> Option<&CaptureFinding> {
        self.findings.iter().find(|finding| finding.effect == effect)
    }
}

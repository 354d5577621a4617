//! From a measure to a decision and a severity. The numbers were fitted on synthetic rooms of the seeds 0 to 39 (the lines
//! of holes and glass on 8200 to 8231), the
//! thresholds also on 2001 to 2005, 3000 to 3031, 5000 to 5031, 7000 to 7031 and 9100 to 9131, and tested on others, by the
//! measurement `effect-thresholds` (docs/effects.md).

use super::super::{Effect, MOST_SEVERE};

/// Less is not there, whatever the measure.
pub(super) const LEAST_SEVERITY: f64 = 0.5;

/// How a detector's measure is read.
pub(super) struct Scale {
    /// The effect is there from this measure on.
    pub(super) threshold: f64,
    /// Strength without the effect, and what each step of severity adds to it.
    pub(super) line: [f64; 2],
}

impl Scale {
    /// The severity of a strength, 0 to 5.
    pub(super) fn severity(&self, strength: f64) -> f64 {
        let severity = (strength - self.line[0]) / self.line[1];
        // NaN comes of a unit that is none.
        if severity.is_nan() { 0.0 } else { severity.clamp(0.0, MOST_SEVERE) }
    }
}

pub(super) fn scale(effect: Effect) -> Scale {
    let (threshold, line) = match effect {
        Effect::Holes => (0.0125, [-0.0015, 0.01]),
        Effect::Floaters => (0.005, [0.0018, 0.002]),
        Effect::Surface => (0.0079, [0.002, 0.0036]),
        Effect::Blur => (0.64, [0.0065, 0.0135]),
        Effect::Glass => (0.075, [-0.0324, 0.1368]),
        Effect::Light => (0.36, [0.0, 0.245]),
        Effect::Noise => (1.62, [0.0, 1.04]),
    };
    Scale { threshold, line }
}

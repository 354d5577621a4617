//! What was done to a scene, for receipts and `inspect --json`.

use super::Alignment;
use scenesplat_scene::Up;
use scenesplat_scene::frame::Matrix3;
use serde::{Deserialize, Serialize};

/// How a network reads a scene: `scale · rotation · (position − origin)`, meters, +z up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlignmentReport {
    /// The direction of the scene that is turned to +z.
    pub up: Up,
    /// All turns together, rows first.
    pub rotation: Matrix3,
    /// Meters per unit of the scene.
    pub scale: f64,
    /// What is subtracted from positions first, units of the scene.
    pub origin: [f64; 3],
    /// How sure up is, 0..=1: 1 if given, sure from 0.25 on.
    pub confidence: f64,
    /// How sure the unit is, 0..=1; `None` if nothing speaks against the meter.
    pub unit_confidence: Option<f64>,
    /// What things of known size say about the unit, if the network looked for them.
    #[serde(default)]
    pub unit_evidence: Option<String>,
    /// Whether the user said which way is up.
    pub given: bool,
    /// Whether the network decided between directions that the scene leaves open.
    pub judged: bool,
    /// What speaks for it.
    pub evidence: String,
    /// The next best directions.
    pub alternatives: Vec<Alternative>,
}

/// Another direction that was weighed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// The direction.
    pub up: Up,
    /// Its score less that of the best.
    pub score: f64,
}

/// Most alternatives that are listed.
const MOST: usize = 5;

impl Alignment {
    /// What was done, in figures.
    pub fn report(&self) -> AlignmentReport {
        let up = &self.up;
        let best = up.candidates.first().map_or(0.0, |c| c.score);
        let others = up.candidates.iter().filter(|c| c.direction != up.direction);
        AlignmentReport {
            up: self.turned_from,
            rotation: self.rotation,
            scale: self.scale,
            origin: self.origin,
            confidence: up.confidence,
            unit_confidence: match &self.sized {
                Some(sized) => Some(sized.confidence),
                None => self.unit.as_ref().map(|unit| unit.confidence),
            },
            unit_evidence: self.sized.as_ref().map(|sized| sized.evidence.clone()),
            given: up.given,
            judged: self.judged,
            evidence: up.evidence.clone(),
            alternatives: others
                .take(MOST)
                .map(|c| Alternative { up: c.direction, score: c.score - best })
                .collect(),
        }
    }
}

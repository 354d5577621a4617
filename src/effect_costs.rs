//! What the effects of a capture cost the labels of the network inside the program, and what to do about each when the
//! place can be captured again.

use crate::network::NetworkError;
use scenesplat_datasets::effects::profile::EffectProfile;
use scenesplat_datasets::effects::{Effect, MOST_SEVERE};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const FILE: &str = "assets/embedded/effect_costs.json";
const EMBEDDED: &str = include_str!("../assets/embedded/effect_costs.json");

/// Quality of labels by the severity of each effect, on rooms that no training saw.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectCosts {
    /// SHA-256 of the weights, hexadecimal.
    pub weights: String,
    /// Rooms of each curve.
    pub rooms: usize,
    /// Gaussians of each room.
    pub gaussians: usize,
    /// Severities of the points of all curves, ascending from 0.
    pub severities: Vec<f64>,
    /// f-mIoU at each of them by the name of the effect, 0..=1.
    pub f_miou: BTreeMap<String, Vec<f64>>,
}

/// An effect that was found in a scene, and what it means for its labels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoundEffect {
    /// Its name.
    pub effect: String,
    /// How strong it is, 0 to 5.
    pub severity: f64,
    /// What was measured.
    pub text: String,
    /// f-mIoU that it costs labels of the network inside the program in synthetic rooms, 0..=1; `None` for other networks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_miou_lost: Option<f64>,
    /// What to do about it.
    pub recapture: String,
}

impl EffectCosts {
    /// Those of the network inside the program.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn embedded() -> Result<Self, NetworkError> {
        serde_json::from_str(EMBEDDED).map_err(NetworkError::config(FILE))
    }

    /// f-mIoU lost at a severity, linear between the points of the curve; never below 0. `None` without a curve.
    pub fn lost(&self, effect: Effect, severity: f64) -> Option<f64> {
        let curve = self.f_miou.get(effect.name())?;
        let at = severity.clamp(0.0, MOST_SEVERE);
        let above = self.severities.iter().position(|s| *s >= at)?;
        let now = match above {
            0 => *curve.first()?,
            above => {
                let (low, high) = (self.severities[above - 1], self.severities[above]);
                let part = (at - low) / (high - low);
                curve.get(above - 1)? * (1.0 - part) + curve.get(above)? * part
            }
        };
        Some((curve.first()? - now).max(0.0))
    }
}

/// What to do about an effect when the place can be captured again.
pub fn recapture(effect: Effect) -> &'static str {
    match effect {
        Effect::Holes => {
            "capture the parts that no picture shows: along the walls, behind and under furniture"
        }
        Effect::Floaters => {
            "take more pictures, from more places, while nothing moves; or leave them out with convert --remove-floaters"
        }
        Effect::Surface => "take pictures that overlap more, from nearer; or optimise with --depth",
        Effect::Blur => "move slower or use more light; curate drops blurred frames",
        Effect::Glass => {
            "cover panes of glass and mirrors; labels of panes and of what is behind them are unsure"
        }
        Effect::Light => {
            "keep exposure, white balance and lamps as they are during the capture; optimise corrects drift"
        }
        Effect::Noise => "use more light, or a lower sensitivity",
    }
}

/// The effects that a scene shows, with what they cost where `costs` are those of its network.
pub fn found_effects(profile: &EffectProfile, costs: Option<&EffectCosts>) -> Vec<FoundEffect> {
    profile
        .present()
        .map(|evidence| FoundEffect {
            effect: evidence.effect.name().to_owned(),
            severity: evidence.severity,
            text: evidence.text.clone(),
            f_miou_lost: costs.and_then(|costs| costs.lost(evidence.effect, evidence.severity)),
            recapture: recapture(evidence.effect).to_owned(),
        })
        .collect()
}

/// One line: severity, cost, measure, what to do.
impl std::fmt::Display for FoundEffect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} of severity {:.1}", self.effect, self.severity)?;
        match self.f_miou_lost {
            None => {}
            Some(lost) if lost < 0.01 => {
                write!(f, ", which costs less than a point of f-mIoU in synthetic rooms")?;
            }
            Some(lost) => {
                write!(
                    f,
                    ", which costs about {:.0} points of f-mIoU in synthetic rooms",
                    100.0 * lost
                )?;
            }
        }
        write!(f, " ({}): {}", self.text, self.recapture)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_are_read_between_the_points() {
        let curve = |values: &[f64]| values.to_vec();
        let costs = EffectCosts {
            weights: String::new(),
            rooms: 1,
            gaussians: 1,
            severities: vec![0.0, 2.0, 5.0],
            f_miou: BTreeMap::from([
                ("holes".to_owned(), curve(&[0.8, 0.7, 0.4])),
                // Some damage helps by chance: it costs nothing.
                ("noise".to_owned(), curve(&[0.8, 0.82, 0.79])),
            ]),
        };
        for (severity, want) in
            [(0.0, 0.0), (1.0, 0.05), (2.0, 0.1), (3.0, 0.2), (5.0, 0.4), (9.0, 0.4)]
        {
            let lost = costs.lost(Effect::Holes, severity).unwrap();
            assert!((lost - want).abs() < 1e-12, "{severity}: {lost}");
        }
        assert_eq!(costs.lost(Effect::Noise, 2.0), Some(0.0));
        assert_eq!(costs.lost(Effect::Glass, 2.0), None);
    }

    #[test]
    fn the_embedded_costs_are_of_the_embedded_network() {
        let costs = EffectCosts::embedded().unwrap();
        let recognition = crate::recognition::Recognition::embedded().unwrap();
        assert_eq!(costs.weights, recognition.weights);
        for effect in Effect::ALL {
            let curve = &costs.f_miou[effect.name()];
            assert_eq!(curve.len(), costs.severities.len(), "{effect:?}");
            assert!(curve.iter().all(|v| (0.0..=1.0).contains(v)), "{effect:?}");
            assert!(!recapture(effect).is_empty());
        }
        assert_eq!((costs.severities[0], costs.severities.last()), (0.0, Some(&MOST_SEVERE)));
    }
}

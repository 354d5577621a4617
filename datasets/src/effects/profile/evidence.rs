//! What was found, in numbers and words.

use super::super::{Effect, EffectSet};
use super::thresholds::{LEAST_SEVERITY, scale};
use super::{Measured, Outcome};
use serde::ser::{SerializeMap, SerializeStruct};
use serde::{Serialize, Serializer};
use std::fmt;

/// A number that speaks for or against an effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// What it is.
    pub name: &'static str,
    /// Its value, finite.
    pub value: f64,
    /// Its unit; empty for a plain number.
    pub unit: &'static str,
}

/// What speaks for and against one effect.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectEvidence {
    /// Which effect.
    pub effect: Effect,
    /// Whether it is there.
    pub present: bool,
    /// How strong it is, 0 to 5 on the scale of [`simulate`](super::super::simulate); 0 if it is not there.
    pub severity: f64,
    /// The severity if it were there: what the evidence alone says.
    pub strength: f64,
    /// The number that decides; `None` where nothing could be measured.
    pub measure: Option<Figure>,
    /// The effect is there from this value of the measure on.
    pub threshold: f64,
    /// Numbers that go with it.
    pub more: Vec<Figure>,
    /// Where it is, if the measure says that, whether it is there or not: balls (center, radius) in units of the
    /// scene. Of holes, the gaps with what lies around them; of glass, the panes.
    pub regions: Vec<[f32; 4]>,
    /// One sentence.
    pub text: String,
}

/// What a scene says about its capture.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectProfile {
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Those that were looked at.
    pub looked_at: usize,
    /// One for each effect, in the order of [`Effect::ALL`].
    pub effects: Vec<EffectEvidence>,
}

impl Figure {
    pub(super) fn new(name: &'static str, value: f64, unit: &'static str) -> Self {
        Self { name, value: if value.is_finite() { value } else { 0.0 }, unit }
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.unit, self.value) {
            ("m", v) => write!(f, "{:.2} cm", 100.0 * v),
            ("" | "m²", v) if v.abs() >= 100.0 => write!(f, "{v:.0}{}", spaced(self.unit)),
            ("", v) if v.abs() < 0.1 && v != 0.0 => write!(f, "{:.2} %", 100.0 * v),
            (unit, v) => write!(f, "{v:.2}{}", spaced(unit)),
        }
    }
}

fn spaced(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!(" {unit}") }
}

impl EffectEvidence {
    pub(super) fn new(effect: Effect, outcome: Outcome) -> Self {
        let scale = scale(effect);
        let threshold = scale.threshold;
        let mut out = Self {
            effect,
            present: false,
            severity: 0.0,
            strength: 0.0,
            measure: None,
            threshold,
            more: Vec::new(),
            regions: Vec::new(),
            text: String::new(),
        };
        match outcome {
            Err(why) => out.text = format!("not judged: {why}"),
            Ok(Measured { measure, more, strength, regions }) => {
                out.strength = scale.severity(strength);
                out.present = measure.value >= threshold && out.strength >= LEAST_SEVERITY;
                out.severity = if out.present { out.strength } else { 0.0 };
                let off = Figure { value: threshold, ..measure };
                out.text = format!("{} {measure}, off below {off}", words(effect));
                (out.measure, out.more, out.regions) = (Some(measure), more, regions);
            }
        }
        out
    }

    /// How far the evidence is over what it takes, as a factor: the effect is there from 1 on. `None` where nothing
    /// could be measured.
    pub fn over_threshold(&self) -> Option<f64> {
        let measure = self.measure.as_ref()?.value / self.threshold;
        Some(measure.min(self.strength / LEAST_SEVERITY))
    }
}

/// What the measure of an effect is.
fn words(effect: Effect) -> &'static str {
    match effect {
        Effect::Holes => "of the walls and floors that bound the scene, gaps are",
        Effect::Floaters => "Gaussians with neither a surface nor company around them are",
        Effect::Surface => "centers lie off the plane of their neighbors by",
        Effect::Blur => "Gaussians are drawn out in common by, in sizes of theirs,",
        Effect::Glass => "of a large plane, what is see-through makes up",
        Effect::Light => "light drifts along surfaces, by",
        Effect::Noise => "noise that depends on the light as a sensor's does is",
    }
}

impl EffectProfile {
    /// What was found about an effect.
    pub fn of(&self, effect: Effect) -> &EffectEvidence {
        // One for each, in this order.
        let index = Effect::ALL.iter().position(|e| *e == effect).unwrap_or(0);
        &self.effects[index]
    }

    /// The effects that are there, with their severities.
    pub fn severities(&self) -> EffectSet {
        self.present().fold(EffectSet::default(), |set, evidence| {
            // A severity is clamped to what there is.
            set.with(evidence.effect, evidence.severity).unwrap_or(set)
        })
    }

    /// The effects that are there.
    pub fn present(&self) -> impl Iterator<Item = &EffectEvidence> {
        self.effects.iter().filter(|e| e.present)
    }
}

impl Serialize for EffectEvidence {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut out = to.serialize_struct("EffectEvidence", 7)?;
        out.serialize_field("present", &self.present)?;
        out.serialize_field("severity", &self.severity)?;
        out.serialize_field("judged", &self.measure.is_some())?;
        out.serialize_field("measure", &self.measure)?;
        out.serialize_field("threshold", &self.threshold)?;
        let all: Vec<&Figure> = self.measure.iter().chain(&self.more).collect();
        out.serialize_field("evidence", &all)?;
        out.serialize_field("text", &self.text)?;
        out.end()
    }
}

/// A map from the effects' names.
impl Serialize for EffectProfile {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut out = to.serialize_map(Some(self.effects.len()))?;
        for evidence in &self.effects {
            out.serialize_entry(evidence.effect.name(), evidence)?;
        }
        out.end()
    }
}

/// One line for each effect.
impl fmt::Display for EffectProfile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, e) in self.effects.iter().enumerate() {
            let state = match (&e.measure, e.present) {
                (None, _) => "-".to_owned(),
                (_, false) => "no".to_owned(),
                (_, true) => format!("{:.1}", e.severity),
            };
            let end = if i + 1 < self.effects.len() { "\n" } else { "" };
            write!(f, "{:<9} {state:<4} {}{end}", e.effect.name(), e.text)?;
        }
        Ok(())
    }
}

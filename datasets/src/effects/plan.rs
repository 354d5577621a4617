//! Which effects are compensated for, decided from a scene's profile: one object for all who ask.
//!
//! A plan is made once from a profile and the user's choices, printed with its evidence, and stored as JSON;
//! read back, it says the same again without a profile.

use super::profile::EffectProfile;
use super::{Effect, EffectError};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// A decision that was made before stays until its measure is so far on the other side of the threshold, as a
/// share of it: evidence that trembles by a hundredth cannot flip it twice.
pub const HYSTERESIS: f64 = 0.05;

/// What a user says about an effect.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EffectChoice {
    /// As the profile says.
    #[default]
    Auto,
    /// As if the effect were there.
    On,
    /// As if it were not.
    Off,
}

impl EffectChoice {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::On => "on",
            Self::Off => "off",
        }
    }
}

/// What a user says about each effect, as text `glass=off,floaters=on`; what is not named is `auto`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EffectChoices([EffectChoice; Effect::ALL.len()]);

impl EffectChoices {
    /// The choice about an effect.
    pub fn of(&self, effect: Effect) -> EffectChoice {
        self.0[effect as usize]
    }
}

impl FromStr for EffectChoices {
    type Err = EffectError;

    fn from_str(text: &str) -> Result<Self, EffectError> {
        let mut choices = Self::default();
        if text == "auto" {
            return Ok(choices);
        }
        let mut seen = Vec::new();
        for part in text.split(',') {
            let choice = || EffectError::Choice { part: part.to_owned() };
            let (name, value) = part.split_once('=').ok_or_else(choice)?;
            let effect = Effect::named(name)?;
            if seen.contains(&effect) {
                return Err(EffectError::Twice { name: name.to_owned() });
            }
            seen.push(effect);
            let all = [EffectChoice::Auto, EffectChoice::On, EffectChoice::Off];
            let found = all.into_iter().find(|c| c.name() == value).ok_or_else(choice)?;
            choices.0[effect as usize] = found;
        }
        Ok(choices)
    }
}

impl fmt::Display for EffectChoices {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = Effect::ALL.into_iter().filter(|e| self.of(*e) != EffectChoice::Auto);
        let parts: Vec<String> =
            named.map(|e| format!("{}={}", e.name(), self.of(e).name())).collect();
        f.write_str(if parts.is_empty() { "auto" } else { "" })?;
        f.write_str(&parts.join(","))
    }
}

/// What is done about one effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectDecision {
    /// Name of the effect.
    pub effect: String,
    /// What the user said.
    pub choice: EffectChoice,
    /// Whether it is compensated for.
    pub on: bool,
    /// How strong it is, 0 to 5; 0 where it is off, or was not measured.
    pub level: f64,
    /// The number that decided; `None` where nothing could be measured.
    pub measure: Option<f64>,
    /// The value that it was compared with.
    pub threshold: f64,
    /// In words.
    pub why: String,
}

/// What is done about the effects of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectPlan {
    /// One for each effect, in the order of [`Effect::ALL`].
    pub decisions: Vec<EffectDecision>,
}

impl EffectPlan {
    /// Decides. `before`: the plan that was made of this scene earlier, if there is one; its automatic
    /// decisions stay within [`HYSTERESIS`] of their thresholds.
    pub fn new(
        profile: &EffectProfile,
        choices: &EffectChoices,
        before: Option<&EffectPlan>,
    ) -> Self {
        let decide = |effect: Effect| {
            let (evidence, choice) = (profile.of(effect), choices.of(effect));
            let measure = evidence.measure.as_ref().map(|m| m.value);
            let was = before.and_then(|plan| plan.of(effect)).map(|decision| decision.on);
            let limit = match was {
                Some(true) => evidence.threshold * (1.0 - HYSTERESIS),
                Some(false) => evidence.threshold * (1.0 + HYSTERESIS),
                None => evidence.threshold,
            };
            let on = match choice {
                EffectChoice::On => true,
                EffectChoice::Off => false,
                EffectChoice::Auto => measure.is_some_and(|m| m >= limit),
            };
            let why = match choice {
                EffectChoice::Auto => evidence.text.clone(),
                said => format!("{} by choice; {}", said.name(), evidence.text),
            };
            EffectDecision {
                effect: effect.name().to_owned(),
                choice,
                on,
                level: if on { evidence.strength } else { 0.0 },
                measure,
                threshold: evidence.threshold,
                why,
            }
        };
        Self { decisions: Effect::ALL.map(decide).into() }
    }

    /// The decision about an effect; `None` in a stored plan that does not know it.
    pub fn of(&self, effect: Effect) -> Option<&EffectDecision> {
        self.decisions.iter().find(|d| d.effect == effect.name())
    }

    /// Whether an effect is compensated for.
    pub fn is_on(&self, effect: Effect) -> bool {
        self.of(effect).is_some_and(|d| d.on)
    }
}

/// One line for each effect.
impl fmt::Display for EffectPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, d) in self.decisions.iter().enumerate() {
            let state = if d.on { format!("on {:.1}", d.level) } else { "off".to_owned() };
            let end = if i + 1 < self.decisions.len() { "\n" } else { "" };
            write!(f, "{:<9} {state:<6} {}{end}", d.effect, d.why)?;
        }
        Ok(())
    }
}

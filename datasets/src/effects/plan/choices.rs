//! What a user says about each effect.

use super::super::set::{parts, write_parts};
use super::super::{Effect, EffectError};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

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

    /// With another choice about an effect.
    #[must_use]
    pub fn with(mut self, effect: Effect, choice: EffectChoice) -> Self {
        self.0[effect as usize] = choice;
        self
    }
}

impl FromStr for EffectChoices {
    type Err = EffectError;

    fn from_str(text: &str) -> Result<Self, EffectError> {
        let mut choices = Self::default();
        if text == "auto" {
            return Ok(choices);
        }
        for (effect, value) in parts(text, |part| EffectError::Choice { part })? {
            let all = [EffectChoice::Auto, EffectChoice::On, EffectChoice::Off];
            let found = all.into_iter().find(|c| c.name() == value);
            let part = || format!("{}={value}", effect.name());
            choices.0[effect as usize] =
                found.ok_or_else(|| EffectError::Choice { part: part() })?;
        }
        Ok(choices)
    }
}

impl fmt::Display for EffectChoices {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = Effect::ALL.into_iter().filter(|e| self.of(*e) != EffectChoice::Auto);
        write_parts(f, "auto", named.map(|e| (e, self.of(e).name().to_owned())))
    }
}

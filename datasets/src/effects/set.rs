//! Which effects, and how strong.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Severity that no effect exceeds.
pub const MOST_SEVERE: f64 = 5.0;

/// What a capture does to a scene. The number is part of the random numbers of an effect: it never
/// changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Effect {
    /// Parts that no picture saw: missing.
    Holes = 0,
    /// Gaussians in the air that explain nothing.
    Floaters = 1,
    /// Surfaces that were not measured smoothly.
    Surface = 2,
    /// Pictures taken in motion: Gaussians drawn out and colors mixed.
    Blur = 3,
    /// Exposure and white balance that drift over the scene.
    Light = 4,
    /// Noise of the sensor.
    Noise = 5,
    /// Panes that let light through and reflect some.
    Glass = 6,
}

impl Effect {
    /// All of them, in the order in which they are applied: geometry, motion, glass, light, sensor.
    pub const ALL: [Self; 7] = [
        Self::Holes,
        Self::Floaters,
        Self::Surface,
        Self::Blur,
        Self::Glass,
        Self::Light,
        Self::Noise,
    ];

    /// Name in texts.
    pub fn name(self) -> &'static str {
        match self {
            Self::Holes => "holes",
            Self::Floaters => "floaters",
            Self::Surface => "surface",
            Self::Blur => "blur",
            Self::Light => "light",
            Self::Noise => "noise",
            Self::Glass => "glass",
        }
    }

    /// The effect of that name.
    ///
    /// # Errors
    /// If there is none; it names those that there are.
    pub fn named(name: &str) -> Result<Self, EffectError> {
        let found = Self::ALL.into_iter().find(|effect| effect.name() == name);
        found.ok_or_else(|| EffectError::Name { name: name.to_owned() })
    }
}

/// Effects with their severities, as text `holes=3,blur=1.5`; `none` is the empty set.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct EffectSet {
    pub(super) severity: [f64; Effect::ALL.len()],
}

/// A text that is no set of effects.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EffectError {
    /// Not `NAME=SEVERITY`.
    #[error("{part:?}: NAME=SEVERITY is expected, such as holes=3")]
    Form {
        /// The part of the text.
        part: String,
    },
    /// A name that is none.
    #[error("{name:?} is no effect; there are {}", Effect::ALL.map(Effect::name).join(", "))]
    Name {
        /// The name.
        name: String,
    },
    /// A name that was there before.
    #[error("{name} is given twice")]
    Twice {
        /// The name.
        name: String,
    },
    /// Not `NAME=CHOICE`.
    #[error("{part:?}: NAME=on, off or auto is expected, such as floaters=auto")]
    Choice {
        /// The part of the text.
        part: String,
    },
    /// Something is wanted about an effect that nothing acts on.
    #[error("{name}=on: nothing here acts on {name}; acted on here: {acted_on}")]
    NothingActs {
        /// The effect.
        name: String,
        /// The effects that something acts on.
        acted_on: String,
    },
    /// A stored plan is that of another scene.
    #[error("the plan was made of a scene of {planned} Gaussians, this one has {got}")]
    OtherScene {
        /// Gaussians of the scene that it was made of.
        planned: usize,
        /// Gaussians of this one.
        got: usize,
    },
    /// A stored plan without decisions about effects.
    #[error("the plan decides nothing about effects")]
    NoDecisions,
    /// A severity that is none.
    #[error("{name}={value}: a severity of 0 to {MOST_SEVERE} is expected")]
    Severity {
        /// The name.
        name: String,
        /// What was given.
        value: String,
    },
}

impl EffectSet {
    /// How strong an effect is, 0 to 5; 0 is without it.
    pub fn severity(&self, effect: Effect) -> f64 {
        self.severity[effect as usize]
    }

    /// With an effect of that severity.
    ///
    /// # Errors
    /// If the severity is not in 0..=5.
    pub fn with(mut self, effect: Effect, severity: f64) -> Result<Self, EffectError> {
        if !(0.0..=MOST_SEVERE).contains(&severity) {
            let (name, value) = (effect.name().to_owned(), severity.to_string());
            return Err(EffectError::Severity { name, value });
        }
        self.severity[effect as usize] = severity;
        Ok(self)
    }

    /// With an effect of the severity that a text gives.
    pub(super) fn parsed(self, effect: Effect, text: &str) -> Result<Self, EffectError> {
        let (name, value) = (effect.name().to_owned(), text.to_owned());
        self.with(effect, text.parse().map_err(|_| EffectError::Severity { name, value })?)
    }

    /// Those that there are, in the order in which they are applied.
    pub fn present(&self) -> impl Iterator<Item = (Effect, f64)> {
        let all = Effect::ALL.map(|effect| (effect, self.severity(effect)));
        all.into_iter().filter(|(_, severity)| *severity > 0.0)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.present().next().is_none()
    }
}

impl fmt::Display for EffectSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_parts(f, "none", self.present().map(|(effect, s)| (effect, s.to_string())))
    }
}

impl FromStr for EffectSet {
    type Err = EffectError;

    fn from_str(text: &str) -> Result<Self, EffectError> {
        let mut parts = match text {
            "none" => Vec::new(),
            _ => parts(text, |part| EffectError::Form { part })?,
        }
        .into_iter();
        parts.try_fold(Self::default(), |set, (effect, value)| set.parsed(effect, value))
    }
}

/// The parts `NAME=VALUE` of a text, no effect twice; `form` is the error of what is none.
pub(super) fn parts(
    text: &str,
    form: impl Fn(String) -> EffectError,
) -> Result<Vec<(Effect, &str)>, EffectError> {
    let mut out: Vec<(Effect, &str)> = Vec::new();
    for part in text.split(',') {
        let (name, value) = part.split_once('=').ok_or_else(|| form(part.to_owned()))?;
        let effect = Effect::named(name)?;
        if out.iter().any(|(known, _)| *known == effect) {
            return Err(EffectError::Twice { name: name.to_owned() });
        }
        out.push((effect, value));
    }
    Ok(out)
}

/// Writes such parts, or a word if there are none.
pub(super) fn write_parts(
    f: &mut fmt::Formatter<'_>,
    none: &str,
    parts: impl Iterator<Item = (Effect, String)>,
) -> fmt::Result {
    let parts: Vec<String> =
        parts.map(|(effect, value)| format!("{}={value}", effect.name())).collect();
    f.write_str(if parts.is_empty() { none } else { "" })?;
    f.write_str(&parts.join(","))
}

/// In files these are their texts.
macro_rules! is_text {
    ($name:ident) => {
        impl TryFrom<String> for $name {
            type Error = EffectError;

            fn try_from(text: String) -> Result<Self, EffectError> {
                text.parse()
            }
        }

        impl From<$name> for String {
            fn from(value: $name) -> Self {
                value.to_string()
            }
        }
    };
}
pub(super) use is_text;

is_text!(EffectSet);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_return_and_wrong_ones_are_named() {
        let set: EffectSet = "noise=5,holes=2.5,light=0".parse().unwrap();
        assert_eq!(set.to_string(), "holes=2.5,noise=5");
        assert_eq!(set.to_string().parse(), Ok(set));
        assert_eq!(set.severity(Effect::Holes), 2.5);
        assert!("none".parse::<EffectSet>().unwrap().is_empty());
        assert_eq!(EffectSet::default().to_string(), "none");
        for (text, part) in [
            ("", "NAME=SEVERITY"),
            ("holes", "NAME=SEVERITY"),
            ("hole=2", "there are holes, floaters, surface"),
            ("holes=1,holes=2", "holes is given twice"),
            ("blur=6", "blur=6: a severity of 0 to 5"),
            ("blur=-1", "0 to 5"),
            ("blur=NaN", "0 to 5"),
            ("blur=much", "blur=much"),
            ("blur=1,", "NAME=SEVERITY"),
        ] {
            let error = text.parse::<EffectSet>().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}

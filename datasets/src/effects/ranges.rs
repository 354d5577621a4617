//! Effects whose severities are drawn.

use super::set::{is_text, parts, write_parts};
use super::{Effect, EffectError, EffectSet};
use crate::rng::{SampleRng, between};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Effects with a severity or a range of severities each, as text `holes=2,floaters=0.5..3`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct EffectRanges {
    low: EffectSet,
    high: EffectSet,
}

impl EffectRanges {
    /// Least and greatest severity of an effect; 0 and 0 is without it.
    pub fn range(&self, effect: Effect) -> [f64; 2] {
        [self.low.severity(effect), self.high.severity(effect)]
    }

    /// Whether there is no effect.
    pub fn is_empty(&self) -> bool {
        self.high.is_empty()
    }

    /// One severity out of each range. Every effect has a number of its own, so that one more effect
    /// changes no severity of another.
    pub(crate) fn draw(&self, rng: &mut SampleRng) -> EffectSet {
        Effect::ALL.into_iter().fold(EffectSet::default(), |set, effect| {
            let severity = between(rng, self.range(effect));
            // Between two severities there are only severities.
            set.with(effect, severity).unwrap_or(set)
        })
    }
}

impl From<EffectSet> for EffectRanges {
    fn from(set: EffectSet) -> Self {
        Self { low: set, high: set }
    }
}

impl fmt::Display for EffectRanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = |(effect, high): (Effect, f64)| match self.low.severity(effect) {
            low if low == high => (effect, high.to_string()),
            low => (effect, format!("{low}..{high}")),
        };
        write_parts(f, "none", self.high.present().map(part))
    }
}

impl FromStr for EffectRanges {
    type Err = EffectError;

    fn from_str(text: &str) -> Result<Self, EffectError> {
        let mut ranges = Self::default();
        if text == "none" {
            return Ok(ranges);
        }
        for (effect, value) in parts(text, |part| EffectError::Form { part })? {
            let (low, high) = value.split_once("..").unwrap_or((value, value));
            ranges.low = ranges.low.parsed(effect, low)?;
            ranges.high = ranges.high.parsed(effect, high)?;
            let [low, high] = ranges.range(effect);
            if low > high {
                let (name, value) = (effect.name().to_owned(), format!("{low}..{high}"));
                return Err(EffectError::Severity { name, value });
            }
        }
        Ok(ranges)
    }
}

is_text!(EffectRanges);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_rng;

    #[test]
    fn texts_return_and_wrong_ones_are_named() {
        let ranges: EffectRanges = "noise=1..4,holes=2.5,light=0..0".parse().unwrap();
        assert_eq!(ranges.to_string(), "holes=2.5,noise=1..4");
        assert_eq!(ranges.to_string().parse(), Ok(ranges));
        assert_eq!(ranges.range(Effect::Noise), [1.0, 4.0]);
        assert_eq!(ranges.range(Effect::Holes), [2.5, 2.5]);
        assert!("none".parse::<EffectRanges>().unwrap().is_empty() && !ranges.is_empty());
        let json = serde_json::to_string(&ranges).unwrap();
        assert_eq!(serde_json::from_str::<EffectRanges>(&json).unwrap(), ranges);
        for (text, part) in [
            ("hole=1..2", "\"hole\" is no effect; there are holes"),
            ("holes=3..1", "holes=3..1: a severity of 0 to 5"),
            ("holes=1..6", "holes=6"),
            ("holes=1..", "holes="),
            ("holes=..2", "holes="),
            ("holes=1...2", "holes="),
            ("holes=1..2,holes=3", "holes is given twice"),
            ("holes", "NAME=SEVERITY"),
        ] {
            let error = text.parse::<EffectRanges>().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn severities_are_drawn_evenly_and_each_by_itself() {
        let ranges: EffectRanges = "holes=1..3,blur=2".parse().unwrap();
        let more: EffectRanges = "holes=1..3,blur=2,floaters=0..5".parse().unwrap();
        let mut sum = 0.0;
        for i in 0..400 {
            let (a, b) = (sample_rng(1, 0, i), sample_rng(1, 0, i));
            let (a, b) = (ranges.draw(&mut { a }), more.draw(&mut { b }));
            let holes = a.severity(Effect::Holes);
            assert!((1.0..3.0).contains(&holes) && a.severity(Effect::Blur) == 2.0);
            assert_eq!((holes, a.severity(Effect::Floaters)), (b.severity(Effect::Holes), 0.0));
            sum += holes;
        }
        // Five standard errors of 400 even numbers of 1 to 3.
        assert!((sum / 400.0 - 2.0).abs() < 5.0 * 0.577 / 20.0, "{}", sum / 400.0);
    }
}

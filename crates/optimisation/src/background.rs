//! What is behind everything.

use crate::error::{OptimiseError, within};
use crate::random::{Counter, Purpose};
use serde::{Deserialize, Serialize};

/// What is behind the Gaussians, and behind pictures where they are transparent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// Black behind opaque pictures; behind a transparent one another color at each step, so that no fog can look like
    /// its background. Scores are on black.
    Auto,
    /// Another color at each step behind all pictures. Scores are on black.
    Random,
    /// This color, 0 to 1, in steps and scores.
    Fixed([f32; 3]),
}

impl Background {
    /// Checks that a color is one.
    pub(crate) fn check(self) -> Result<(), OptimiseError> {
        let Self::Fixed(color) = self else { return Ok(()) };
        let range = "from 0 to 1";
        color
            .iter()
            .try_for_each(|v| within("background", f64::from(*v), (0.0..=1.0).contains(v), range))
    }

    /// The color of scores.
    pub fn shown(self) -> [f32; 3] {
        match self {
            Self::Fixed(color) => color,
            Self::Auto | Self::Random => [0.0; 3],
        }
    }

    /// The color of a step, which depends on the seed and the step alone.
    pub fn at(self, seed: u64, step: u64, transparent: bool) -> [f32; 3] {
        match self {
            Self::Auto if !transparent => [0.0; 3],
            Self::Fixed(color) => color,
            Self::Auto | Self::Random => {
                let [r, g, b, _] = Counter::new(seed, Purpose::Background, step).units(0);
                [r as f32, g as f32, b as f32]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;

    #[test]
    fn colors_of_steps() {
        let auto = Background::Auto;
        assert_eq!((auto.at(1, 7, false), auto.shown()), ([0.0; 3], [0.0; 3]));
        let color = auto.at(1, 7, true);
        assert!(color.iter().all(|v| (0.0..1.0).contains(v)) && color[0] != color[1]);
        assert_eq!(color, Background::Random.at(1, 7, false));
        assert_ne!(color, auto.at(1, 8, true));
        let white = Background::Fixed([1.0; 3]);
        assert_eq!((white.at(1, 7, true), white.shown()), ([1.0; 3], [1.0; 3]));
        white.check().unwrap();
        let error = Background::Fixed([0.0, 1.5, 0.0]).check().unwrap_err().to_string();
        assert!(error.contains("background is 1.5"), "{error}");
    }

    #[test]
    fn a_random_color_is_that_of_seed_and_step() {
        let [r, g, b, _] = Counter::new(4, Purpose::Background, 12).units(0);
        for found in [Background::Random.at(4, 12, true), Background::Auto.at(4, 12, true)] {
            assert_eq!(found, [r as f32, g as f32, b as f32]);
        }
        let fixed = Background::Fixed([0.1, 0.2, 0.3]);
        for transparent in [false, true] {
            assert_eq!(fixed.at(1, 2, transparent), [0.1, 0.2, 0.3]);
        }
        assert_eq!((fixed.shown(), Background::Random.shown()), ([0.1, 0.2, 0.3], [0.0; 3]));
        Background::Random.check().unwrap();
        for bad in [[-0.1, 0.0, 0.0], [0.0, f32::NAN, 0.0], [0.0, 0.0, 1.1]] {
            assert!(Background::Fixed(bad).check().is_err(), "{bad:?}");
        }
        let text = serde_json::to_string(&[Background::Auto, Background::Random, fixed]).unwrap();
        assert_eq!(text, "[\"auto\",\"random\",{\"fixed\":[0.1,0.2,0.3]}]");
    }
}

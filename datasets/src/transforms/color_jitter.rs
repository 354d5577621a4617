//! [`ColorJitter`], [`RandomGrayscale`] and [`ColorSolarize`]

use super::chromatic::clip;
use crate::error::{check_probability, require};
use crate::rng::{between, happens, permutation};
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Changes brightness, contrast, saturation and hue of the whole sample, in a random order, each with
    /// `probability`; results are clipped to 0..=255.
    ///
    /// Brightness multiplies by a factor; contrast blends with the mean gray of the sample, saturation
    /// with the gray of each Gaussian; hue turns by a part of the circle.
    ///
    /// # Source
    /// `RandomColorJitter` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1, after torchvision's
    /// `ColorJitter`. There colors are rounded between steps.
    pub struct ColorJitter {
        /// The factor lies within so much of 1, at least 0.
        pub brightness: f64 = 0.4,
        /// The factor lies within so much of 1, at least 0.
        pub contrast: f64 = 0.4,
        /// The factor lies within so much of 1, at least 0.
        pub saturation: f64 = 0.2,
        /// Largest turn, as part of a circle, in 0..=0.5.
        pub hue: f64 = 0.1,
        /// How often each of the four happens.
        pub probability: f64 = 0.8,
    }
}

/// Luma of a color, in its range.
fn gray(color: [f32; 3]) -> f64 {
    let [r, g, b] = color.map(f64::from);
    0.2989 * r + 0.587 * g + 0.114 * b
}

/// `factor · color + (1 − factor) · other`, clipped.
fn blend(color: [f32; 3], other: f64, factor: f64) -> [f32; 3] {
    color.map(|c| clip(factor * f64::from(c) + (1.0 - factor) * other))
}

/// Turns the hue by a part of the circle; value and saturation stay.
fn turn_hue(color: [f32; 3], part: f64) -> [f32; 3] {
    let [r, g, b] = color.map(f64::from);
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    let range = high - low;
    // NaN has no hue either.
    if range.is_nan() || range <= 0.0 {
        return color;
    }
    let sixths = if high == r {
        (g - b) / range
    } else if high == g {
        2.0 + (b - r) / range
    } else {
        4.0 + (r - g) / range
    };
    let sixths = (sixths + 6.0 * part).rem_euclid(6.0);
    // How far each channel is below the highest, by its distance on the circle.
    let channel = |center: f64| {
        let away = ((sixths - center + 3.0).rem_euclid(6.0) - 3.0).abs();
        clip(high - range * (away - 1.0).clamp(0.0, 1.0))
    };
    [channel(0.0), channel(2.0), channel(4.0)]
}

impl Transform for ColorJitter {
    fn check(&self) -> Result<(), DataError> {
        check_probability("color_jitter.probability", self.probability)?;
        for (field, value) in [
            ("color_jitter.brightness", self.brightness),
            ("color_jitter.contrast", self.contrast),
            ("color_jitter.saturation", self.saturation),
        ] {
            let ok = value.is_finite() && value >= 0.0;
            require(ok, field, value, "a finite number of 0 or more")?;
        }
        let ok = (0.0..=0.5).contains(&self.hue);
        require(ok, "color_jitter.hue", self.hue, "a part of a circle in 0..=0.5")
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        for change in permutation(rng, 4) {
            // Both numbers are drawn in any case: what happens to one sample changes no other draw.
            let (on, at) = (happens(rng, self.probability), between(rng, [-1.0, 1.0]));
            if !on {
                continue;
            }
            let factor = |strength: f64| (1.0 + strength * at).max(0.0);
            let mean = match change {
                1 if !sample.is_empty() => {
                    sample.color.iter().map(|c| gray(*c)).sum::<f64>() / sample.len() as f64
                }
                _ => 0.0,
            };
            for color in &mut sample.color {
                *color = match change {
                    0 => blend(*color, 0.0, factor(self.brightness)),
                    1 => blend(*color, mean, factor(self.contrast)),
                    2 => blend(*color, gray(*color), factor(self.saturation)),
                    _ => turn_hue(*color, self.hue * at),
                };
            }
        }
        Ok(())
    }
}

scenesplat_kernels::settings! {
    /// With `probability`, replaces every color by its gray.
    ///
    /// # Source
    /// `RandomColorGrayScale`, as above.
    pub struct RandomGrayscale {
        /// How often it happens.
        pub probability: f64 = 0.2,
    }
}

impl Transform for RandomGrayscale {
    fn check(&self) -> Result<(), DataError> {
        check_probability("random_grayscale.probability", self.probability)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if happens(rng, self.probability) {
            sample.color.iter_mut().for_each(|c| *c = [gray(*c) as f32; 3]);
        }
        Ok(())
    }
}

scenesplat_kernels::settings! {
    /// With `probability`, turns every color value of `threshold` or more into its negative, `255 − c`.
    ///
    /// # Source
    /// `RandomColorSolarize`, as above, which computes this and does not write it back: it has no effect.
    pub struct ColorSolarize {
        /// How often it happens.
        pub probability: f64 = 0.2,
        /// The least value that is turned, 0..=255.
        pub threshold: f64 = 128.0,
    }
}

impl Transform for ColorSolarize {
    fn check(&self) -> Result<(), DataError> {
        check_probability("color_solarize.probability", self.probability)?;
        let ok = (0.0..=255.0).contains(&self.threshold);
        require(ok, "color_solarize.threshold", self.threshold, "a color in 0..=255")
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if happens(rng, self.probability) {
            for value in sample.color.iter_mut().flatten() {
                if f64::from(*value) >= self.threshold {
                    *value = 255.0 - *value;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, room};

    fn near(a: [f32; 3], b: [f32; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3)
    }

    #[test]
    fn hues_turn_around_the_circle() {
        for (color, part, want) in [
            ([200.0, 50.0, 50.0], 1.0 / 3.0, [50.0, 200.0, 50.0]),
            ([200.0, 50.0, 50.0], -1.0 / 3.0, [50.0, 50.0, 200.0]),
            ([200.0, 50.0, 50.0], 1.0 / 6.0, [200.0, 200.0, 50.0]),
            ([10.0, 20.0, 30.0], 0.5, [30.0, 20.0, 10.0]),
            ([80.0, 80.0, 80.0], 0.3, [80.0, 80.0, 80.0]),
        ] {
            let got = turn_hue(color, part);
            assert!(near(got, want), "{color:?} by {part}: {got:?}, not {want:?}");
            assert!(near(turn_hue(got, -part), color));
        }
    }

    #[test]
    fn each_change_by_hand() {
        let only = |brightness, contrast, saturation| ColorJitter {
            brightness,
            contrast,
            saturation,
            hue: 0.0,
            probability: 1.0,
        };
        let sample = at(&[[0.0; 3]; 2]);
        // All colors are 10, 20, 30: a common factor, the mean gray, the own gray.
        let g = 0.2989 * 10.0 + 0.587 * 20.0 + 0.114 * 30.0_f32;
        for seed in 0..20 {
            let bright = applied(&only(0.4, 0.0, 0.0), &sample, seed).color[0];
            let factor = bright[0] / 10.0;
            assert!(
                (0.6..=1.4).contains(&factor)
                    && near(bright, [10.0, 20.0, 30.0].map(|c| c * factor))
            );
            for color in [only(0.0, 0.4, 0.0), only(0.0, 0.0, 0.4)]
                .map(|j| applied(&j, &sample, seed).color[0])
            {
                let f = (color[0] - g) / (10.0 - g);
                assert!((0.6..=1.4).contains(&f), "{color:?}");
                assert!(near(color, [10.0, 20.0, 30.0].map(|c| g + f * (c - g))), "{color:?}");
            }
        }
        let gray = applied(&RandomGrayscale { probability: 1.0 }, &sample, 0).color[0];
        assert!(near(gray, [g; 3]));
        let solarize = ColorSolarize { probability: 1.0, threshold: 20.0 };
        assert_eq!(applied(&solarize, &sample, 0).color[0], [10.0, 235.0, 225.0]);
    }

    #[test]
    fn the_same_seed_and_no_change() {
        let sample = room(500);
        let jitter = ColorJitter::default();
        assert_eq!(applied(&jitter, &sample, 3), applied(&jitter, &sample, 3));
        assert_ne!(applied(&jitter, &sample, 3), applied(&jitter, &sample, 4));
        let never = ColorJitter { probability: 0.0, ..jitter };
        assert_eq!(applied(&never, &sample, 3), sample);
        for seed in 0..10 {
            let changed = applied(&ColorJitter::default(), &sample, seed);
            assert!(changed.color.iter().flatten().all(|c| (0.0..=255.0).contains(c)));
        }
    }
}

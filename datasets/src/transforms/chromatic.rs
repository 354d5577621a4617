//! [`ChromaticAutoContrast`], [`ChromaticTranslation`] and [`ChromaticJitter`]

use crate::error::{check_positive, check_probability};
use crate::rng::{between, happens, normals, unit};
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// With `probability`, stretches each color channel to 0..255 and blends the result with the old
    /// colors: `(1 − b)·c + b·(c − low)·255/(high − low)`, `b` uniform in 0..1.
    ///
    /// # Source
    /// `ChromaticAutoContrast` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: a
    /// channel that is the same everywhere stays (there, it is divided by zero).
    pub struct ChromaticAutoContrast {
        /// How often it happens.
        pub probability: f64 = 0.2,
    }
}

impl Transform for ChromaticAutoContrast {
    fn check(&self) -> Result<(), DataError> {
        check_probability("chromatic_auto_contrast.probability", self.probability)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if !happens(rng, self.probability) {
            return Ok(());
        }
        let blend = unit(rng);
        for channel in 0..3 {
            let values = sample.color.iter().map(|c| c[channel]).filter(|v| v.is_finite());
            let (low, high) =
                values.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let (low, high) = (f64::from(low), f64::from(high));
            if low >= high {
                continue;
            }
            let stretch = 255.0 / (high - low);
            for color in &mut sample.color {
                let old = f64::from(color[channel]);
                color[channel] = ((1.0 - blend) * old + blend * (old - low) * stretch) as f32;
            }
        }
        Ok(())
    }
}

scenesplat_kernels::settings! {
    /// With `probability`, adds one uniform offset to each color channel; the result is clipped to
    /// 0..=255.
    ///
    /// # Source
    /// `ChromaticTranslation` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1.
    pub struct ChromaticTranslation {
        /// How often it happens.
        pub probability: f64 = 0.95,
        /// Largest offset, as part of 255.
        pub ratio: f64 = 0.05,
    }
}

impl Transform for ChromaticTranslation {
    fn check(&self) -> Result<(), DataError> {
        check_probability("chromatic_translation.probability", self.probability)?;
        check_positive("chromatic_translation.ratio", self.ratio)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if !happens(rng, self.probability) {
            return Ok(());
        }
        let largest = 255.0 * self.ratio;
        let offset: [f64; 3] = std::array::from_fn(|_| between(rng, [-largest, largest]));
        for color in &mut sample.color {
            *color = std::array::from_fn(|c| clip(f64::from(color[c]) + offset[c]));
        }
        Ok(())
    }
}

scenesplat_kernels::settings! {
    /// With `probability`, adds a normal number to every color value; the result is clipped to 0..=255.
    ///
    /// # Source
    /// `ChromaticJitter` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1.
    pub struct ChromaticJitter {
        /// How often it happens.
        pub probability: f64 = 0.95,
        /// Standard deviation, as part of 255.
        pub std: f64 = 0.05,
    }
}

impl Transform for ChromaticJitter {
    fn check(&self) -> Result<(), DataError> {
        check_probability("chromatic_jitter.probability", self.probability)?;
        check_positive("chromatic_jitter.std", self.std)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if !happens(rng, self.probability) {
            return Ok(());
        }
        let values = sample.color.as_flattened_mut();
        normals(rng, values.len(), |i, x| {
            values[i] = clip(f64::from(values[i]) + 255.0 * self.std * x);
        });
        Ok(())
    }
}

/// Into 0..=255; NaN stays, so that it is found.
pub(super) fn clip(value: f64) -> f32 {
    value.clamp(0.0, 255.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at};

    fn gray(values: &[f32]) -> Sample {
        let mut sample = at(&vec![[0.0; 3]; values.len()]);
        sample.color = values.iter().map(|&v| [v, v / 2.0, 100.0]).collect();
        sample
    }

    #[test]
    fn contrast_blends_between_old_and_stretched() {
        let sample = gray(&[50.0, 100.0, 150.0]);
        let always = ChromaticAutoContrast { probability: 1.0 };
        for seed in 0..20 {
            let color = applied(&always, &sample, seed).color;
            // From the middle, which stays between 100 and 127.5, follows the blend.
            let b = (color[1][0] - 100.0) / 27.5;
            assert!((0.0..=1.0).contains(&b));
            assert!((color[0][0] - 50.0 * (1.0 - b)).abs() < 1e-3);
            assert!((color[2][0] - (150.0 + 105.0 * b)).abs() < 1e-3);
            assert!(color.iter().all(|c| c[2] == 100.0), "a constant channel stays");
        }
        assert_eq!(applied(&always, &gray(&[70.0]), 1).color, gray(&[70.0]).color);
    }

    #[test]
    fn translation_moves_all_alike() {
        let sample = gray(&[0.0, 100.0, 255.0]);
        let always = ChromaticTranslation { probability: 1.0, ..<_>::default() };
        let mut offsets = Vec::new();
        for seed in 0..200 {
            let color = applied(&always, &sample, seed).color;
            let offset = color[1][0] - 100.0;
            assert!(offset.abs() <= 12.75);
            assert!((color[0][0] - offset.max(0.0)).abs() < 1e-4);
            assert!((color[2][0] - (255.0 + offset).min(255.0)).abs() < 1e-4);
            offsets.push(offset);
        }
        assert!(offsets.iter().any(|&o| o < -10.0) && offsets.iter().any(|&o| o > 10.0));
    }

    #[test]
    fn jitter_has_its_deviation_and_stays_in_range() {
        let always = ChromaticJitter { probability: 1.0, ..<_>::default() };
        let color = applied(&always, &gray(&vec![128.0; 20_000]), 5).color;
        let variance = color.iter().map(|c| f64::from(c[0] - 128.0).powi(2)).sum::<f64>() / 2e4;
        assert!((variance.sqrt() / 12.75 - 1.0).abs() < 0.03, "{variance}");
        let color = applied(&always, &gray(&vec![0.0; 1000]), 5).color;
        assert!(color.iter().flatten().all(|c| (0.0..=255.0).contains(c)));
        let bad = gray(&[f32::NAN, 1.0]);
        assert!(applied(&always, &bad, 5).color[0][0].is_nan());
    }
}

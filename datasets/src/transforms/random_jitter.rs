//! [`RandomJitter`]

use crate::error::check_positive;
use crate::rng::normals;
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Moves every center by independent normal numbers, cut at `clip`. The Gaussians move as they are,
    /// so sizes and orientations stay; labeled points, which are no Gaussians, stay too.
    ///
    /// # Source
    /// `RandomJitter` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1.
    pub struct RandomJitter {
        /// Standard deviation along each axis, meters.
        pub sigma: f64 = 0.005,
        /// Largest movement along each axis, meters.
        pub clip: f64 = 0.01,
    }
}

impl Transform for RandomJitter {
    fn check(&self) -> Result<(), DataError> {
        check_positive("random_jitter.sigma", self.sigma)?;
        check_positive("random_jitter.clip", self.clip)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        let values = sample.coord.as_flattened_mut();
        normals(rng, values.len(), |i, x| {
            let moved = f64::from(values[i]) + (self.sigma * x).clamp(-self.clip, self.clip);
            values[i] = moved as f32;
        });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at};

    #[test]
    fn centres_move_by_a_cut_normal_number() {
        let sample = at(&vec![[0.0; 3]; 20_000]);
        let moved = applied(&RandomJitter::default(), &sample, 4);
        let values: Vec<f64> = moved.coord.iter().flatten().map(|&v| f64::from(v)).collect();
        assert!(values.iter().all(|v| v.abs() <= 0.010_000_001));
        let n = values.len() as f64;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / n;
        let expected = 0.005 * 0.005 * cut_variance(2.0);
        assert!((variance / expected - 1.0).abs() < 0.03, "{variance} {expected}");
        assert!(values.iter().sum::<f64>().abs() / n < 5.0 * 0.005 / n.sqrt());
        let at_limit = values.iter().filter(|v| v.abs() > 0.009_999_9).count() as f64 / n;
        assert!((at_limit - 0.0455).abs() < 0.005, "{at_limit}");
        assert_eq!((moved.quat, moved.scale), (sample.quat, sample.scale));
    }

    /// E[min(x², c²)] of a standard normal x, by the midpoint rule.
    fn cut_variance(c: f64) -> f64 {
        let h = 1e-3;
        (0..16_000)
            .map(|i| {
                let x = -8.0 + (f64::from(i) + 0.5) * h;
                h * (-x * x / 2.0).exp() / (2.0 * std::f64::consts::PI).sqrt() * (x * x).min(c * c)
            })
            .sum()
    }
}

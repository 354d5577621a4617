//! [`RandomScale`]

use crate::error::{check_positive, check_range};
use crate::rng::between;
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Multiplies positions, sizes and labeled points by one uniform factor.
    ///
    /// # Source
    /// `RandomScale` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1, as configured there (one
    /// factor for all axes).
    pub struct RandomScale {
        /// Lowest and highest factor.
        pub factor: [f64; 2] = [0.9, 1.1],
    }
}

impl Transform for RandomScale {
    fn check(&self) -> Result<(), DataError> {
        check_range("random_scale.factor", self.factor)?;
        check_positive("random_scale.factor", self.factor[0])
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        let factor = between(rng, self.factor);
        let grow = |values: &mut [f32; 3]| *values = values.map(|v| (f64::from(v) * factor) as f32);
        sample.places_mut().for_each(grow);
        sample.scale.iter_mut().for_each(grow);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at};

    #[test]
    fn positions_and_sizes_grow_alike() {
        let sample = at(&[[2.0, 4.0, -6.0], [1.0, 1.0, 1.0]]);
        let mut factors = Vec::new();
        for seed in 0..100 {
            let scaled = applied(&RandomScale::default(), &sample, seed);
            let factor = scaled.coord[0][0] / 2.0;
            assert!((0.9..=1.1).contains(&factor));
            for (a, b) in scaled.coord.iter().flatten().zip(sample.coord.iter().flatten()) {
                assert!((a / b - factor).abs() < 1e-6);
            }
            for (a, b) in scaled.scale.iter().flatten().zip(sample.scale.iter().flatten()) {
                assert!((a / b - factor).abs() < 1e-6);
            }
            assert_eq!(scaled.quat, sample.quat);
            factors.push(factor);
        }
        assert!(factors.iter().any(|&f| f < 0.93) && factors.iter().any(|&f| f > 1.07));
    }
}

//! [`RatioCrop`]

use super::sphere_crop::nearest_rows;
use crate::error::{check_shares, require};
use crate::rng::{below, between};
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Keeps the Gaussians nearest to a random one: a share of `point_max`, drawn evenly between two
    /// bounds, and never more than there are.
    ///
    /// # Source
    /// `SphereCropRandomMaxPoints` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: the
    /// rows kept stay in order, and a share that comes to none keeps one; the share is of the Gaussians
    /// there are where these are fewer than `point_max` (there, small scenes are not cropped at all).
    pub struct RatioCrop {
        /// Lowest and highest share, in 0..=1.
        pub ratio: [f64; 2] = [0.4, 1.0],
        /// What it is a share of, where there are as many.
        pub point_max: usize = 307_200,
    }
}

impl RatioCrop {
    /// The rows around `center`, ascending.
    pub(super) fn rows(&self, sample: &Sample, center: [f32; 3], rng: &mut SampleRng) -> Vec<u32> {
        let most = sample.len().min(self.point_max);
        let count = (between(rng, self.ratio) * most as f64) as usize;
        nearest_rows(&sample.coord, center, count.max(1))
    }
}

impl Transform for RatioCrop {
    fn check(&self) -> Result<(), DataError> {
        check_shares("ratio_crop.ratio", self.ratio)?;
        require(self.point_max > 0, "ratio_crop.point_max", 0, "a number of 1 or more")
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if sample.is_empty() {
            return Ok(());
        }
        let center = sample.coord[below(rng, sample.len() as u32) as usize];
        let rows = self.rows(sample, center, rng);
        sample.select_rows(&rows);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, room};

    #[test]
    fn the_share_lies_between_its_bounds() {
        let sample = room(1000);
        let crop = RatioCrop { ratio: [0.2, 0.4], point_max: 500 };
        let counts: Vec<usize> = (0..50).map(|seed| applied(&crop, &sample, seed).len()).collect();
        assert!(counts.iter().all(|n| (100..=200).contains(n)), "{counts:?}");
        assert!(counts.iter().any(|n| *n < 130) && counts.iter().any(|n| *n > 170));
        // Fewer than `point_max`: a share of what there is.
        let small = RatioCrop { ratio: [0.5, 0.5], point_max: 5000 };
        assert_eq!(applied(&small, &sample, 1).len(), 500);
    }
}

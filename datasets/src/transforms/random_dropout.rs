//! [`RandomDropout`]

use crate::error::{check_probability, require};
use crate::rng::{below, happens};
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// With `probability`, leaves out `ratio` of the Gaussians, at random.
    ///
    /// # Source
    /// `RandomDropout` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: the rows kept
    /// stay in order, and one is always kept (there, none of one).
    pub struct RandomDropout {
        /// Part of the Gaussians that is left out, `0..1`.
        pub ratio: f64 = 0.2,
        /// How often it happens.
        pub probability: f64 = 0.2,
    }
}

impl Transform for RandomDropout {
    fn check(&self) -> Result<(), DataError> {
        check_probability("random_dropout.probability", self.probability)?;
        let ok = (0.0..1.0).contains(&self.ratio);
        require(ok, "random_dropout.ratio", self.ratio, "at least 0 and below 1")
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if !happens(rng, self.probability) || sample.is_empty() {
            return Ok(());
        }
        let total = sample.len() as u32;
        let wanted = ((f64::from(total) * (1.0 - self.ratio)) as u32).max(1);
        let mut rows = Vec::with_capacity(wanted as usize);
        // Each row is kept with the share of those still wanted among those still to come: exactly
        // `wanted` rows, every set of them equally likely (Knuth's algorithm S).
        for row in 0..total {
            if below(rng, total - row) < wanted - rows.len() as u32 {
                rows.push(row);
            }
        }
        sample.select_rows(&rows);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, room};

    #[test]
    fn the_share_is_exact_and_even() {
        let sample = room(1000);
        let always = RandomDropout { ratio: 0.2, probability: 1.0 };
        let mut kept = vec![0; 1000];
        for seed in 0..200 {
            let left = applied(&always, &sample, seed);
            assert_eq!(left.len(), 800);
            let mut next = 0;
            for coord in &left.coord {
                next += sample.coord[next..].iter().position(|c| c == coord).unwrap() + 1;
                kept[next - 1] += 1;
            }
        }
        // 160 expected; six standard deviations of a binomial of 200 are 34.
        assert!(kept.iter().all(|n| (126..=194).contains(n)), "{kept:?}");
        let never = RandomDropout { ratio: 0.2, probability: 0.0 };
        assert_eq!(applied(&never, &sample, 1), sample);
    }
}

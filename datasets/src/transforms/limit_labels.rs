//! [`LimitLabels`]

use crate::error::require;
use crate::rng::name_number;
use crate::{DataError, Sample, SampleRng, Transform};
use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};

/// Forgets all labels of a scene but a few, to learn from few: the class of the other Gaussians becomes -1.
///
/// Which are kept depends on `seed` and the scene's name alone, so they are the same in every epoch; that
/// holds for the rows of the source, before any step that changes them. The other steps draw the same
/// numbers as without it. Labeled points stay: they are for evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum KeptLabels {
    /// This part of the labeled Gaussians of each scene, rounded, at least one; in 0..=1.
    Share(f64),
    /// So many of each scene, or all that there are.
    PerScene(usize),
}

/// The step; see [`KeptLabels`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitLabels {
    /// How many labels are kept.
    pub keep: KeptLabels,
    /// Which of them.
    #[serde(default)]
    pub seed: u64,
}

impl LimitLabels {
    /// Checks the setting.
    ///
    /// # Errors
    /// If it is out of range.
    pub fn check(&self) -> Result<(), DataError> {
        match self.keep {
            KeptLabels::Share(share) => {
                let ok = (0.0..=1.0).contains(&share);
                require(ok, "labels.keep.share", share, "a number in 0..=1")
            }
            KeptLabels::PerScene(count) => {
                require(count > 0, "labels.keep.per_scene", count, "a number of 1 or more")
            }
        }
    }
}

impl Transform for LimitLabels {
    fn check(&self) -> Result<(), DataError> {
        self.check()
    }

    fn apply(&self, sample_of: &mut Sample, _: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        let name = name_number(&sample_of.id);
        let Some(segment) = &mut sample_of.segment else { return Ok(()) };
        let labelled: Vec<usize> = (0..segment.len()).filter(|&row| segment[row] >= 0).collect();
        let count = match self.keep {
            KeptLabels::Share(share) => ((labelled.len() as f64 * share).round() as usize).max(1),
            KeptLabels::PerScene(count) => count,
        };
        if count >= labelled.len() {
            return Ok(());
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(name);
        let mut kept = vec![false; segment.len()];
        sample(&mut rng, labelled.len(), count).iter().for_each(|i| kept[labelled[i]] = true);
        let forgotten = segment.iter_mut().zip(kept).filter(|(_, kept)| !kept);
        forgotten.for_each(|(label, _)| *label = -1);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, room};

    fn kept(keep: KeptLabels, seed: u64, sample: &Sample) -> Vec<usize> {
        let limited = applied(&LimitLabels { keep, seed }, sample, 0);
        let (before, after) = (sample.segment.as_ref().unwrap(), limited.segment.unwrap());
        let both = before.iter().zip(&after).enumerate();
        assert!(both.clone().all(|(_, (a, b))| a == b || *b == -1));
        both.filter(|(_, (_, b))| **b >= 0).map(|(row, _)| row).collect()
    }

    #[test]
    fn the_same_few_labels_in_every_epoch() {
        let mut sample = room(1000);
        sample.segment = Some((0..1000).map(|row| row % 5 - 1).collect());
        let share = kept(KeptLabels::Share(0.01), 0, &sample);
        assert_eq!(share.len(), 8, "of 800 labeled ones");
        let step = LimitLabels { keep: KeptLabels::Share(0.01), seed: 0 };
        assert_eq!(applied(&step, &sample, 1), applied(&step, &sample, 2), "other random numbers");
        assert_ne!(share, kept(KeptLabels::Share(0.01), 1, &sample), "another seed");
        let other = Sample { id: "other".to_owned(), ..sample.clone() };
        assert_ne!(share, kept(KeptLabels::Share(0.01), 0, &other), "another scene");
        assert_eq!(kept(KeptLabels::Share(0.0), 0, &sample).len(), 1);
        assert_eq!(kept(KeptLabels::Share(1.0), 0, &sample).len(), 800);
        assert_eq!(kept(KeptLabels::PerScene(20), 0, &sample).len(), 20);
        assert_eq!(kept(KeptLabels::PerScene(5000), 0, &sample).len(), 800);
        // Nothing else changes, and what has no labels stays so.
        let limited = applied(&step, &sample, 0);
        assert_eq!(Sample { segment: sample.segment.clone(), ..limited }, sample);
        sample.segment = None;
        assert_eq!(applied(&step, &sample, 0), sample);
    }

    #[test]
    fn what_keeps_nothing_is_refused() {
        for keep in [
            KeptLabels::Share(-0.1),
            KeptLabels::Share(1.5),
            KeptLabels::Share(f64::NAN),
            KeptLabels::PerScene(0),
        ] {
            let error = LimitLabels { keep, seed: 0 }.check().unwrap_err().to_string();
            assert!(error.contains("labels.keep"), "{error}");
        }
    }
}

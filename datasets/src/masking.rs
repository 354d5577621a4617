//! Which Gaussians a network does not see while it learns to reconstruct them.
//!
//! # Source
//! The mask generator of SceneSplat be9d5e1. Differs: patches are measured in meters (there, voxel numbers
//! are divided by a length, so that each voxel is a patch of its own); where a ratio comes to less than one
//! patch, one is masked (there, a division by 0); weights are not rounded to f16.

use crate::DataError;
use crate::error::{check_positive, check_probability, check_shares, require};
use crate::rng::{Purpose, SampleRng, between, permutation, purpose_rng};
use serde::{Deserialize, Serialize};

/// What is masked as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskShape {
    /// Each Gaussian by itself.
    Gaussians,
    /// All Gaussians of a cube with edges of so many meters, above 0. The paper has 0.05 and 0.10.
    Patches(f64),
}

/// What the masked Gaussians of a scene count together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskWeight {
    /// Each counts 1 ÷ the number of masked patches, the original's rule: patches with many Gaussians
    /// count more, and scenes with many Gaussians a patch.
    #[default]
    PerPatch,
    /// Each counts 1 ÷ the number of masked Gaussians: 1 for a scene.
    PerGaussian,
}

scenesplat_kernels::settings! {
    /// How a batch is masked. The default is the original's, with patches of 5 cm.
    #[derive(Copy)]
    pub struct Masking {
        /// What is masked as a whole.
        pub shape: MaskShape = MaskShape::Patches(0.05),
        /// Share of the patches of a scene, drawn evenly between these for each scene, in 0..=1.
        pub ratio: [f64; 2] = [0.1, 0.5],
        /// Share of the scenes of a batch that are masked at all, rounded up, in 0..=1.
        pub scenes: f64 = 0.5,
        /// What masked Gaussians count.
        pub weight: MaskWeight = MaskWeight::PerPatch,
    }
}

/// What is masked of a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Masked {
    /// Whether each Gaussian is hidden. `[N]`
    pub hidden: Vec<bool>,
    /// What each counts; 0 where it is not hidden. `[N]`
    pub weights: Vec<f64>,
}

impl Masking {
    /// Checks the settings.
    ///
    /// # Errors
    /// Names the one that is out of range.
    pub fn check(&self) -> Result<(), DataError> {
        if let MaskShape::Patches(metres) = self.shape {
            check_positive("shape.patches", metres)?;
        }
        check_probability("scenes", self.scenes)?;
        check_shares("ratio", self.ratio)
    }

    /// Chooses what is hidden of the scenes of a batch, by (`seed`, `step`, place in the batch).
    ///
    /// A ratio above 0 hides at least one patch of a masked scene that has a Gaussian; positions that are
    /// not finite are never hidden. The order of rows decides nothing but which Gaussian is which.
    ///
    /// # Shapes
    /// `coord`: `[N, 3]`, meters · `offsets`: `[B + 1]`, the first row of each scene
    ///
    /// # Errors
    /// As [`check`](Self::check), and if the offsets do not lead from 0 to N.
    pub fn choose(
        &self,
        coord: &[[f32; 3]],
        offsets: &[usize],
        seed: u64,
        step: u64,
    ) -> Result<Masked, DataError> {
        self.check()?;
        let whole = offsets.first() == Some(&0) && offsets.last() == Some(&coord.len());
        let expected = "rows of scenes, from 0 to the number of Gaussians";
        require(whole && offsets.is_sorted(), "offsets", format_args!("{offsets:?}"), expected)?;
        let mut masked =
            Masked { hidden: vec![false; coord.len()], weights: vec![0.0; coord.len()] };
        let scenes = offsets.len() - 1;
        let count = (scenes as f64 * self.scenes).ceil() as usize;
        let mut rng = purpose_rng(Purpose::MaskedScenes, seed, step, 0);
        for &scene in permutation(&mut rng, scenes).iter().take(count) {
            let mut rng = purpose_rng(Purpose::Masking, seed, step, scene as u64);
            self.hide(coord, offsets[scene]..offsets[scene + 1], &mut rng, &mut masked);
        }
        Ok(masked)
    }

    fn hide(
        &self,
        coord: &[[f32; 3]],
        rows: std::ops::Range<usize>,
        rng: &mut SampleRng,
        masked: &mut Masked,
    ) {
        let ratio = between(rng, self.ratio);
        let mut cells: Vec<([i64; 3], usize)> = rows
            .filter(|&row| coord[row].iter().all(|v| v.is_finite()))
            .map(|row| match self.shape {
                MaskShape::Gaussians => ([row as i64, 0, 0], row),
                MaskShape::Patches(edge) => {
                    (coord[row].map(|v| (f64::from(v) / edge).floor() as i64), row)
                }
            })
            .collect();
        cells.sort_unstable();
        let patches: Vec<&[([i64; 3], usize)]> = cells.chunk_by(|a, b| a.0 == b.0).collect();
        let least = usize::from(ratio > 0.0).min(patches.len());
        let count = ((patches.len() as f64 * ratio) as usize).max(least);
        let order = permutation(rng, patches.len());
        let chosen = || order[..count].iter().flat_map(|&patch| patches[patch]);
        let weight = match self.weight {
            MaskWeight::PerPatch => 1.0 / count as f64,
            MaskWeight::PerGaussian => 1.0 / chosen().count() as f64,
        };
        for &(_, row) in chosen() {
            masked.hidden[row] = true;
            masked.weights[row] = weight;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scenes of a row of Gaussians each, 1 cm apart.
    fn lines(lengths: &[usize]) -> (Vec<[f32; 3]>, Vec<usize>) {
        let (mut coord, mut offsets) = (Vec::new(), vec![0]);
        for &length in lengths {
            coord.extend((0..length).map(|i| [i as f32 * 0.01 + 0.005, 0.0, -1.0]));
            offsets.push(coord.len());
        }
        (coord, offsets)
    }

    fn all(shape: MaskShape, ratio: f64) -> Masking {
        Masking { shape, ratio: [ratio; 2], scenes: 1.0, weight: MaskWeight::PerPatch }
    }

    #[test]
    fn patches_are_hidden_whole_and_in_metres() {
        let (coord, offsets) = lines(&[100]);
        // 20 patches of 5 cm with five Gaussians each.
        let masked = all(MaskShape::Patches(0.05), 0.3).choose(&coord, &offsets, 1, 2).unwrap();
        let full = masked.hidden.chunks_exact(5).filter(|patch| patch.iter().all(|h| *h)).count();
        assert_eq!(full, 6);
        assert_eq!(masked.hidden.iter().filter(|h| **h).count(), 30);
        let sum: f64 = masked.weights.iter().sum();
        assert!((sum - 5.0).abs() < 1e-12, "30 Gaussians of 1/6: {sum}");
        let even =
            Masking { weight: MaskWeight::PerGaussian, ..all(MaskShape::Patches(0.05), 0.3) };
        let even = even.choose(&coord, &offsets, 1, 2).unwrap();
        assert_eq!(even.hidden, masked.hidden);
        assert!((even.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        // One by one, they are no neighbors.
        let single = all(MaskShape::Gaussians, 0.3).choose(&coord, &offsets, 1, 2).unwrap();
        assert_eq!(single.hidden.iter().filter(|h| **h).count(), 30);
        assert!(single.hidden.chunks_exact(5).any(|p| p.iter().any(|h| *h != p[0])));
    }

    #[test]
    fn half_of_the_scenes_rounded_up_and_each_its_ratio() {
        let (coord, offsets) = lines(&[100, 100, 100]);
        let masking = Masking { ratio: [0.1, 0.9], ..Masking::default() };
        let mut seen = [0; 3];
        let mut shares = Vec::new();
        for step in 0..200 {
            let masked = masking.choose(&coord, &offsets, 3, step).unwrap();
            let counts: Vec<usize> =
                masked.hidden.chunks_exact(100).map(|s| s.iter().filter(|h| **h).count()).collect();
            assert_eq!(counts.iter().filter(|c| **c > 0).count(), 2);
            for (seen, count) in seen.iter_mut().zip(&counts) {
                *seen += usize::from(*count > 0);
            }
            shares.extend(counts.into_iter().filter(|c| *c > 0));
        }
        // 2/3 of 200 steps, standard deviation 6.7; ratios all over the range.
        assert!(seen.iter().all(|s| (105..=162).contains(s)), "{seen:?}");
        assert!(shares.iter().any(|s| *s <= 20) && shares.iter().any(|s| *s >= 80));
    }

    #[test]
    fn a_scene_has_its_mask_whatever_stands_beside_it() {
        let (coord, offsets) = lines(&[80, 60]);
        let masking = all(MaskShape::Patches(0.1), 0.5);
        let both = masking.choose(&coord, &offsets, 5, 7).unwrap();
        let (longer, offsets_longer) = lines(&[80, 60, 500]);
        let more = masking.choose(&longer, &offsets_longer, 5, 7).unwrap();
        assert_eq!(both.hidden, more.hidden[..140]);
        // Another step, another seed: other masks. The same again: the same.
        assert_eq!(both, masking.choose(&coord, &offsets, 5, 7).unwrap());
        assert_ne!(both.hidden, masking.choose(&coord, &offsets, 5, 8).unwrap().hidden);
        assert_ne!(both.hidden, masking.choose(&coord, &offsets, 6, 7).unwrap().hidden);
    }

    #[test]
    fn nothing_all_and_bad_values() {
        let masking = all(MaskShape::Patches(0.05), 0.0);
        let (coord, offsets) = lines(&[0, 1, 30]);
        assert!(!masking.choose(&coord, &offsets, 0, 0).unwrap().hidden.contains(&true));
        let masking = all(MaskShape::Patches(0.05), 1.0);
        assert!(masking.choose(&coord, &offsets, 0, 0).unwrap().hidden.iter().all(|h| *h));
        // Less than a patch is one patch; no Gaussian, none.
        let masking = all(MaskShape::Patches(0.05), 1e-6);
        let few = masking.choose(&coord, &offsets, 0, 0).unwrap();
        assert!(few.hidden[0] && few.hidden[1..].iter().filter(|h| **h).count() == 5);
        let bad = [[f32::NAN, 0.0, 0.0], [0.0; 3], [1e30, f32::INFINITY, 0.0], [3e38, 0.0, 0.0]];
        let masked = all(MaskShape::Gaussians, 1.0).choose(&bad, &[0, 4], 0, 0).unwrap();
        assert_eq!(masked.hidden, [false, true, false, true]);
        let masked = all(MaskShape::Patches(1e-9), 1.0).choose(&bad, &[0, 4], 0, 0).unwrap();
        assert_eq!(masked.hidden, [false, true, false, true]);
        assert_eq!(masked.weights, [0.0, 0.5, 0.0, 0.5]);
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let check = |masking: Masking| masking.check().unwrap_err().to_string();
        let good = Masking::default();
        assert!(check(Masking { shape: MaskShape::Patches(0.0), ..good }).contains("patches"));
        assert!(check(Masking { ratio: [0.5, 0.1], ..good }).contains("ratio"));
        assert!(check(Masking { scenes: 1.5, ..good }).contains("scenes"));
        assert!(good.choose(&[[0.0; 3]], &[0, 2], 0, 0).is_err());
        assert!(good.choose(&[], &[], 0, 0).is_err());
    }
}

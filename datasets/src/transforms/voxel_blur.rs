//! [`VoxelBlur`]

use super::quaternion::{unit, with_positive_w};
use crate::error::{check_finite, check_positive, check_probability, check_range, require};
use crate::rng::{between, happens};
use crate::{DataError, Sample, SampleRng, Transform};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use std::collections::HashMap;

/// Reach of the filter in standard deviations.
const TRUNCATE: f64 = 2.0;

scenesplat_kernels::settings! {
    /// With `probability`, blurs color, size, orientation and opacity over the voxels around: each takes
    /// the mean of those of opaque Gaussians nearby, weighted by a Gaussian of their distance in voxels.
    ///
    /// Only Gaussians with an opacity above one half give and take. Of several in a voxel the last one
    /// gives. A quaternion counts with the sign that is nearest to the one it is averaged into.
    ///
    /// # Source
    /// `GSGaussianBlurVoxelOpc` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: there a
    /// dense grid over the whole box is filtered, with its borders mirrored; here only the voxels that
    /// hold something, so borders have no more weight than they hold; quaternions there are averaged with
    /// whatever sign they have.
    pub struct VoxelBlur {
        /// How often it happens.
        pub probability: f64 = 0.5,
        /// Lowest and highest standard deviation, in voxels, above 0 and at most 4.
        pub sigma: [f64; 2] = [0.1, 2.0],
        /// Size of a voxel, meters.
        pub grid_size: f64 = 0.02,
    }
}

/// Color, size, opacity and orientation of a Gaussian.
type Row = [f64; 11];

fn row_of(sample: &Sample, row: usize) -> Row {
    let mut out = [0.0; 11];
    for a in 0..3 {
        out[a] = sample.color[row][a].into();
        out[3 + a] = sample.scale[row][a].into();
    }
    out[6] = sample.opacity[row].into();
    (0..4).for_each(|a| out[7 + a] = sample.quat[row][a].into());
    out
}

impl Transform for VoxelBlur {
    fn check(&self) -> Result<(), DataError> {
        check_probability("voxel_blur.probability", self.probability)?;
        check_range("voxel_blur.sigma", self.sigma)?;
        check_positive("voxel_blur.sigma", self.sigma[0])?;
        let expected = "at most 4 voxels: the filter reads all voxels within twice as much";
        require(self.sigma[1] <= 4.0, "voxel_blur.sigma", self.sigma[1], expected)?;
        check_positive("voxel_blur.grid_size", self.grid_size)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        let (on, sigma) = (happens(rng, self.probability), between(rng, self.sigma));
        if !on || sample.is_empty() {
            return Ok(());
        }
        check_finite("coord", &sample.coord)?;
        let groups = voxel_groups(&sample.coord, self.grid_size, KeyOrder::Morton)?;
        let opaque: Vec<usize> = (0..sample.len()).filter(|&i| sample.opacity[i] > 0.5).collect();
        let cell = |row: usize| groups.grid_coord[groups.inverse[row] as usize];
        let mut there: HashMap<[i32; 3], Row> = HashMap::with_capacity(opaque.len());
        for &row in &opaque {
            there.insert(cell(row), row_of(sample, row));
        }
        let reach = (TRUNCATE * sigma + 0.5) as i32;
        let weight: Vec<f64> =
            (0..=reach).map(|d| (-0.5 * (f64::from(d) / sigma).powi(2)).exp()).collect();
        let blurred = |row: usize| {
            let (center, own) = (cell(row), row_of(sample, row));
            let (mut sum, mut total) = ([0.0; 11], 0.0);
            for dx in -reach..=reach {
                for dy in -reach..=reach {
                    for dz in -reach..=reach {
                        let at = [center[0] + dx, center[1] + dy, center[2] + dz];
                        let Some(other) = there.get(&at) else { continue };
                        let w = [dx, dy, dz].map(|d| weight[d.unsigned_abs() as usize]);
                        let w = w[0] * w[1] * w[2];
                        let turn: f64 = (7..11).map(|k| own[k] * other[k]).sum();
                        let sign = if turn < 0.0 { -1.0 } else { 1.0 };
                        for k in 0..11 {
                            sum[k] += w * if k < 7 { other[k] } else { sign * other[k] };
                        }
                        total += w;
                    }
                }
            }
            sum.map(|v| v / (total + 1e-7))
        };
        let new: Vec<Row> = opaque.iter().map(|&row| blurred(row)).collect();
        for (&row, new) in opaque.iter().zip(&new) {
            for a in 0..3 {
                sample.color[row][a] = new[a] as f32;
                sample.scale[row][a] = new[3 + a] as f32;
            }
            sample.opacity[row] = new[6] as f32;
            let quat = [new[7], new[8], new[9], new[10]];
            // Opposite turns may cancel each other: then the own one stays.
            if quat.iter().map(|v| v * v).sum::<f64>() > 1e-12 {
                sample.quat[row] = with_positive_w(unit(quat)).map(|v| v as f32);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, room};

    #[test]
    fn neighbours_share_by_their_distance() {
        let mut sample =
            at(&[[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [0.05, 0.01, 0.01], [0.5; 3]]);
        sample.opacity = vec![0.9, 0.9, 0.2, 0.9];
        sample.color[1] = [110.0, 20.0, 30.0];
        let blur = VoxelBlur { probability: 1.0, sigma: [1.0, 1.0], grid_size: 0.02 };
        let out = applied(&blur, &sample, 0);
        let w = (-0.5_f64).exp();
        // 10 and 110, one voxel apart; the third is not opaque, the fourth far away.
        let want = [(10.0 + w * 110.0) / (1.0 + w), (110.0 + w * 10.0) / (1.0 + w), 10.0, 10.0];
        for (color, want) in out.color.iter().zip(want) {
            assert!((f64::from(color[0]) - want).abs() < 1e-4, "{:?}", out.color);
        }
        assert_eq!(out.coord, sample.coord);
        // A quaternion and its negative are the same turn.
        let mut turned = sample.clone();
        turned.quat[0] = [-1.0, 0.0, 0.0, 0.0];
        let out = applied(&blur, &turned, 0);
        assert!(out.quat.iter().all(|q| (q[0] - 1.0).abs() < 1e-6), "{:?}", out.quat);
    }

    #[test]
    fn rooms_stay_in_range() {
        let blur = VoxelBlur { probability: 1.0, ..VoxelBlur::default() };
        let sample = room(800);
        let out = applied(&blur, &sample, 2);
        assert!(out.color.iter().flatten().all(|c| (0.0..=255.0).contains(c)));
        assert!(out.quat.iter().all(|q| {
            let norm: f32 = q.iter().map(|v| v * v).sum();
            (norm - 1.0).abs() < 1e-4
        }));
        let never = VoxelBlur { probability: 0.0, ..blur };
        assert_eq!(applied(&never, &sample, 2), sample);
    }
}

//! [`SphereCrop`]

use crate::error::require;
use crate::rng::below;
use crate::{DataError, Sample, SampleRng, Transform};
use scenesplat_kernels::neighbors::distance_squared;
use serde::{Deserialize, Serialize};

/// Where a crop has its center.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CropCenter {
    /// A random Gaussian.
    #[default]
    Random,
    /// The Gaussian in the middle of the list.
    Middle,
}

scenesplat_kernels::settings! {
    /// Keeps the `point_max` Gaussians nearest to a center, if there are more. Cells keep the origin they
    /// had.
    ///
    /// # Source
    /// `SphereCrop` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: the rows kept stay
    /// in order (there, nearest first), and of equally far ones the first are kept.
    pub struct SphereCrop {
        /// Most Gaussians that are left.
        pub point_max: usize = 192_000,
        /// Where the center is.
        pub center: CropCenter = CropCenter::Random,
        /// Puts the nearest first, as the original does.
        pub exact: bool = false,
    }
}

fn order(a: &(f64, u32), b: &(f64, u32)) -> std::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
}

/// The nearest rows with their squared distances, in no order; all if there are no more.
fn by_distance(coord: &[[f32; 3]], center: [f32; 3], count: usize) -> Vec<(f64, u32)> {
    let rows = (0_u32..).zip(coord);
    let mut rows: Vec<(f64, u32)> =
        rows.map(|(row, &coord)| (distance_squared(coord, center), row)).collect();
    if count < rows.len() {
        rows.select_nth_unstable_by(count, order);
        rows.truncate(count);
    }
    rows
}

/// The `count` rows nearest to a place, ascending; of equally far ones the first.
pub(super) fn nearest_rows(coord: &[[f32; 3]], center: [f32; 3], count: usize) -> Vec<u32> {
    let rows = by_distance(coord, center, count);
    let mut rows: Vec<u32> = rows.into_iter().map(|(_, row)| row).collect();
    rows.sort_unstable();
    rows
}

impl Transform for SphereCrop {
    fn check(&self) -> Result<(), DataError> {
        require(self.point_max > 0, "sphere_crop.point_max", 0, "a number of 1 or more")
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if sample.len() <= self.point_max {
            return Ok(());
        }
        let center = match self.center {
            CropCenter::Random => below(rng, sample.len() as u32) as usize,
            CropCenter::Middle => sample.len() / 2,
        };
        let center = sample.coord[center];
        let mut rows = by_distance(&sample.coord, center, self.point_max);
        if self.exact {
            rows.sort_unstable_by(order);
        } else {
            rows.sort_unstable_by_key(|&(_, row)| row);
        }
        sample.select_rows(&rows.into_iter().map(|(_, row)| row).collect::<Vec<_>>());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, room};

    #[test]
    fn the_nearest_are_kept() {
        let sample = room(3000);
        for (center, exact) in
            [(CropCenter::Random, false), (CropCenter::Middle, false), (CropCenter::Middle, true)]
        {
            let crop = SphereCrop { point_max: 500, center, exact };
            let kept = applied(&crop, &sample, 9);
            assert_eq!(kept.len(), 500);
            let has = |c: &[f32; 3]| kept.coord.contains(c);
            // Some Gaussian of the scene is nearer to every kept one than to any other.
            let is_center = |c: &[f32; 3]| {
                let d = |p: &[f32; 3]| distance_squared(*p, *c);
                let inside = kept.coord.iter().map(d).fold(0.0, f64::max);
                sample.coord.iter().filter(|p| !has(p)).all(|p| d(p) >= inside)
            };
            if center == CropCenter::Middle {
                assert!(is_center(&sample.coord[1500]));
            } else {
                assert!(kept.coord.iter().any(is_center));
            }
            if exact {
                assert_eq!(kept.coord[0], sample.coord[1500]);
            }
        }
    }

    #[test]
    fn ties_and_small_scenes() {
        let crop = SphereCrop { point_max: 2, center: CropCenter::Middle, exact: false };
        let mut same = at(&[[1.0; 3]; 5]);
        same.segment = Some((0..5).collect());
        assert_eq!(applied(&crop, &same, 0).segment.unwrap(), [0, 1]);
        assert_eq!(applied(&crop, &at(&[[1.0; 3]; 2]), 0).len(), 2);
    }
}

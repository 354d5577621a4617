//! [`GridSample`]

use crate::error::{check_finite, check_length, check_positive};
use crate::rng::below;
use crate::{DataError, FullScene, Sample, SampleRng, Transform};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat_scene::LabelledPoints;
use serde::{Deserialize, Serialize};

/// Which Gaussian of a cell is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// A random one: the network sees another one each time.
    #[default]
    Random,
    /// The one nearest to the middle of the cell, as in inference.
    Nearest,
    /// The first one.
    First,
}

scenesplat_kernels::settings! {
    /// Keeps one Gaussian of every cell and fills `grid_coord`, the lowest cell of each axis being 0.
    /// Cells come along a z-order curve.
    ///
    /// Labeled points, if there are any, are thinned by the same size: the first labeled one of a
    /// cell, else the first.
    ///
    /// # Source
    /// `GridSample(mode="train")` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. With `exact`
    /// cells come in its order (by hash), and the one kept is number `draw % count` with draws below
    /// the count of the fullest cell, which favours the first ones slightly; else each is equally
    /// likely. Its test mode is [`ExactPlan`](crate::ExactPlan).
    pub struct GridSample {
        /// Size of a cell, meters.
        pub grid_size: f64 = 0.02,
        /// Which Gaussian of a cell is kept.
        pub keep: Keep = Keep::Random,
        /// Whether the scene as it is before the sampling is kept, labeled points included, see
        /// [`FullScene`]: evaluations score it.
        pub keep_full: bool = false,
        /// Whether labeled points are thinned.
        pub thin_labelled_points: bool = true,
        /// Draws and orders as the original does.
        pub exact: bool = false,
    }
}

impl Transform for GridSample {
    fn check(&self) -> Result<(), DataError> {
        check_positive("grid_sample.grid_size", self.grid_size)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        check_finite("coord", &sample.coord)?;
        let order = if self.exact { KeyOrder::Fnv } else { KeyOrder::Morton };
        let groups = voxel_groups(&sample.coord, self.grid_size, order)?;
        let rows = match self.keep {
            Keep::First => groups.first_rows(),
            Keep::Nearest => groups.nearest_to_centre(&sample.coord)?,
            Keep::Random => {
                let fullest = groups.largest_count() as u32;
                let bound = |voxel: usize| {
                    if self.exact { fullest } else { groups.rows_of(voxel).len() as u32 }
                };
                let draws: Vec<u32> =
                    (0..groups.num_voxels()).map(|voxel| below(rng, bound(voxel))).collect();
                groups.drawn_rows(&draws)?
            }
        };
        let full = self.keep_full.then(|| FullScene {
            coord: sample.coord.clone(),
            voxel: groups.inverse.clone(),
            segment: sample.segment.clone(),
            valid_feat: sample.valid_feat.clone(),
            points: sample.labelled_points.clone(),
            teacher: None,
            origin_row: sample.origin_row.clone(),
        });
        // Old cells, if any, are replaced.
        sample.grid_coord.clear();
        sample.select_rows(&rows);
        sample.full = full;
        sample.grid_coord = groups.grid_coord;
        sample.grid_size = self.grid_size;
        match &mut sample.labelled_points {
            Some(points) if self.thin_labelled_points => self.thin(points),
            _ => Ok(()),
        }
    }
}

impl GridSample {
    fn thin(&self, points: &mut LabelledPoints) -> Result<(), DataError> {
        check_finite("pc_coord", &points.coord)?;
        let groups = voxel_groups(&points.coord, self.grid_size, KeyOrder::Morton)?;
        let rows = match &points.segment {
            Some(labels) => groups.labelled_rows(labels, -1)?,
            None => groups.first_rows(),
        };
        let pick = |values: &mut Vec<i32>| {
            *values = rows.iter().map(|&row| values[row as usize]).collect();
        };
        if let Some(labels) = &points.instance {
            check_length("pc_instance", points.coord.len(), labels.len())?;
        }
        points.segment.as_mut().map(pick);
        points.instance.as_mut().map(pick);
        points.coord = rows.iter().map(|&row| points.coord[row as usize]).collect();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, room};
    use crate::{FastPlan, sample_rng};
    use scenesplat_rooms::{SyntheticRoomSettings, generate};
    use std::collections::{BTreeMap, BTreeSet};

    #[test]
    fn one_gaussian_a_cell() {
        let sample = room(20_000);
        for (keep, exact) in [
            (Keep::Random, false),
            (Keep::Random, true),
            (Keep::Nearest, false),
            (Keep::First, false),
        ] {
            let step = GridSample { grid_size: 0.05, keep, exact, ..<_>::default() };
            let kept = applied(&step, &sample, 1);
            assert!(kept.len() < sample.len());
            let cells: BTreeSet<_> = kept.grid_coord.iter().collect();
            assert_eq!(cells.len(), kept.len());
            let low = |axis: usize| kept.grid_coord.iter().map(|c| c[axis]).min();
            assert!((0..3).all(|axis| low(axis) == Some(0)));
            let first = |c: f32| (f64::from(c) / 0.05).floor();
            let lowest: [f64; 3] = std::array::from_fn(|a| {
                sample.coord.iter().map(|c| first(c[a])).fold(f64::INFINITY, f64::min)
            });
            for (coord, cell) in kept.coord.iter().zip(&kept.grid_coord) {
                assert!((0..3).all(|a| first(coord[a]) - lowest[a] == f64::from(cell[a])));
            }
            let points = kept.labelled_points.unwrap();
            assert_eq!(points.coord.len(), points.segment.unwrap().len());
            assert!(points.coord.len() < sample.labelled_points.as_ref().unwrap().coord.len());
        }
    }

    #[test]
    fn the_original_s_example() {
        let xs = [0.001, 0.015, 0.021, -0.001, 0.0399];
        let mut sample = at(&xs.map(|x| [x, 0.0, 0.0]));
        sample.segment = Some((0..5).collect());
        let step = GridSample { exact: true, keep: Keep::First, ..<_>::default() };
        let kept = applied(&step, &sample, 0);
        assert_eq!(kept.grid_coord, [[2, 0, 0], [1, 0, 0], [0, 0, 0]]);
        assert_eq!(kept.segment.unwrap(), [2, 0, 3]);
    }

    #[test]
    fn each_of_a_cell_is_equally_likely() {
        // Three in one cell, five in another: exact draws below 5 favor the first two of three.
        let mut sample = at(&[[0.01; 3], [0.01; 3], [0.01; 3]]);
        let more = at(&[[1.01; 3]; 5]);
        sample.coord.extend(&more.coord);
        let mut sample = at(&sample.coord);
        sample.segment = Some((0..8).collect());
        let mut counts = BTreeMap::new();
        for seed in 0..3000 {
            let mut kept = sample.clone();
            GridSample::default().apply(&mut kept, &mut sample_rng(seed, 0, 0)).unwrap();
            let row = kept.segment.unwrap().into_iter().find(|&s| s < 3).unwrap();
            *counts.entry(row).or_insert(0) += 1;
        }
        // 1000 expected; five standard deviations are 129.
        assert!(
            counts.len() == 3 && counts.values().all(|n| (871..1129).contains(n)),
            "{counts:?}"
        );
    }

    #[test]
    fn nearest_is_what_inference_reads() {
        let room = generate(&SyntheticRoomSettings::with_count(8000, 2));
        let scene = room.unwrap().scene;
        let plan = FastPlan::default().build(&scene).unwrap();
        let input = plan.input(0).unwrap();
        let mut sample = Sample::from_scene("a", scene.clone());
        let mut rng = sample_rng(0, 0, 0);
        crate::transforms::CenterShift::default().apply(&mut sample, &mut rng).unwrap();
        GridSample { keep: Keep::Nearest, ..<_>::default() }.apply(&mut sample, &mut rng).unwrap();
        assert_eq!(sample.grid_coord, input.grid_coord);
        let feat = crate::InputFeatures::default().sample_rows(&sample).unwrap();
        assert!(feat.iter().zip(&input.feat).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert_eq!(feat.len(), input.feat.len());
    }

    #[test]
    fn hard_inputs() {
        assert_eq!(applied(&GridSample::default(), &at(&[[1.0; 3]]), 0).grid_coord, [[0; 3]]);
        assert_eq!(applied(&GridSample::default(), &at(&[[1.0; 3]; 1000]), 0).len(), 1);
        let apply = |coord: &[[f32; 3]]| {
            GridSample::default().apply(&mut at(coord), &mut sample_rng(0, 0, 0)).unwrap_err()
        };
        let error = apply(&[[0.0; 3], [0.0, f32::NAN, 0.0]]);
        assert!(matches!(error, DataError::NotFinite { row: 1, field: "coord", .. }), "{error}");
        assert!(matches!(apply(&[[0.0; 3], [1e9; 3]]), DataError::Grid(_)));
    }
}

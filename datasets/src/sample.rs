//! One scene on its way to the network.

use crate::error::check_length;
use crate::files::picked;
use crate::{DataError, FullScene, SampleRng};
use half::f16;
use scenesplat_scene::{GaussianScene, LabelledPoints, LanguageFeatures};
use std::fmt::Debug;

/// A scene on its way through the transforms, values as the network's data files hold them, that
/// is, after activation; see [`GaussianScene`] for the conventions.
///
/// All arrays have one row per Gaussian, `N` rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sample {
    /// Name of the scene.
    pub id: String,
    /// Centers, meters. `[N, 3]`
    pub coord: Vec<[f32; 3]>,
    /// Color, `0..=255`, no longer whole numbers after a color transform. `[N, 3]`
    pub color: Vec<[f32; 3]>,
    /// Opacity, `0..=1`. `[N]`
    pub opacity: Vec<f32>,
    /// Standard deviation along each principal axis, meters. `[N, 3]`
    pub scale: Vec<[f32; 3]>,
    /// Orientation `w, x, y, z`, unit norm. `[N, 4]`
    pub quat: Vec<[f32; 4]>,
    /// Unit surface normals; 0, 0, 0 where unknown. `[N, 3]`
    pub normal: Option<Vec<[f32; 3]>>,
    /// Class index, -1 = ignored. `[N]`
    pub segment: Option<Vec<i32>>,
    /// Instance id, -1 = none. `[N]`
    pub instance: Option<Vec<i32>>,
    /// Language features. `[N, D]`
    pub lang_feat: Option<LanguageFeatures>,
    /// Whether the row of `lang_feat` holds a feature. `[N]`
    pub valid_feat: Option<Vec<bool>>,
    /// Cell of each Gaussian, not negative; empty before [`GridSample`](crate::transforms::GridSample).
    /// `[N, 3]`
    pub grid_coord: Vec<[i32; 3]>,
    /// Size of a cell, meters; 0 before [`GridSample`](crate::transforms::GridSample).
    pub grid_size: f64,
    /// Labeled points to evaluate on, in the same frame; independent row count.
    pub labelled_points: Option<LabelledPoints>,
    /// The scene that the rows were sampled from, if a
    /// [`GridSample`](crate::transforms::GridSample) was told to keep it.
    pub full: Option<FullScene>,
    /// Row that each Gaussian had when a [teacher](crate::SceneTeacher) looked, or
    /// [`ADDED`](Self::ADDED); `None` if none does.
    /// `[N]`
    pub origin_row: Option<Vec<u32>>,
    /// Views of the scene, if a [`Views`](crate::transforms::Views) step made some; the sample itself
    /// has no rows then.
    pub views: Vec<crate::views::ViewSample>,
}

impl Sample {
    /// In [`origin_row`](Self::origin_row): a Gaussian that no teacher saw, because it was added later.
    pub const ADDED: u32 = u32::MAX;

    /// A scene as the transforms see it. Spherical harmonics above the color are left behind.
    ///
    /// Colors become the bytes of the original preprocessing (truncated); a color that is NaN
    /// stays NaN, so that it is found before it reaches the network.
    pub fn from_scene(id: impl Into<String>, scene: GaussianScene) -> Self {
        let color = (0..scene.len())
            .map(|row| {
                let (bytes, dc) = (scene.color_u8(row), scene.sh_dc[row]);
                std::array::from_fn(|c| if dc[c].is_nan() { dc[c] } else { f32::from(bytes[c]) })
            })
            .collect();
        let opacity = (0..scene.len()).map(|row| scene.opacity(row)).collect();
        let scale = (0..scene.len()).map(|row| scene.scale(row)).collect();
        Self {
            id: id.into(),
            coord: scene.coord,
            color,
            opacity,
            scale,
            quat: scene.quat,
            normal: scene.normal,
            segment: scene.segment,
            instance: scene.instance,
            lang_feat: scene.lang_feat,
            valid_feat: scene.valid_feat_mask,
            labelled_points: scene.labelled_points,
            ..Self::default()
        }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.coord.len()
    }

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.coord.is_empty()
    }

    /// Keeps the given rows, in the given order; rows may repeat. The one place where the number of
    /// rows changes, so no array can get out of step. Labeled points stay; the full scene goes, whose
    /// voxels these rows no longer are.
    ///
    /// # Panics
    /// If a row is out of range or an array is shorter than `coord` (a bug of the caller; see
    /// [`check`](Self::check)).
    pub fn select_rows(&mut self, rows: &[u32]) {
        fn pick<T: Copy>(values: &mut Vec<T>, rows: &[u32]) {
            *values = rows.iter().map(|&row| values[row as usize]).collect();
        }
        for values in [&mut self.coord, &mut self.color, &mut self.scale] {
            pick(values, rows);
        }
        pick(&mut self.opacity, rows);
        pick(&mut self.quat, rows);
        self.normal.iter_mut().for_each(|values| pick(values, rows));
        self.segment.iter_mut().for_each(|values| pick(values, rows));
        self.instance.iter_mut().for_each(|values| pick(values, rows));
        self.valid_feat.iter_mut().for_each(|values| pick(values, rows));
        self.origin_row.iter_mut().for_each(|values| pick(values, rows));
        if let Some(LanguageFeatures { values, dim }) = &mut self.lang_feat {
            pick_features(values, *dim, rows);
        }
        if !self.grid_coord.is_empty() {
            pick(&mut self.grid_coord, rows);
        }
        self.full = None;
    }

    /// Checks that every array has one row per Gaussian.
    ///
    /// # Errors
    /// Names the first array of another length.
    pub fn check(&self) -> Result<(), DataError> {
        let n = self.len();
        for (field, rows) in [
            ("color", Some(self.color.len())),
            ("opacity", Some(self.opacity.len())),
            ("scale", Some(self.scale.len())),
            ("quat", Some(self.quat.len())),
            ("normal", self.normal.as_ref().map(Vec::len)),
            ("segment", self.segment.as_ref().map(Vec::len)),
            ("instance", self.instance.as_ref().map(Vec::len)),
            ("valid_feat", self.valid_feat.as_ref().map(Vec::len)),
            ("origin_row", self.origin_row.as_ref().map(Vec::len)),
        ] {
            check_length(field, n, rows.unwrap_or(n))?;
        }
        if let Some(features) = &self.lang_feat {
            let expected = n.saturating_mul(features.dim);
            check_length("lang_feat", expected, features.values.len())?;
        }
        if !self.grid_coord.is_empty() {
            check_length("grid_coord", n, self.grid_coord.len())?;
        }
        if let Some(full) = &self.full {
            check_length("full.voxel", full.len(), full.voxel.len())?;
            if let Some(taught) = &full.teacher {
                taught.check(full.len())?;
            }
        }
        Ok(())
    }

    /// The coordinates of Gaussians and labeled points, which move together.
    pub(crate) fn places_mut(&mut self) -> impl Iterator<Item = &mut [f32; 3]> {
        let points = self.labelled_points.iter_mut().flat_map(|points| &mut points.coord);
        self.coord.iter_mut().chain(points)
    }

    /// Lowest and highest coordinate of each axis; `None` without Gaussians.
    pub(crate) fn bounds(&self) -> Option<[[f32; 3]; 2]> {
        bounds(&self.coord)
    }
}

/// Lowest and highest coordinate of each axis; `None` without a point.
pub(crate) fn bounds(coord: &[[f32; 3]]) -> Option<[[f32; 3]; 2]> {
    let first = *coord.first()?;
    Some(coord.iter().fold([first, first], |[low, high], c| {
        [std::array::from_fn(|a| low[a].min(c[a])), std::array::from_fn(|a| high[a].max(c[a]))]
    }))
}

/// Keeps rows of language features, which are nearly all of a sample's memory: in place if the rows
/// stay in order, as crops leave them.
fn pick_features(values: &mut Vec<f16>, dim: usize, rows: &[u32]) {
    if rows.is_sorted_by(|a, b| a < b) {
        for (to, &row) in rows.iter().enumerate() {
            let from = row as usize * dim;
            values.copy_within(from..from + dim, to * dim);
        }
        values.truncate(rows.len() * dim);
        return;
    }
    *values = picked(values, dim, rows);
}

/// One change of a sample: a step of an augmentation, a crop, a sampling.
///
/// Random numbers come from the argument only, so a sample is the same for any number of workers
/// and after a resume. A transform that needs to give several samples is none; see
/// [`ExactPlan`](crate::ExactPlan) for passes over a whole scene.
pub trait Transform: Send + Sync + Debug {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Names the first that is out of range.
    fn check(&self) -> Result<(), DataError> {
        Ok(())
    }

    /// Changes `sample` in place, drawing from `rng` only.
    ///
    /// # Errors
    /// If the sample does not allow the change; the caller says of which scene.
    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError>;
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn sample() -> Sample {
        let room = generate(&SyntheticRoomSettings::with_count(400, 1)).unwrap();
        let mut sample = Sample::from_scene("room", room.scene);
        let n = sample.len();
        let values = (0..n * 2).map(|i| f16::from_f32(i as f32)).collect();
        sample.lang_feat = Some(LanguageFeatures { values, dim: 2 });
        sample.valid_feat = Some((0..n).map(|i| i % 3 == 0).collect());
        sample.grid_coord = (0..n as i32).map(|i| [i; 3]).collect();
        sample
    }

    #[test]
    fn values_are_activated() {
        let room = generate(&SyntheticRoomSettings::with_count(50, 2)).unwrap().scene;
        let sample = Sample::from_scene("a", room.clone());
        sample.check().unwrap();
        for row in 0..room.len() {
            assert_eq!(sample.scale[row], room.scale(row));
            assert_eq!(sample.opacity[row], room.opacity(row));
            assert_eq!(sample.color[row], room.color_u8(row).map(f32::from));
        }
        let mut bad = room;
        bad.sh_dc[3][1] = f32::NAN;
        assert!(Sample::from_scene("a", bad).color[3][1].is_nan());
    }

    #[test]
    fn rows_are_selected_in_every_array() {
        let all = sample();
        let mut some = all.clone();
        let rows = [7, 3, 3, 399];
        some.select_rows(&rows);
        some.check().unwrap();
        assert_eq!(some.len(), 4);
        for (i, &row) in rows.iter().enumerate() {
            let row = row as usize;
            assert_eq!(some.coord[i], all.coord[row]);
            assert_eq!(some.segment.as_ref().unwrap()[i], all.segment.as_ref().unwrap()[row]);
            assert_eq!(some.valid_feat.as_ref().unwrap()[i], row.is_multiple_of(3));
            assert_eq!(some.grid_coord[i], [row as i32; 3]);
            let feat = &some.lang_feat.as_ref().unwrap().values[i * 2..i * 2 + 2];
            assert_eq!(feat[0].to_f32(), row as f32 * 2.0);
        }
        let ascending: Vec<u32> = (0..400).step_by(3).collect();
        let mut some = all;
        some.select_rows(&ascending);
        some.check().unwrap();
        for (i, &row) in ascending.iter().enumerate() {
            let feat = &some.lang_feat.as_ref().unwrap().values[i * 2..i * 2 + 2];
            assert_eq!(feat[1].to_f32(), row as f32 * 2.0 + 1.0);
        }
        some.select_rows(&[]);
        some.check().unwrap();
        assert!(some.is_empty());
    }

    #[test]
    fn arrays_out_of_step_are_named() {
        type Break = fn(&mut Sample);
        let breaks: [(&str, Break); 6] = [
            ("color", |s| s.color.truncate(1)),
            ("quat", |s| s.quat.push([1.0, 0.0, 0.0, 0.0])),
            ("segment", |s| s.segment = Some(vec![])),
            ("lang_feat", |s| s.lang_feat.as_mut().unwrap().values.truncate(3)),
            ("valid_feat", |s| s.valid_feat = Some(vec![true])),
            ("grid_coord", |s| s.grid_coord.truncate(5)),
        ];
        for (name, damage) in breaks {
            let mut sample = sample();
            sample.check().unwrap();
            damage(&mut sample);
            let error = sample.check().unwrap_err();
            assert!(matches!(error, DataError::Length { field, .. } if field == name), "{error}");
        }
    }
}

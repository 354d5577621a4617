//! Someone whose rows a network shall learn: what it is shown of a scene, and whose row each
//! Gaussian gets.
//!
//! A teacher has voxels and input channels of its own, so it is not asked for rows of a batch but for
//! rows of *Gaussians*. It is shown Gaussians of a sample, says which of its rows each belongs to, and
//! a voxel of the student gets the row of the Gaussian that stands for it. No row is found by
//! distance: where two grids overlap, it is the Gaussians that tell which cells belong together.
//!
//! With [`TeacherView::Augmented`] it is shown what the student's voxels are drawn from: the
//! Gaussians after the augmentation, before the last grid sample, all of them in the cells that are
//! left after crops. So both networks see the same turned, bent and colored piece of the scene, each at
//! its own voxel size. With [`TeacherView::Scene`] it is shown the scene as it was read, once and for
//! all, and its rows follow the Gaussians through whatever is done to them.
//!
//! Scenes that are mixed are taught one by one, as collected features are those of one scene each.
//! A teacher draws no random numbers, so samples are otherwise the same with and without one.

use crate::error::{bad_setting, check_length};
use crate::transforms::TransformConfig;
use crate::{DataError, Sample};
use half::f16;
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use scenesplat_scene::LanguageFeatures;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What a teacher is shown of a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TeacherView {
    /// What the student's voxels are drawn from, augmented and cropped, each time anew.
    #[default]
    Augmented,
    /// The scene as it was read, whole.
    Scene,
}

/// A teacher's rows for Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct TeacherRows {
    /// Its rows, one a voxel of its own, say. `[T, D]`
    pub rows: LanguageFeatures,
    /// The row of each Gaussian, [`NONE`](Self::NONE) where there is none. `[N]`
    pub row_of: Vec<u32>,
}

impl TeacherRows {
    /// The Gaussian has no row.
    pub const NONE: u32 = u32::MAX;

    /// Number of rows.
    pub fn num_rows(&self) -> usize {
        self.rows.values.len() / self.rows.dim.max(1)
    }

    /// Checks that every Gaussian's row is there.
    ///
    /// # Errors
    /// If rows are no multiple of their width, one that is named is none of them, or they are rows of
    /// another number of Gaussians than `gaussians`.
    pub fn check(&self, gaussians: usize) -> Result<(), DataError> {
        let (rows, dim) = (self.num_rows(), self.rows.dim);
        check_length("teacher", rows.saturating_mul(dim), self.rows.values.len())?;
        check_length("teacher", gaussians, self.row_of.len())?;
        let beyond = |&&row: &&u32| row != Self::NONE && row as usize >= rows;
        match self.row_of.iter().find(beyond) {
            Some(&row) => Err(DataError::RowOutOfRange { row: row as usize, rows }),
            None => Ok(()),
        }
    }

    /// The row of a Gaussian, `[D]`.
    pub fn row(&self, gaussian: usize) -> Option<&[f16]> {
        let row = *self.row_of.get(gaussian)? as usize;
        self.rows.values.get(row.checked_mul(self.rows.dim)?..)?.get(..self.rows.dim)
    }
}

/// Someone whose rows a network shall learn.
pub trait SceneTeacher: Send + Sync {
    /// What it is shown.
    fn view(&self) -> TeacherView;

    /// Its rows for the Gaussians of `shown`, which has neither labels nor cells. The same Gaussians
    /// give the same rows, bit for bit.
    ///
    /// # Errors
    /// If it cannot read them, or has no rows for this scene.
    fn teach(&self, shown: Sample) -> Result<TeacherRows, DataError>;
}

/// A teacher and where in the transforms it looks.
#[derive(Clone)]
pub(crate) struct Lesson {
    pub teacher: Arc<dyn SceneTeacher>,
    /// Steps that come after what it is shown; counted from the end, as sources put steps first.
    pub steps_after: usize,
}

/// Number of steps from the last grid sample to the end: where a teacher with
/// [`TeacherView::Augmented`] looks.
///
/// # Errors
/// If there is no grid sample, or a step after it does more than leave Gaussians out or shift all of
/// them: the student would see what the teacher does not.
pub fn steps_after_look(steps: &[TransformConfig]) -> Result<usize, DataError> {
    use TransformConfig as T;
    let Some(at) = steps.iter().rposition(|step| matches!(step, T::GridSample(_))) else {
        return Err(DataError::no_cells("teacher"));
    };
    let seen = |step: &T| {
        matches!(
            step,
            T::GridSample(_) | T::SphereCrop(_) | T::CenterShift(_) | T::RandomDropout(_)
        )
    };
    match steps[at..].iter().find(|step| !seen(step)) {
        None => Ok(steps.len() - at),
        Some(step) => Err(bad_setting(
            "transforms",
            format_args!("{step:?} after the last grid sample"),
            "changes of Gaussians before it, so that the teacher sees them too; sphere_crop, \
             center_shift and random_dropout may follow",
        )),
    }
}

impl Lesson {
    /// Takes what the teacher is shown from a sample, whose rows are numbered from here on.
    pub(crate) fn look(&self, sample: &mut Sample) -> Sample {
        sample.origin_row = Some((0..sample.len() as u32).collect());
        let lang_feat = sample.lang_feat.take();
        let mut shown = sample.clone();
        shown.lang_feat = lang_feat;
        (shown.segment, shown.instance, shown.origin_row) = (None, None, None);
        (shown.labelled_points, shown.full) = (None, None);
        (shown.grid_coord, shown.grid_size) = (Vec::new(), 0.0);
        shown
    }

    /// Gives the finished sample the rows of the teacher, and the scene behind it too, if it is kept.
    pub(crate) fn give(&self, mut shown: Sample, sample: &mut Sample) -> Result<(), DataError> {
        let Some(origin) = sample.origin_row.take() else {
            let help = "let transforms choose rows with Sample::select_rows";
            return Err(DataError::Missing {
                step: "teacher",
                missing: "numbers of its rows",
                help,
            });
        };
        if origin.is_empty() {
            return Ok(());
        }
        let mut now_at: Option<Vec<u32>> = None;
        if self.teacher.view() == TeacherView::Augmented
            && let Some(kept) = rows_in_cells_of(&shown, &origin, sample.grid_size)?
        {
            let mut places = vec![TeacherRows::NONE; shown.len()];
            (0_u32..).zip(&kept).for_each(|(place, &row)| places[row as usize] = place);
            shown.select_rows(&kept);
            now_at = Some(places);
        }
        let count = shown.len();
        let taught = self.teacher.teach(shown)?;
        taught.check(count)?;
        let place = |row: u32| now_at.as_ref().map_or(row, |places| places[row as usize]);
        let dim = taught.rows.dim;
        let mut values = vec![f16::ZERO; origin.len() * dim];
        let mut valid = vec![false; origin.len()];
        for ((&row, out), valid) in
            origin.iter().zip(values.chunks_exact_mut(dim.max(1))).zip(&mut valid)
        {
            if let Some(taught) = taught.row(place(row) as usize) {
                out.copy_from_slice(taught);
                *valid = true;
            }
        }
        sample.lang_feat = Some(LanguageFeatures { values, dim });
        sample.valid_feat = Some(valid);
        if let Some(full) = &mut sample.full {
            let of = |row: &u32| {
                taught.row_of.get(place(*row) as usize).copied().unwrap_or(TeacherRows::NONE)
            };
            let rows = full.origin_row.take().unwrap_or_default();
            let row_of = rows.iter().map(of).collect();
            full.teacher = Some(TeacherRows { rows: taught.rows, row_of });
        }
        Ok(())
    }
}

/// The Gaussians in the cells that the rows `origin` stand for, ascending; `None` if that is all.
fn rows_in_cells_of(
    shown: &Sample,
    origin: &[u32],
    grid_size: f64,
) -> Result<Option<Vec<u32>>, DataError> {
    // The grid sample made the same cells of the same positions.
    let groups = voxel_groups(&shown.coord, grid_size, KeyOrder::Morton)?;
    let mut keep = vec![false; groups.num_voxels()];
    origin.iter().for_each(|&row| keep[groups.inverse[row as usize] as usize] = true);
    if keep.iter().all(|k| *k) {
        return Ok(None);
    }
    let rows = (0_u32..).zip(&groups.inverse).filter(|(_, cell)| keep[**cell as usize]);
    Ok(Some(rows.map(|(row, _)| row).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::at;
    use crate::transforms::{
        CenterShift, GridSample, Keep, RandomFlip, RandomRotate, SphereCrop, build_transforms,
        language_pretraining, validation,
    };
    use crate::{Dataset, SceneDataset, SyntheticRooms};
    use scenesplat_rooms::SyntheticRoomSettings;
    use std::sync::Mutex;

    /// Says of each Gaussian in which of its own cells it is and where it saw it; keeps what it saw.
    struct Surveyor {
        view: TeacherView,
        cell: f32,
        shown: Mutex<Vec<Sample>>,
    }

    impl Surveyor {
        fn new(view: TeacherView, cell: f32) -> Arc<Self> {
            Arc::new(Self { view, cell, shown: Mutex::default() })
        }
    }

    impl SceneTeacher for Surveyor {
        fn view(&self) -> TeacherView {
            self.view
        }
        fn teach(&self, shown: Sample) -> Result<TeacherRows, DataError> {
            // One row a cell along x, named by the cell; the last two Gaussians have none.
            let cell = |c: &[f32; 3]| (c[0] / self.cell).floor();
            let low = shown.coord.iter().map(cell).fold(f32::INFINITY, f32::min);
            let high = shown.coord.iter().map(cell).fold(f32::NEG_INFINITY, f32::max);
            let count = (high - low) as u32 + 1;
            let values = (0..count).flat_map(|k| [low + k as f32, 1.0]).map(f16::from_f32);
            let rows = LanguageFeatures { values: values.collect(), dim: 2 };
            let row_of = shown.coord.iter().map(|c| (cell(c) - low) as u32).collect();
            self.shown.lock().unwrap().push(shown);
            Ok(TeacherRows { rows, row_of })
        }
    }

    fn given(teacher: &Arc<Surveyor>, steps: &[TransformConfig], sample: Sample) -> Sample {
        let steps_after = match teacher.view {
            TeacherView::Augmented => steps_after_look(steps).unwrap(),
            TeacherView::Scene => steps.len(),
        };
        let lesson = Lesson { teacher: Arc::clone(teacher) as _, steps_after };
        let (mut sample, mut rng) = (sample, crate::sample_rng(1, 0, 0));
        let mut shown = None;
        for (i, step) in build_transforms(steps).unwrap().iter().enumerate() {
            if i == steps.len() - lesson.steps_after {
                shown = Some(lesson.look(&mut sample));
            }
            step.apply(&mut sample, &mut rng).unwrap();
        }
        lesson.give(shown.unwrap(), &mut sample).unwrap();
        sample.check().unwrap();
        sample
    }

    fn grid(grid_size: f64) -> TransformConfig {
        GridSample { grid_size, keep: Keep::First, keep_full: true, ..<_>::default() }.into()
    }

    /// Student's cells of 1 m, teacher's of 0.4 m and of 3 m, on Gaussians along a line.
    #[test]
    fn a_voxel_gets_the_row_of_the_gaussian_that_stands_for_it() {
        let x = [0.9, 0.1, 1.3, 1.9, 2.5, 3.1, 3.9, 2.9];
        let scene = at(&x.map(|x| [x, 0.0, 0.0]));
        // First of their cells: 0.9 (cell 0), 1.3 (1), 2.5 (2), 3.1 (3). By hand, x / 0.4 and x / 3.
        for (cell, expected) in [(0.4, [2.0, 3.0, 6.0, 7.0]), (3.0, [0.0, 0.0, 0.0, 1.0])] {
            for view in [TeacherView::Augmented, TeacherView::Scene] {
                let teacher = Surveyor::new(view, cell);
                let sample = given(&teacher, &[grid(1.0)], scene.clone());
                let feat = sample.lang_feat.unwrap();
                let got: Vec<f32> = feat.values.iter().step_by(2).map(|v| v.to_f32()).collect();
                assert_eq!(got, expected, "{view:?} {cell}");
                assert_eq!(sample.valid_feat.unwrap(), [true; 4]);
                // Every Gaussian of the scene behind it has the row of its own cell.
                let full = sample.full.unwrap();
                let taught = full.teacher.unwrap();
                for (row, x) in x.iter().enumerate() {
                    let name = taught.row(row).unwrap()[0].to_f32();
                    assert_eq!(name, (x / cell).floor(), "{view:?} {x}");
                }
            }
        }
    }

    #[test]
    fn the_teacher_sees_the_cells_that_crops_leave_and_all_in_them() {
        // Four cells of two; a crop of two cells around a random one.
        let x = [0.2, 0.8, 1.2, 1.8, 2.2, 2.8, 3.2, 3.8];
        let scene = at(&x.map(|x| [x, 0.0, 0.0]));
        let crop = SphereCrop { point_max: 2, ..<_>::default() }.into();
        let steps = [grid(1.0), crop, CenterShift { apply_z: false }.into()];
        let teacher = Surveyor::new(TeacherView::Augmented, 0.5);
        let sample = given(&teacher, &steps, scene.clone());
        assert_eq!(sample.len(), 2);
        let shown = teacher.shown.lock().unwrap().pop().unwrap();
        let seen: Vec<f32> = shown.coord.iter().map(|c| c[0]).collect();
        let at = x.iter().position(|x| *x == seen[0]).unwrap();
        assert_eq!(seen, x[at..at + 4], "both Gaussians of both cells");
        let feat = sample.lang_feat.unwrap();
        let rows: Vec<f32> = feat.values.iter().step_by(2).map(|v| v.to_f32()).collect();
        assert_eq!(rows, [(x[at] / 0.5).floor(), (x[at + 2] / 0.5).floor()]);
        // With the whole scene in view nothing is cropped for it.
        let teacher = Surveyor::new(TeacherView::Scene, 0.5);
        let same = given(&teacher, &steps, scene);
        assert_eq!(teacher.shown.lock().unwrap()[0].len(), 8);
        assert_eq!(same.coord, sample.coord, "the crop is the same one");
        assert_eq!(same.lang_feat.unwrap(), feat);
    }

    #[test]
    fn the_teacher_sees_the_augmentation_and_draws_nothing() {
        let source = |seed| {
            let settings = SyntheticRoomSettings::with_count(2000, 0);
            Arc::new(SyntheticRooms::new(2, settings, seed).unwrap())
        };
        let steps = language_pretraining(0.3);
        let after = steps_after_look(&steps).unwrap();
        assert_eq!(after, 3, "grid sample, crop, shift");
        let build = || build_transforms(&steps).unwrap();
        let plain = SceneDataset::new(source(4), build(), 5, 3).unwrap();
        let teacher = Surveyor::new(TeacherView::Augmented, 0.2);
        let taught = SceneDataset::new(source(4), build(), 5, 3)
            .unwrap()
            .with_teacher(Arc::clone(&teacher) as _, after);
        for index in 0..6 {
            let mut sample = taught.get(2, index).unwrap();
            let feat = sample.lang_feat.take().unwrap();
            sample.valid_feat = None;
            assert_eq!(sample, plain.get(2, index).unwrap(), "nothing else differs");
            let shown = teacher.shown.lock().unwrap().pop().unwrap();
            assert!(shown.segment.is_none() && shown.len() > sample.len());
            assert_eq!(feat.values.len(), 2 * sample.len());
            // What the student reads is among what the teacher is shown.
            for row in 0..sample.len() {
                let mut places = (0..shown.len()).filter(|&i| shown.color[i] == sample.color[row]);
                assert!(places.any(|i| shown.quat[i] == sample.quat[row]), "row {row}");
            }
        }
        let whole = Surveyor::new(TeacherView::Scene, 0.2);
        let taught =
            SceneDataset::new(source(4), build(), 5, 3).unwrap().with_teacher(whole.clone(), 0);
        taught.get(0, 1).unwrap();
        taught.get(1, 1).unwrap();
        let shown = whole.shown.lock().unwrap();
        assert_eq!(shown[0], shown[1], "the same scene, whatever is done to it afterwards");
    }

    #[test]
    fn steps_that_the_teacher_would_not_see_are_refused() {
        assert_eq!(steps_after_look(&validation(0.1)).unwrap(), 2);
        assert_eq!(steps_after_look(&[grid(0.01), grid(0.02)]).unwrap(), 1);
        let error = steps_after_look(&[RandomFlip::default().into()]).unwrap_err().to_string();
        assert!(error.contains("grid sample"), "{error}");
        let late = [grid(0.1), RandomRotate::default().into()];
        let error = steps_after_look(&late).unwrap_err().to_string();
        assert!(error.contains("RandomRotate") && error.contains("before it"), "{error}");
    }

    #[test]
    fn rows_that_are_not_there_are_an_error() {
        let rows = LanguageFeatures { values: vec![f16::ONE; 4], dim: 2 };
        let of = |row_of: &[u32]| TeacherRows { rows: rows.clone(), row_of: row_of.to_vec() };
        of(&[1, 0, TeacherRows::NONE]).check(3).unwrap();
        assert!(of(&[1, 2]).check(2).is_err());
        assert!(of(&[1]).check(2).is_err());
        assert_eq!(of(&[TeacherRows::NONE]).row(0), None);
        let ragged = TeacherRows {
            rows: LanguageFeatures { values: vec![f16::ONE; 3], dim: 2 },
            row_of: vec![0],
        };
        assert!(ragged.check(1).is_err());
    }
}

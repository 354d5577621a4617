//! [`Views`]

use super::{RatioCrop, TransformConfig, build_transforms};
use crate::error::{check_shares, require};
use crate::rng::below;
use crate::views::{ViewKind, ViewSample};
use crate::{DataError, Sample, SampleRng, Transform};
use serde::{Deserialize, Serialize};

/// Makes several views of the scene, in groups; the last step of a pipeline.
///
/// A group first changes the scene for all its views (`shared`), then cuts each view out of that
/// (`crop`) and changes it on its own (`views`: a list of steps for each). What was done before this
/// step is common to all views, and the places that views are compared by are those that Gaussians
/// have before it.
///
/// # Source
/// `ContrastiveViewsGenerator_SSL` of SceneSplat be9d5e1 (crops shared by a group are a
/// [`RatioCrop`] in `shared`), and `MultiViewGenerator` of Pointcept d74c646 (`crop` with
/// [`CropOrigin::Major`] and [`CropOrigin::Uncovered`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Views {
    /// Groups of views; global ones come before local ones.
    pub groups: Vec<ViewGroup>,
}

/// Views that share some of their changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewGroup {
    /// How much of the scene they show.
    pub kind: ViewKind,
    /// Steps that all of them share, done once.
    #[serde(default)]
    pub shared: Vec<TransformConfig>,
    /// What each is cut out of what is shared; nothing if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop: Option<ViewCrop>,
    /// Steps of each view; as many views as there are lists.
    pub views: Vec<Vec<TransformConfig>>,
}

/// The part of a scene that a view shows: the Gaussians nearest to one of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewCrop {
    /// Lowest and highest share of `point_max` Gaussians, or of all where there are fewer.
    pub ratio: [f64; 2],
    /// What it is a share of, where there are as many.
    pub point_max: usize,
    /// Which Gaussian is in the middle.
    #[serde(default)]
    pub center: CropOrigin,
}

/// Where the middle of a view is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CropOrigin {
    /// Anywhere.
    #[default]
    Anywhere,
    /// In the first view of all, the major one; the major view itself is anywhere.
    Major,
    /// In the major view, where no earlier view of the group is.
    Uncovered,
}

impl Views {
    /// Kinds of the views, in order.
    pub fn kinds(&self) -> Vec<ViewKind> {
        let groups = self.groups.iter();
        groups.flat_map(|group| std::iter::repeat_n(group.kind, group.views.len())).collect()
    }
}

impl ViewGroup {
    fn check(&self) -> Result<(), DataError> {
        require(!self.views.is_empty(), "views.groups.views", 0, "one list of steps or more")?;
        if let Some(crop) = &self.crop {
            check_shares("views.groups.crop.ratio", crop.ratio)?;
            require(crop.point_max > 0, "views.groups.crop.point_max", 0, "1 or more")?;
        }
        build_transforms(&self.shared)?;
        for steps in &self.views {
            build_transforms(steps)?;
            if !steps.iter().any(|step| matches!(step, TransformConfig::GridSample(_))) {
                let help = "give the steps of each view a grid sample";
                return Err(DataError::Missing { step: "views", missing: "cells", help });
            }
        }
        let mut steps = self.shared.iter().chain(self.views.iter().flatten());
        let nested = steps.any(|step| matches!(step, TransformConfig::Views(_)));
        require(!nested, "views.groups", "views of views", "other steps")
    }
}

/// Rows of the scene that views have taken.
#[derive(Default)]
struct Taken {
    /// Whether the major view has each row; empty before there is one.
    major: Vec<bool>,
    /// Whether an earlier view of the group has it.
    group: Vec<bool>,
}

impl ViewCrop {
    fn cut(&self, sample: &mut Sample, taken: &mut Taken, rng: &mut SampleRng) {
        if sample.is_empty() {
            return;
        }
        let crop = RatioCrop { ratio: self.ratio, point_max: self.point_max };
        let origin = sample.origin_row.as_deref().unwrap_or_default();
        let has = |set: &[bool], row: u32| {
            let at = origin.get(row as usize).and_then(|&at| set.get(at as usize));
            at.copied().unwrap_or(false)
        };
        let in_major = |&row: &u32| self.center == CropOrigin::Anywhere || has(&taken.major, row);
        let free = |&row: &u32| self.center != CropOrigin::Uncovered || !has(&taken.group, row);
        let all = 0..sample.len() as u32;
        let mut middle: Vec<u32> = all.clone().filter(in_major).filter(free).collect();
        if middle.is_empty() {
            // All is covered, or this is the major view.
            middle = all.clone().filter(in_major).collect();
        }
        if middle.is_empty() {
            middle = all.collect();
        }
        let center = sample.coord[middle[below(rng, middle.len() as u32) as usize] as usize];
        let rows = crop.rows(sample, center, rng);
        sample.select_rows(&rows);
    }
}

impl Taken {
    fn note(&mut self, sample: &Sample, rows: usize) {
        let first = self.major.is_empty();
        self.group.resize(rows, false);
        if first {
            self.major = vec![false; rows];
        }
        for &row in sample.origin_row.iter().flatten().filter(|row| **row != Sample::ADDED) {
            self.group[row as usize] = true;
            if first {
                self.major[row as usize] = true;
            }
        }
    }
}

impl Transform for Views {
    fn check(&self) -> Result<(), DataError> {
        let kinds = self.kinds();
        let ok = kinds.first() == Some(&ViewKind::Global);
        let value = format!("{} views", kinds.len());
        require(ok, "views.groups", value, "a global view first")?;
        let ok = !kinds.windows(2).any(|k| k == [ViewKind::Local, ViewKind::Global]);
        require(ok, "views.groups", "a global view after a local one", "global views first")?;
        self.groups.iter().try_for_each(ViewGroup::check)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        let mut scene = sample.clone();
        (scene.labelled_points, scene.full) = (None, None);
        (scene.grid_coord, scene.grid_size) = (Vec::new(), 0.0);
        scene.origin_row = Some((0..scene.len() as u32).collect());
        let origin = scene.coord.clone();
        let mut taken = Taken::default();
        let mut views = Vec::new();
        for group in &self.groups {
            let mut shared = scene.clone();
            for step in build_transforms(&group.shared)? {
                step.apply(&mut shared, rng)?;
            }
            taken.group.clear();
            for steps in &group.views {
                let mut view = shared.clone();
                if let Some(crop) = &group.crop {
                    crop.cut(&mut view, &mut taken, rng);
                }
                taken.note(&view, origin.len());
                for step in build_transforms(steps)? {
                    step.apply(&mut view, rng)?;
                }
                view.full = None;
                view.check()?;
                let rows = view.origin_row.iter().flatten();
                let place = |row: &u32| origin.get(*row as usize).copied().unwrap_or([f32::NAN; 3]);
                let origin = rows.map(place).collect();
                views.push(ViewSample { kind: group.kind, sample: view, origin });
            }
        }
        // What is left has no rows: views are all that a network sees.
        sample.select_rows(&[]);
        (sample.grid_coord, sample.labelled_points) = (Vec::new(), None);
        sample.views = views;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{at, covariance, difference, room};
    use crate::transforms::{
        CenterShift, ColorJitter, GridSample, RandomFlip, RandomRotate, RandomScale,
        self_distillation, self_supervised,
    };
    use crate::{InputFeatures, collate_samples, sample_rng};

    fn made(steps: &[TransformConfig], sample: &Sample, seed: u64) -> Sample {
        let mut sample = sample.clone();
        let mut rng = sample_rng(seed, 0, 0);
        for step in build_transforms(steps).unwrap() {
            step.apply(&mut sample, &mut rng).unwrap();
        }
        sample
    }

    fn two_and_two(extra: &[TransformConfig]) -> Views {
        let each = |color: bool| {
            let mut steps = extra.to_vec();
            if color {
                steps.push(ColorJitter::default().into());
            }
            steps.push(GridSample { grid_size: 0.05, ..GridSample::default() }.into());
            steps.push(CenterShift { apply_z: false }.into());
            steps
        };
        let crop = |ratio, center| Some(ViewCrop { ratio, point_max: 2000, center });
        Views {
            groups: vec![
                ViewGroup {
                    kind: ViewKind::Global,
                    shared: vec![],
                    crop: crop([0.4, 1.0], CropOrigin::Major),
                    views: vec![each(false), each(true)],
                },
                ViewGroup {
                    kind: ViewKind::Local,
                    shared: vec![],
                    crop: crop([0.1, 0.4], CropOrigin::Uncovered),
                    views: vec![each(true), each(true)],
                },
            ],
        }
    }

    #[test]
    fn views_know_where_their_gaussians_come_from() {
        let scene = room(3000);
        let turn = RandomRotate { angle: [0.4, 0.6], probability: 1.0, ..RandomRotate::default() };
        let grow = RandomScale { factor: [1.05, 1.1] };
        let views = two_and_two(&[turn.into(), grow.into(), RandomFlip::default().into()]);
        let out = made(&[views.into()], &scene, 5);
        assert_eq!(out.views.len(), 4);
        assert!(out.is_empty());
        for view in &out.views {
            let rows = view.sample.origin_row.as_ref().unwrap();
            assert_eq!(rows.len(), view.sample.len());
            // Distances between Gaussians grow by one factor, and sizes by the same.
            let first = rows[0] as usize;
            let factor = view.sample.scale[0][0] / scene.scale[first][0];
            assert!((1.05..1.1001).contains(&factor), "{factor}");
            let apart = |a: [f32; 3], b: [f32; 3]| {
                a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
            };
            for (i, &row) in rows.iter().enumerate().step_by(37) {
                let row = row as usize;
                assert_eq!(view.origin[i], scene.coord[row]);
                let there = apart(scene.coord[row], scene.coord[first]) * factor;
                let here = apart(view.sample.coord[i], view.sample.coord[0]);
                assert!((there - here).abs() < 1e-4, "{there} {here}");
                // The covariance turned with the places: its trace grows by the square.
                let trace = |c: [[f64; 3]; 3]| c[0][0] + c[1][1] + c[2][2];
                let before = covariance(scene.quat[row], scene.scale[row]);
                let after = covariance(view.sample.quat[i], view.sample.scale[i]);
                let f = f64::from(factor).powi(2);
                assert!((trace(before) * f - trace(after)).abs() < 1e-6 * trace(after).max(1.0));
                // Turned by about a quarter about z, the upright part stays.
                assert!((before[2][2] * f - after[2][2]).abs() < 1e-6);
                assert!(difference(before, before) == 0.0);
            }
        }
    }

    #[test]
    fn sizes_and_places_of_views() {
        let scene = room(3000);
        for seed in 0..10 {
            let out = made(&[two_and_two(&[]).into()], &scene, seed);
            let rows = |i: usize| out.views[i].sample.origin_row.clone().unwrap();
            let within = |a: &[u32], b: &[u32]| {
                a.iter().filter(|row| b.contains(row)).count() as f64 / a.len() as f64
            };
            let [major, second, local, other] = [rows(0), rows(1), rows(2), rows(3)];
            // Cells leave out some, so counts are at most the share of 2000.
            assert!(major.len() <= 2000 && local.len() <= 800 && other.len() <= 800);
            assert!(within(&second, &major) > 0.0 && within(&local, &major) > 0.0);
            assert_eq!(out.views[2].kind, ViewKind::Local);
        }
    }

    #[test]
    fn views_depend_on_seed_epoch_and_scene_alone() {
        let scene = room(2000);
        let steps: Vec<TransformConfig> = vec![two_and_two(&[]).into()];
        assert_eq!(made(&steps, &scene, 1), made(&steps, &scene, 1));
        assert_ne!(made(&steps, &scene, 1), made(&steps, &scene, 2));
    }

    #[test]
    fn batches_hold_view_by_view_and_leave_empty_scenes_out() {
        let steps: Vec<TransformConfig> = vec![two_and_two(&[]).into()];
        let scenes = [room(1500), at(&[]), at(&[[0.3; 3]]), room(900)];
        let samples: Vec<Sample> =
            (0_u64..).zip(&scenes).map(|(i, s)| made(&steps, s, i)).collect();
        let wanted: Vec<Vec<[f32; 3]>> = (0..4)
            .map(|v| {
                [0, 2, 3].iter().flat_map(|&s: &usize| samples[s].views[v].origin.clone()).collect()
            })
            .collect();
        let batch = collate_samples(samples, &InputFeatures::default()).unwrap();
        assert_eq!(batch.views.len(), 4);
        assert!(!batch.is_empty());
        for (view, origin) in batch.views.iter().zip(&wanted) {
            assert_eq!(view.batch.offsets.len(), 4, "three scenes show something");
            assert_eq!(&view.origin, origin);
            assert_eq!(view.batch.len(), view.origin.len());
            assert_eq!(view.batch.grid_coord.len(), view.batch.len());
        }
        let none = collate_samples(vec![made(&steps, &at(&[]), 0)], &InputFeatures::default());
        assert!(none.unwrap().is_empty());
        // One with views beside one without.
        let mixed = vec![made(&steps, &room(500), 0), at(&[])];
        let error = collate_samples(mixed, &InputFeatures::default()).unwrap_err();
        assert!(format!("{error:?}").contains("views"), "{error:?}");
    }

    #[test]
    fn presets_make_views_of_any_scene() {
        for steps in [self_supervised(0.05), self_distillation(0.05)] {
            for scene in [room(3000), at(&[]), at(&[[0.2; 3]]), at(&[[0.2; 3]; 2])] {
                let out = made(&steps, &scene, 3);
                let kinds: Vec<ViewKind> = out.views.iter().map(|v| v.kind).collect();
                assert_eq!(kinds.iter().filter(|k| **k == ViewKind::Global).count(), 2);
                for view in &out.views {
                    assert_eq!(view.sample.is_empty(), scene.is_empty());
                    InputFeatures::default().sample_rows(&view.sample).unwrap();
                }
            }
        }
    }

    #[test]
    fn settings_that_make_no_views_are_refused() {
        let good = two_and_two(&[]);
        let refused = |change: &dyn Fn(&mut Views)| {
            let mut views = good.clone();
            change(&mut views);
            format!("{:?}", views.check().unwrap_err())
        };
        assert!(refused(&|v| v.groups.clear()).contains("global"));
        assert!(refused(&|v| v.groups.reverse()).contains("global"));
        assert!(refused(&|v| v.groups[0].views.clear()).contains("views"));
        assert!(refused(&|v| v.groups[1].views[0].clear()).contains("grid sample"));
        assert!(
            refused(&|v| v.groups[0].shared.push(good.clone().into())).contains("views of views")
        );
        assert!(
            refused(&|v| v.groups[0].crop.as_mut().unwrap().ratio = [1.0, 0.5]).contains("ratio")
        );
        good.check().unwrap();
    }
}

//! Cameras for a scene without photos.

use crate::choice::{Shown, choose_pictures};
use crate::{CollectError, seen_in};
use glam::{DMat3, DVec3};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_rasterizer::{Gaussians, View};
use scenesplat_scene::quantile::quantile;
use scenesplat_scene::{Camera, Up};

/// Opacity from which on a Gaussian is in the way.
const SOLID: f32 = 0.3;
/// Part of the Gaussians, at each end of an axis, that may be stray.
const STRAY: f64 = 0.01;
/// Places along each level axis that are tried, and heights as parts of the scene's.
const PLACES: usize = 9;
const HEIGHTS: [f64; 4] = [0.35, 0.5, 0.65, 0.8];
/// Views from inside that show less than this part of a scene may be outdone by views from around it.
const INSIDE: f64 = 0.5;
/// Space that a camera needs around it, as a part of the shortest side of the scene.
const CLEARANCE: f64 = 0.06;
/// Directions that are tried at a place: around, and down, level and up (radians).
const AROUND: usize = 8;
const PITCHES: [f64; 3] = [-0.6, -0.15, 0.35];
/// Places whose views let this part of the light through are outside.
const OPEN: f64 = 0.4;
/// Part of a view that may be nearer than the clearance.
const TOO_NEAR: f64 = 0.1;

/// Which cameras to plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewPlanSettings {
    /// Number of cameras, at least 1; fewer come out where more would show nothing.
    pub count: usize,
    /// Width and height of the pictures.
    pub size: [u32; 2],
    /// Angle of view across the shorter side, degrees, above 0 and below 180.
    pub fov: f64,
    /// Which way is up.
    pub up: Up,
}

/// Cameras, and what they are worth.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewPlan {
    /// Named `view_000`, …, in the order in which they were picked: the first ones show most.
    pub cameras: Vec<Camera>,
    /// Part of the Gaussians (of a sample) that at least one camera shows, 0 to 1.
    pub seen: f64,
    /// Views that were tried.
    pub tried: usize,
    /// Of these, views that show nothing, or are inside or too near to something.
    pub refused: usize,
    /// Whether the cameras are around the scene: no free place is inside, or less is seen from there.
    pub outside: bool,
}

/// Plans cameras: free places inside the scene, as far apart as can be, several directions at each; views from inside
/// geometry, too near to it, or at nothing are refused; of the others those are picked that show most that the others
/// do not ([`choose_pictures`]). Where nothing is free inside, cameras stand around the scene.
///
/// Costs up to 600 small renders.
///
/// # Errors
/// If a setting is out of range, or no view shows anything.
pub fn plan_views(
    gaussians: &Gaussians,
    settings: &ViewPlanSettings,
) -> Result<ViewPlan, CollectError> {
    settings.check()?;
    let planner = Planner::of(gaussians, *settings)?;
    let inside = planner.free_places();
    let mut plan = planner.pick(&planner.around_places(&inside), false)?;
    if plan.cameras.is_empty() || plan.seen < INSIDE {
        // A thing alone has no inside: places in its box see little of it.
        let around = planner.pick(&planner.orbits(), true)?;
        let (tried, refused) = (plan.tried + around.tried, plan.refused + around.refused);
        if plan.cameras.is_empty() || around.seen > plan.seen {
            plan = around;
        }
        (plan.tried, plan.refused) = (tried, refused);
    }
    if plan.cameras.is_empty() {
        let problem = format!("none of {} views of the scene shows anything", plan.tried);
        return Err(CollectError::argument("views", problem));
    }
    Ok(plan)
}

impl ViewPlanSettings {
    fn check(&self) -> Result<(), CollectError> {
        let [width, height] = self.size;
        if self.count == 0 || width < 16 || height < 16 {
            let problem =
                format!("{} of {width}×{height}; at least 1 of 16×16 is expected", self.count);
            return Err(CollectError::argument("views", problem));
        }
        if !(self.fov > 0.0 && self.fov < 180.0) {
            let problem = format!("is {}; above 0 and below 180 degrees is expected", self.fov);
            return Err(CollectError::argument("angle of view", problem));
        }
        Ok(())
    }
}

struct Planner<'a> {
    gaussians: &'a Gaussians,
    settings: ViewPlanSettings,
    /// Of the Gaussians that are in the way, upright.
    tree: KdTree,
    low: DVec3,
    high: DVec3,
    /// From the scene's axes to upright ones.
    upright: DMat3,
}

/// A camera to be: upright place, azimuth and pitch in radians.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    eye: DVec3,
    azimuth: f64,
    pitch: f64,
    /// Number of its place.
    place: usize,
}

impl<'a> Planner<'a> {
    fn of(gaussians: &'a Gaussians, settings: ViewPlanSettings) -> Result<Self, CollectError> {
        let upright = DMat3::from_cols_array_2d(&settings.up.upright()).transpose();
        let turn = |p: &[f32; 3]| (upright * DVec3::from(p.map(f64::from))).as_vec3().to_array();
        let is_finite = |p: &[f32; 3]| p.iter().all(|v| v.is_finite());
        let rows = gaussians.means.iter().zip(&gaussians.opacities);
        let solid: Vec<[f32; 3]> =
            rows.filter(|(p, o)| **o >= SOLID && is_finite(p)).map(|(p, _)| turn(p)).collect();
        if solid.is_empty() {
            let problem = format!("no Gaussian has an opacity of {SOLID} or more");
            return Err(CollectError::argument("views", problem));
        }
        let mut low = [0.0; 3];
        let mut high = [0.0; 3];
        for axis in 0..3 {
            let mut values: Vec<f32> = solid.iter().map(|p| p[axis]).collect();
            low[axis] = f64::from(quantile(&mut values, STRAY).unwrap_or_default());
            high[axis] = f64::from(quantile(&mut values, 1.0 - STRAY).unwrap_or_default());
        }
        let tree =
            KdTree::new(&solid).map_err(|e| CollectError::argument("scene", e.to_string()))?;
        Ok(Self { gaussians, settings, tree, low: low.into(), high: high.into(), upright })
    }

    fn clearance(&self) -> f64 {
        let sides = self.high - self.low;
        // Of something flat the longest side says more.
        CLEARANCE * sides.min_element().max(0.1 * sides.max_element())
    }

    /// Free places in the box, at first the one with the most space, then each time the one farthest from the others.
    fn free_places(&self) -> Vec<DVec3> {
        let mut free = Vec::new();
        for part in HEIGHTS {
            for i in 0..PLACES * PLACES {
                let at = |step: usize, a: usize| {
                    let share = (step as f64 + 0.5) / PLACES as f64;
                    self.low[a] + share * (self.high[a] - self.low[a])
                };
                let z = self.low[2] + part * (self.high[2] - self.low[2]);
                let place = DVec3::new(at(i % PLACES, 0), at(i / PLACES, 1), z);
                let nearest = self.tree.nearest(place.as_vec3().to_array(), 1);
                let space = nearest.first().map_or(0.0, |n| n.distance_squared.sqrt());
                if space >= self.clearance() {
                    free.push((place, space));
                }
            }
        }
        let wanted = self.settings.count.div_ceil(2).clamp(8, 24);
        let mut chosen: Vec<DVec3> = Vec::new();
        while chosen.len() < wanted {
            let score = |(place, space): &(DVec3, f64)| match chosen.is_empty() {
                true => *space,
                false => {
                    let apart = chosen.iter().map(|c| c.distance_squared(*place));
                    apart.fold(f64::INFINITY, f64::min)
                }
            };
            let mut best: Option<(DVec3, f64)> = None;
            for candidate in &free {
                let score = score(candidate);
                if score > best.map_or(0.0, |(_, s)| s) {
                    best = Some((candidate.0, score));
                }
            }
            let Some((place, _)) = best else { break };
            chosen.push(place);
        }
        chosen
    }

    fn around_places(&self, places: &[DVec3]) -> Vec<Candidate> {
        let mut out = Vec::new();
        for (place, &eye) in places.iter().enumerate() {
            for turn in 0..AROUND {
                for (row, pitch) in PITCHES.into_iter().enumerate() {
                    // Rows are turned against each other: together they leave no gaps.
                    let step = turn as f64 + row as f64 / PITCHES.len() as f64;
                    let azimuth = std::f64::consts::TAU * step / AROUND as f64;
                    out.push(Candidate { eye, azimuth, pitch, place });
                }
            }
        }
        out
    }

    /// Cameras around the box, directed at its middle.
    fn orbits(&self) -> Vec<Candidate> {
        let middle = (self.low + self.high) / 2.0;
        let half = (self.high - self.low).length() / 2.0;
        let mut out = Vec::new();
        for (ring, pitch) in [-0.25f64, -0.7, 0.2].into_iter().enumerate() {
            for (row, distance) in [2.2, 1.4].into_iter().enumerate() {
                for turn in 0..16 {
                    let step = turn as f64 + (ring + row) as f64 / 3.0;
                    let azimuth = std::f64::consts::TAU * step / 16.0;
                    let eye = middle - distance * half * direction(azimuth, pitch);
                    let place = out.len();
                    out.push(Candidate { eye, azimuth, pitch, place });
                }
            }
        }
        out
    }

    fn camera(&self, candidate: &Candidate, name: String, size: [u32; 2]) -> Camera {
        let forward = direction(candidate.azimuth, candidate.pitch);
        let right = DVec3::new(candidate.azimuth.sin(), -candidate.azimuth.cos(), 0.0);
        let back = self.upright.transpose();
        let axes = [right, forward.cross(right), forward].map(|axis| back * axis);
        let eye = back * candidate.eye;
        Camera::pinhole(name, size, self.settings.fov, eye, axes)
    }

    fn pick(&self, candidates: &[Candidate], outside: bool) -> Result<ViewPlan, CollectError> {
        let clearance = self.clearance() as f32;
        let mut shown = Vec::with_capacity(candidates.len());
        // Light that passes the views of each place.
        let mut open: Vec<(f64, usize)> = Vec::new();
        let mut refused = 0;
        let mut things = 0;
        for candidate in candidates {
            let camera = self.camera(candidate, String::new(), self.settings.size);
            let seen = seen_in(self.gaussians, &View::from_camera(&camera)?, clearance)?;
            things = seen.sampled;
            open.resize(open.len().max(candidate.place + 1), (0.0, 0));
            open[candidate.place].0 += f64::from(seen.open);
            open[candidate.place].1 += 1;
            let good = f64::from(seen.near) <= TOO_NEAR && f64::from(seen.open) < 0.95;
            refused += usize::from(!good);
            shown.push(Shown { things: if good { seen.rows } else { Vec::new() }, quality: 1.0 });
        }
        if !outside {
            // Whoever stands outside sees mostly nothing.
            for (candidate, shown) in candidates.iter().zip(&mut shown) {
                let (sum, count) = open[candidate.place];
                if sum / count as f64 > OPEN && !shown.things.is_empty() {
                    shown.things.clear();
                    refused += 1;
                }
            }
        }
        let picked = choose_pictures(&shown, things, self.settings.count);
        let mut seen = vec![false; things];
        picked.iter().flat_map(|&i| &shown[i].things).for_each(|&t| seen[t as usize] = true);
        let name = |(number, &i): (usize, &usize)| {
            self.camera(&candidates[i], format!("view_{number:03}"), self.settings.size)
        };
        Ok(ViewPlan {
            cameras: picked.iter().enumerate().map(name).collect(),
            seen: seen.iter().filter(|s| **s).count() as f64 / things.max(1) as f64,
            tried: candidates.len(),
            refused,
            outside,
        })
    }
}

/// Unit vector of an azimuth and a pitch, z up.
fn direction(azimuth: f64, pitch: f64) -> DVec3 {
    DVec3::new(azimuth.cos() * pitch.cos(), azimuth.sin() * pitch.cos(), pitch.sin())
}

#[cfg(test)]
mod by_hand;
#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use scenesplat_rooms::{SyntheticRoomSettings, generate};

    fn settings(count: usize) -> ViewPlanSettings {
        ViewPlanSettings { count, size: [96, 72], fov: 75.0, up: Up::PLUS_Z }
    }

    #[test]
    fn cameras_stand_free_in_a_room_and_show_most_of_it() {
        let wanted = SyntheticRoomSettings {
            num_gaussians: Some(8000),
            points_share: 0.0,
            ..SyntheticRoomSettings::default()
        };
        let room = generate(&wanted).unwrap();
        let gaussians = Gaussians::from_scene(&room.scene).unwrap();
        let plan = plan_views(&gaussians, &settings(16)).unwrap();
        assert_eq!((plan.cameras.len(), plan.outside), (16, false));
        // What hides under and behind furniture is seen by nobody.
        assert!(plan.seen > 0.6, "{plan:?}");
        for camera in &plan.cameras {
            let c = camera.centre();
            assert!((0..3).all(|a| c[a] > 0.0 && c[a] < f64::from(room.size[a])), "{c:?}");
            let solid =
                room.scene.coord.iter().zip(&gaussians.opacities).filter(|(_, o)| **o >= SOLID);
            let nearest = solid
                .map(|(p, _)| (0..3).map(|k| (f64::from(p[k]) - c[k]).powi(2)).sum::<f64>())
                .fold(f64::INFINITY, f64::min);
            assert!(nearest.sqrt() > 0.1, "{} is {} from something", camera.name, nearest.sqrt());
            let mut checked = camera.clone();
            checked.check(std::path::Path::new("plan")).unwrap();
        }
        // The first ones show most: a part of the plan is a plan.
        let few = plan_views(&gaussians, &settings(4)).unwrap();
        assert!(few.seen > 0.5 * plan.seen && few.seen < plan.seen, "{few:?}");
        assert_eq!(plan_views(&gaussians, &settings(16)).unwrap(), plan);
    }

    #[test]
    fn a_thing_alone_is_looked_at_from_around() {
        // A ball without an inside to stand in.
        let mut means = Vec::new();
        for i in 0..2000 {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 2000.0;
            let turn = 2.399_963 * i as f32;
            let r = (1.0 - z * z).sqrt();
            let shell = 0.1 + 0.9 * ((i % 10) as f32 / 9.0);
            means.push([r * turn.cos(), r * turn.sin(), z].map(|v| v * shell));
        }
        let n = means.len();
        let ball = Gaussians {
            means,
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            scales: vec![[0.08; 3]; n],
            opacities: vec![0.9; n],
            sh: vec![0.0; 3 * n],
            sh_degree: 0,
        };
        let plan = plan_views(&ball, &settings(8)).unwrap();
        assert!(plan.outside && plan.cameras.len() == 8, "{plan:?}");
        for camera in &plan.cameras {
            assert!(camera.centre().iter().map(|v| v * v).sum::<f64>().sqrt() > 1.2);
            assert!(camera.contains(camera.project([0.0; 3]).unwrap()));
        }
        let clear = Gaussians { opacities: vec![0.01; n], ..ball };
        assert!(plan_views(&clear, &settings(8)).unwrap_err().to_string().contains("opacity"));
        let bad = ViewPlanSettings { fov: f64::NAN, ..settings(8) };
        assert!(plan_views(&clear, &bad).unwrap_err().to_string().contains("angle of view"));
    }

    #[test]
    fn the_angle_of_view_is_across_the_shorter_side() {
        // The corners of a cube, and a camera that need not see them.
        let means: Vec<[f32; 3]> =
            (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(|v| v as f32)).collect();
        let cube = Gaussians {
            means,
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 8],
            scales: vec![[0.1; 3]; 8],
            opacities: vec![0.9; 8],
            sh: vec![0.0; 3 * 8],
            sh_degree: 0,
        };
        let planner = Planner::of(&cube, ViewPlanSettings { fov: 90.0, ..settings(1) }).unwrap();
        let candidate = Candidate { eye: DVec3::ZERO, azimuth: 0.0, pitch: 0.0, place: 0 };
        // Half of 90° has the tangent 1: the focal length is half of the shorter side, which is 100 pixels.
        for size in [[200, 100], [100, 200], [100, 100]] {
            let camera = planner.camera(&candidate, String::new(), size);
            assert!((camera.fx - 50.0).abs() < 1e-9, "{size:?}: {}", camera.fx);
            assert!((camera.fy - 50.0).abs() < 1e-9, "{size:?}: {}", camera.fy);
        }
    }
}

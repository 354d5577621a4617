//! How well the cameras saw the surfaces.

use crate::frame::TrainingFrame;
use glam::{DMat3, DVec3};
use serde::Serialize;
use std::collections::BTreeMap;

/// Side of a voxel of surface, units of the scene.
const VOXEL: f64 = 0.05;
/// Views that a voxel should have …
const VIEWS: u16 = 3;
/// … with at least this angle between two of them, degrees.
const SPREAD: f64 = 15.0;
/// Step from a pixel to the next that counts, along rows and columns.
const STRIDE: usize = 8;

/// Coverage of the measured surfaces.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Coverage {
    /// Voxels of 5 cm that a depth lies in.
    pub voxels: usize,
    /// Part of them seen by at least 3 views, two of them 15° apart. 0 to 1
    pub well_seen: f64,
    /// Part of them seen by fewer than 3 views: holes. 0 to 1
    pub holes: f64,
}

/// A voxel's views.
struct Seen {
    views: u16,
    last: usize,
    first: DVec3,
    apart: bool,
}

/// Measures coverage from depths; `None` if there is none.
pub fn coverage(frames: &[TrainingFrame]) -> Option<Coverage> {
    let mut voxels: BTreeMap<[i32; 3], Seen> = BTreeMap::new();
    let wide = SPREAD.to_radians().cos();
    for (number, frame) in frames.iter().enumerate() {
        let Some(depth) = &frame.depth else { continue };
        let (v, eye) = (&frame.view, DVec3::from(frame.view.centre().map(f64::from)));
        // The rows of the rotation are the columns of its inverse.
        let to_world = v.world_to_camera.map(|[x, y, z, _]| [x, y, z].map(f64::from));
        let to_world = DMat3::from_cols_array_2d(&to_world);
        for y in (STRIDE / 2..v.height as usize).step_by(STRIDE) {
            for x in (STRIDE / 2..v.width as usize).step_by(STRIDE) {
                let z = f64::from(depth[y * v.width as usize + x]);
                if !(z > 0.01 && z.is_finite()) {
                    continue;
                }
                let camera = DVec3::new(
                    (x as f64 + 0.5 - f64::from(v.cx)) / f64::from(v.fx) * z,
                    (y as f64 + 0.5 - f64::from(v.cy)) / f64::from(v.fy) * z,
                    z,
                );
                let away = to_world * camera;
                let cell = ((eye + away) / VOXEL).floor().to_array().map(|v| v as i32);
                let ray = away / away.length();
                let seen = voxels.entry(cell).or_insert(Seen {
                    views: 0,
                    last: usize::MAX,
                    first: ray,
                    apart: false,
                });
                if seen.last != number {
                    seen.last = number;
                    seen.views = seen.views.saturating_add(1);
                    seen.apart |= seen.first.dot(ray) <= wide;
                }
            }
        }
    }
    if voxels.is_empty() {
        return None;
    }
    let n = voxels.len();
    let well = voxels.values().filter(|s| s.views >= VIEWS && s.apart).count();
    let few = voxels.values().filter(|s| s.views < VIEWS).count();
    Some(Coverage { voxels: n, well_seen: well as f64 / n as f64, holes: few as f64 / n as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::tests::{self, view};

    /// A wall at z = 1, seen from (x, 0, −2).
    fn frame(x: f32, depth: Option<f32>) -> TrainingFrame {
        let mut view = view(64, 48);
        view.world_to_camera[0][3] = -x;
        tests::frame(view, depth)
    }

    #[test]
    fn views_and_their_angles_count() {
        assert_eq!(coverage(&[frame(0.0, None)]), None);
        let one = coverage(&[frame(0.0, Some(3.0))]).unwrap();
        assert_eq!((one.holes, one.well_seen), (1.0, 0.0));
        // The same three times: enough views, no angle.
        let same = coverage(&[0; 3].map(|_| frame(0.0, Some(3.0)))).unwrap();
        assert_eq!((same.holes, same.well_seen), (0.0, 0.0));
        // 0.75 apart at distance 3, whole steps of 8 pixels at 64 per unit: 14° each, 28° in all.
        let steps = [-0.75, 0.0, 0.75].map(|x| frame(x, Some(3.0)));
        let apart = coverage(&steps).unwrap();
        assert!(apart.well_seen > 0.1 && apart.holes < 0.9, "{apart:?}");
    }

    #[test]
    fn cameras_that_turn_about_a_point_see_it() {
        // Pictures of which one pixel is looked at; its ray goes through the middle. From places on a circle about the
        // point, turned towards it, each sees it 3 away.
        let turned = |angle: f32| {
            let (sin, cos) = angle.sin_cos();
            let mut view = view(8, 8);
            (view.cx, view.cy) = (4.5, 4.5);
            // Rows are the camera's axes, which are turned about y.
            let axes = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
            let eye = [0, 1, 2].map(|k| [0.02, 0.02, 1.02][k] - 3.0 * axes[2][k]);
            view.world_to_camera =
                axes.map(|a| [a[0], a[1], a[2], -(a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2])]);
            tests::frame(view, Some(3.0))
        };
        let found = coverage(&[-0.35, -0.15, 0.0, 0.15, 0.35].map(turned)).unwrap();
        assert_eq!(found, Coverage { voxels: 1, well_seen: 1.0, holes: 0.0 });
    }

    #[test]
    fn views_and_angles_are_those_of_every_eighth_pixel() {
        // Turned cameras about walls at several depths; one depth of a pixel that counts is unknown, one too near.
        let made = |i: usize| {
            let (sin, cos) = ([-0.33f32, -0.2, 0.03, 0.12, -0.02, 0.3][i]).sin_cos();
            let axes = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
            let mut v = view(44, 28);
            // 0.7 before a place that is not the same for all.
            let eye = [0, 1, 2].map(|k| [0.1 * (i / 4) as f32, 0.02, 1.02][k] - 0.7 * axes[2][k]);
            v.world_to_camera =
                axes.map(|a| [a[0], a[1], a[2], -(a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2])]);
            (v.fx, v.fy, v.cx, v.cy) = (150.0, 110.0, 20.25, 15.5);
            let mut frame = tests::frame(v, Some(0.7 + 0.01 * (i % 2) as f32));
            let depth = frame.depth.as_mut().unwrap();
            depth[4 * 44 + 12 + 8 * (i % 3)] = [f32::NAN, 0.01][i % 2];
            frame
        };
        let frames: Vec<_> = (0..6).map(made).chain([frame(0.0, None)]).collect();
        // For each voxel the first ray of each frame that sees it.
        let mut rays: BTreeMap<[i64; 3], Vec<(usize, [f64; 3])>> = BTreeMap::new();
        for (number, f) in frames.iter().enumerate().filter(|(_, f)| f.depth.is_some()) {
            let m = f.view.world_to_camera.map(|r| r.map(f64::from));
            for i in (0..44 * 28).filter(|i| i % 44 % 8 == 4 && i / 44 % 8 == 4) {
                let z = f64::from(f.depth.as_ref().unwrap()[i]);
                if z.is_nan() || z <= f64::from(0.01f32) {
                    continue;
                }
                let x = ((i % 44) as f64 + 0.5 - 20.25) / 150.0 * z;
                let y = ((i / 44) as f64 + 0.5 - 15.5) / 110.0 * z;
                let turn = |p: [f64; 3]| {
                    [0, 1, 2].map(|k| m[0][k] * p[0] + m[1][k] * p[1] + m[2][k] * p[2])
                };
                let at = turn([x - m[0][3], y - m[1][3], z - m[2][3]]);
                let of = rays.entry(at.map(|v| (v / 0.05).floor() as i64)).or_default();
                if of.iter().all(|(other, _)| *other != number) {
                    of.push((number, turn([x, y, z])));
                }
            }
        }
        let angle =
            |a: [f64; 3], b: [f64; 3]| DVec3::from(a).angle_between(DVec3::from(b)).to_degrees();
        let n = rays.len() as f64;
        let well = rays
            .values()
            .filter(|r| r.len() >= 3 && r.iter().any(|(_, b)| angle(r[0].1, *b) >= 15.0));
        let few = rays.values().filter(|r| r.len() < 3).count() as f64;
        let want =
            Coverage { voxels: rays.len(), well_seen: well.count() as f64 / n, holes: few / n };
        assert_eq!(coverage(&frames).unwrap(), want);
        assert!(
            want.well_seen > 0.05 && want.well_seen < 1.0 - want.holes && want.holes > 0.05,
            "{want:?}"
        );
    }
}

//! Points and normals of what a picture with depth shows.

use glam::Vec3;
use rayon::prelude::*;
use scenesplat_rasterizer::View;

/// Depths that differ by more than this part are not of one surface.
const SAME_SURFACE: f32 = 0.05;

/// What is known of each pixel.
pub(crate) struct Pixels {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) lab: Vec<Vec3>,
    pub(crate) surface: Surface,
}

/// How far apart things are that differ by 1, in the distance of the clusters: color in L*a*b*, normals as vectors,
/// distance from the plane as a part of the depth.
pub(crate) const COLOR: f32 = 10.0;
pub(crate) const NORMAL: f32 = 0.4;
pub(crate) const PLANE: f32 = 0.02;

/// Where pixels are and which way they face, in the camera's axes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surface {
    /// `[H, W]`; z is 0 where depth is not known.
    pub(crate) points: Vec<Vec3>,
    /// Unit, toward the camera; 0 where it is not known. `[H, W]`
    pub(crate) normals: Vec<Vec3>,
}

impl Surface {
    /// Of depths along the camera's axis; not finite or not above 0 means unknown. `depth`: one per pixel.
    pub(crate) fn of(depth: &[f32], view: &View) -> Self {
        let (width, height) = (view.width as usize, view.height as usize);
        let point = |at: usize| {
            let z = depth[at];
            if !(z.is_finite() && z > 0.0) {
                return Vec3::ZERO;
            }
            let x = ((at % width) as f32 + 0.5 - view.cx) / view.fx;
            let y = ((at / width) as f32 + 0.5 - view.cy) / view.fy;
            Vec3::new(x * z, y * z, z)
        };
        let points: Vec<Vec3> = (0..depth.len()).map(point).collect();
        let near = |a: usize, b: usize| {
            let (a, b) = (points[a].z, points[b].z);
            a > 0.0 && b > 0.0 && (a - b).abs() <= SAME_SURFACE * a.min(b)
        };
        // From a neighbor on the same surface to the other one; where there is but one, from here.
        let along = |at: usize, before: Option<usize>, behind: Option<usize>| {
            let before = before.filter(|&b| near(at, b));
            let behind = behind.filter(|&b| near(at, b));
            let (from, to) = (before.unwrap_or(at), behind.unwrap_or(at));
            (from != to).then(|| points[to] - points[from])
        };
        let normal = |at: usize| {
            let (x, y) = (at % width, at / width);
            if points[at].z == 0.0 {
                return Vec3::ZERO;
            }
            let across =
                along(at, x.checked_sub(1).map(|_| at - 1), (x + 1 < width).then_some(at + 1));
            let down = along(
                at,
                y.checked_sub(1).map(|_| at - width),
                (y + 1 < height).then_some(at + width),
            );
            let (Some(across), Some(down)) = (across, down) else { return Vec3::ZERO };
            let n = down.cross(across);
            let length = n.length();
            if length.is_nan() || length <= 0.0 {
                return Vec3::ZERO;
            }
            let towards = if n.dot(points[at]) > 0.0 { -1.0 } else { 1.0 };
            towards * n / length
        };
        let normals: Vec<Vec3> = (0..points.len()).map(normal).collect();
        Self { normals: smoothed(&normals, &points, width, height), points }
    }

    /// Nothing known, for pictures without depth.
    pub(crate) fn unknown(pixels: usize) -> Self {
        Self { points: vec![Vec3::ZERO; pixels], normals: vec![Vec3::ZERO; pixels] }
    }
}

/// Mean of the 5 × 5 normals around that are on the same surface: rendered depth has steps.
fn smoothed(normals: &[Vec3], points: &[Vec3], width: usize, height: usize) -> Vec<Vec3> {
    let mean = |at: usize| {
        let (x, y, z) = (at % width, at / width, points[at].z);
        let mut sum = Vec3::ZERO;
        for v in y.saturating_sub(2)..(y + 3).min(height) {
            for u in x.saturating_sub(2)..(x + 3).min(width) {
                let other = v * width + u;
                if (points[other].z - z).abs() <= SAME_SURFACE * z {
                    sum += normals[other];
                }
            }
        }
        let length = sum.length();
        if length > 1e-6 && z > 0.0 { sum / length } else { Vec3::ZERO }
    };
    (0..normals.len()).into_par_iter().map(mean).collect()
}

#[cfg(test)]
mod by_hand;
#[cfg(test)]
mod tests {
    use super::*;
    use crate::segmenter::tests::view;

    #[test]
    fn a_slanted_plane_has_its_normal_everywhere() {
        let view = view(32, 24);
        // n · p = −2 with n toward the camera.
        let n = Vec3::new(0.3, -0.2, -1.0).normalize();
        let ray = |at: usize| {
            let x = ((at % 32) as f32 + 0.5 - view.cx) / view.fx;
            let y = ((at / 32) as f32 + 0.5 - view.cy) / view.fy;
            Vec3::new(x, y, 1.0)
        };
        let mut depth: Vec<f32> = (0..32 * 24).map(|at| -2.0 / n.dot(ray(at))).collect();
        depth[5] = 0.0;
        depth[9] = f32::NAN;
        let surface = Surface::of(&depth, &view);
        for (at, found) in surface.normals.iter().enumerate() {
            if [5, 9].contains(&at) {
                assert_eq!((*found, surface.points[at]), (Vec3::ZERO, Vec3::ZERO));
            } else {
                assert!(found.dot(n) > 0.9999, "{at}: {found:?}");
            }
        }
    }

    #[test]
    fn points_use_the_focal_length_of_their_own_axis() {
        // Half as long along x as along y; the principal point is not in the middle.
        let view = View { fx: 4.0, fy: 8.0, cx: 1.0, cy: 1.5, ..view(4, 3) };
        let surface = Surface::of(&[2.0; 12], &view);
        // x = 2 · (column + ½ − 1) / 4 and y = 2 · (row + ½ − 1½) / 8.
        for (at, want) in [
            (0, Vec3::new(-0.25, -0.25, 2.0)),
            (3, Vec3::new(1.25, -0.25, 2.0)),
            (4, Vec3::new(-0.25, 0.0, 2.0)),
            (11, Vec3::new(1.25, 0.25, 2.0)),
        ] {
            assert!((surface.points[at] - want).length() < 1e-6, "{at}: {:?}", surface.points[at]);
        }
    }

    #[test]
    fn normals_do_not_depend_on_the_unit_of_length() {
        let view = view(32, 24);
        let n = Vec3::new(0.3, -0.2, -1.0).normalize();
        // Two planes with the same normal, the right one a fifth farther away: both have this normal up to the step,
        // in any unit. Neighbors on one plane differ by about 1 % of their depth, those across the step by about 20 %.
        for unit in [1.0f32 / 32.0, 1.0, 64.0] {
            let depth: Vec<f32> = (0..32 * 24)
                .map(|at| {
                    let x = ((at % 32) as f32 + 0.5 - 16.0) / 32.0;
                    let y = ((at / 32) as f32 + 0.5 - 12.0) / 32.0;
                    let away = if at % 32 < 16 { 2.0f32 } else { 2.4 };
                    -away * unit / n.dot(Vec3::new(x, y, 1.0))
                })
                .collect();
            for (at, found) in Surface::of(&depth, &view).normals.iter().enumerate() {
                assert!(found.dot(n) > 0.999, "unit {unit}, {at}: {found:?}");
            }
        }
    }
}

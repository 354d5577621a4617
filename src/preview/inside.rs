//! Views from inside a scene, for scans that were taken there.

use super::framing::{Framing, Upright};
use super::rows::{PreviewRows, visible_discs};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::{Camera, LookAt, Up};

/// Places along each level axis that are tried.
const PLACES: usize = 17;
/// Part of the ground plan, about its middle, in which they lie.
const CENTRAL: f64 = 0.7;
/// Heights that are tried, as parts of that of the scene: eyes of people who stand and sit.
const HEIGHTS: [f64; 3] = [0.62, 0.5, 0.75];
/// What a step away from the middle has to gain in free space.
const PULL: f64 = 0.25;
/// How much the cameras look down, degrees.
const PITCH: f64 = 6.0;

/// `count` cameras that stand in one free place near the middle of the scene and look around,
/// evenly, slightly down; the first along the first level axis, the others against the clock as
/// seen from above. `fov` is the angle of view across the shorter side, degrees.
///
/// The place is the one with the largest distance to any Gaussian that matters, less a quarter of
/// its distance from the middle. Empty without such Gaussians.
pub fn inside_views(
    rows: &PreviewRows<'_>,
    up: Up,
    count: usize,
    fov: f64,
    size: [u32; 2],
) -> Vec<Camera> {
    let upright = Upright::new(up);
    let discs = visible_discs(rows, upright);
    let centres: Vec<[f32; 3]> = discs.iter().map(|d| d.centre).collect();
    let Some(tree) = KdTree::new(&centres).ok().filter(|tree| !tree.is_empty()) else {
        return Vec::new();
    };
    let (low, high) = Framing::of(&discs, false).bounds();
    let eye = free_place(&tree, low, high);
    let (sine, cosine) = PITCH.to_radians().sin_cos();
    (0..count)
        .filter_map(|k| {
            let azimuth = (360.0 * k as f64 / count as f64).to_radians();
            let ahead = [cosine * azimuth.cos(), cosine * azimuth.sin(), -sine];
            let target = [0, 1, 2].map(|a| eye[a] + ahead[a]);
            let look =
                LookAt { eye: upright.turn_back(eye), target: upright.turn_back(target), fov };
            look.camera(&format!("inside_{k:03}"), up, size)
        })
        .collect()
}

/// The place in the box, upright, with the most space around it.
fn free_place(tree: &KdTree, low: [f64; 3], high: [f64; 3]) -> [f64; 3] {
    let middle = [0, 1, 2].map(|a| (low[a] + high[a]) / 2.0);
    let mut best = (f64::NEG_INFINITY, middle);
    for part in HEIGHTS {
        let z = low[2] + part * (high[2] - low[2]);
        for i in 0..PLACES * PLACES {
            let at = |step: usize, a: usize| {
                let share = step as f64 / (PLACES - 1) as f64 - 0.5;
                middle[a] + CENTRAL * share * (high[a] - low[a])
            };
            let place = [at(i % PLACES, 0), at(i / PLACES, 1), z];
            let nearest = tree.nearest(place.map(|v| v as f32), 1);
            let space = nearest.first().map_or(0.0, |n| n.distance_squared.sqrt());
            let away = ((place[0] - middle[0]).powi(2) + (place[1] - middle[1]).powi(2)).sqrt();
            let score = space - PULL * away;
            // Of equals the first one: the same place for any number of threads.
            if score > best.0 {
                best = (score, place);
            }
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The walls, floor and ceiling of a room of 4 × 3 × 2.5 m, and a pillar in its middle.
    fn room() -> Vec<[f32; 3]> {
        let mut coord = Vec::new();
        for i in 0..40 {
            for j in 0..40 {
                let (a, b) = (i as f32 / 39.0, j as f32 / 39.0);
                coord.extend([[4.0 * a, 3.0 * b, 0.0], [4.0 * a, 3.0 * b, 2.5]]);
                coord.extend([[4.0 * a, 0.0, 2.5 * b], [4.0 * a, 3.0, 2.5 * b]]);
                coord.extend([[0.0, 3.0 * a, 2.5 * b], [4.0, 3.0 * a, 2.5 * b]]);
                coord.push([2.0 + 0.1 * (a - 0.5), 1.5 + 0.1 * (b - 0.5), 2.5 * a]);
            }
        }
        coord
    }

    #[test]
    fn cameras_stand_in_free_space_and_look_around() {
        let coord = room();
        let n = coord.len();
        let rows = PreviewRows {
            coord: &coord,
            color: &vec![[0; 3]; n],
            radius: &vec![0.02; n],
            opacity: &vec![0.9; n],
            shapes: None,
        };
        let cameras = inside_views(&rows, Up::PLUS_Z, 4, 75.0, [64, 48]);
        assert_eq!(cameras.len(), 4);
        let eye = cameras[0].centre();
        for camera in &cameras {
            assert!((0..3).all(|a| (camera.centre()[a] - eye[a]).abs() < 1e-9));
        }
        assert!((0.5..3.5).contains(&eye[0]) && (0.5..2.5).contains(&eye[1]), "{eye:?}");
        assert!((1.0..2.0).contains(&eye[2]), "{eye:?}");
        let pillar = ((eye[0] - 2.0).powi(2) + (eye[1] - 1.5).powi(2)).sqrt();
        assert!(pillar > 0.3, "it stands in the pillar: {eye:?}");
        // A point of each wall is in one of the pictures.
        for wall in [[0.0, 1.0, 1.2], [4.0, 2.0, 1.2], [1.0, 0.0, 1.2], [3.0, 3.0, 1.2]] {
            let sees = |camera: &Camera| camera.project(wall).is_some_and(|p| camera.contains(p));
            assert!(cameras.iter().any(sees), "{wall:?}");
        }
        let none = PreviewRows { coord: &[], color: &[], radius: &[], opacity: &[], shapes: None };
        assert!(inside_views(&none, Up::PLUS_Z, 3, 75.0, [64, 48]).is_empty());
    }
}

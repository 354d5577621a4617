//! Making a floor level.
//!
//! Captured scenes are turned to some axis by their pipelines only roughly: a floor is often off by
//! a few degrees. What is level in a room (floor, ceiling, table tops) is seen in the normals of
//! flat Gaussians; their common direction is up.

use crate::bounds::{Bounds, robust_bounds};
use crate::formats::unit_f64;
use crate::frame::{Matrix3, apply};
use crate::quaternion::axes_by_size;
use crate::up::shortest_to_z;
use crate::vector::rotation;
use crate::{GaussianScene, Similarity};
use glam::DVec3;
use serde::Serialize;

/// Rows that are looked at.
const SAMPLE: usize = 200_000;

/// A Gaussian is flat when its shortest axis is so much shorter than the middle one, in ln.
const FLAT: f32 = 1.0;

/// Fainter Gaussians say nothing about surfaces.
const FAINTEST: f32 = 0.1;

/// Angles about the direction so far, in degrees, within which normals are averaged anew: from what
/// a roughly turned scene is off by down to the noise of a floor's normals. The last is repeated
/// until nothing moves.
const CONES: [f64; 5] = [25.0, 15.0, 8.0, 5.0, 4.0];

/// Rounds with the narrowest cone.
const ROUNDS: usize = 10;

/// Least share of the flat surface, and least number of Gaussians, that have to face up.
const LEAST_SHARE: f64 = 0.02;
const LEAST_ROWS: usize = 30;

/// Thickness of the slab in which the floor is looked for, in units of the longest side.
const SLAB: f64 = 0.02;

/// The lowest slab with this share of the fullest one is the floor: tables have less surface.
const FLOOR_SHARE: f64 = 0.3;

/// A floor made level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Leveling {
    /// Degrees between what was up and what is up now.
    pub tilt: f64,
    /// Height of the floor before it was moved to 0, after the turn; units of the scene.
    pub floor: f64,
    /// Flat Gaussians that say so; below 30, or where hardly any surface faces up, the scene is not
    /// turned, and only moved.
    pub rows: usize,
    /// Share of the surface of flat Gaussians that faces up within 4 degrees.
    pub share: f64,
    /// The turn.
    #[serde(skip)]
    pub rotation: Matrix3,
}

impl Leveling {
    /// What takes the scene there: the turn, and the move of the floor to z = 0.
    pub fn similarity(&self) -> Similarity {
        Similarity { rotation: self.rotation, scale: 1.0, translation: [0.0, 0.0, -self.floor] }
    }

    /// Whether a floor was found, rather than the lowest Gaussians taken for one.
    pub fn has_floor(&self) -> bool {
        self.rows >= LEAST_ROWS && self.share >= LEAST_SHARE
    }
}

/// A flat Gaussian.
struct Flat {
    coord: DVec3,
    /// Unit, with z ≥ 0.
    normal: DVec3,
    /// Product of the two longer axes times opacity.
    surface: f64,
}

/// How to make the floor of a scene level, whose up is +z within 25 degrees.
///
/// Up is where the flat Gaussians about +z face on average, each by its surface. The floor is
/// the lowest level slab that holds a fair part of what the fullest one holds. A scene without level
/// surfaces is not turned; its lowest half percent is put at 0. The same for any number of threads.
pub fn level(scene: &GaussianScene) -> Leveling {
    let bounds = robust_bounds(&scene.coord);
    let flats = flats(scene, &bounds);
    let total: f64 = flats.iter().map(|f| f.surface).sum();
    let mut up = DVec3::Z;
    for cone in CONES.into_iter().chain([CONES[CONES.len() - 1]; ROUNDS]) {
        up = mean_normal(&flats, up, cone).unwrap_or(up);
    }
    let narrow = CONES[CONES.len() - 1].to_radians().cos();
    let facing: Vec<&Flat> = flats.iter().filter(|f| f.normal.dot(up) >= narrow).collect();
    let share = facing.iter().map(|f| f.surface).sum::<f64>() / total.max(f64::MIN_POSITIVE);
    let mut found = Leveling {
        tilt: 0.0,
        floor: bounds.low[2],
        rows: facing.len(),
        share,
        rotation: Similarity::IDENTITY.rotation,
    };
    if found.has_floor() {
        found.tilt = up.z.clamp(-1.0, 1.0).acos().to_degrees();
        found.rotation = shortest_to_z(up.to_array());
        found.floor = floor_height(&facing, up, SLAB * bounds.largest_extent());
    }
    if scene.has_origin() {
        found.floor += apply(&found.rotation, scene.origin)[2];
    }
    found
}

fn flats(scene: &GaussianScene, bounds: &Bounds) -> Vec<Flat> {
    let step = scene.len().div_ceil(SAMPLE).max(1);
    (0..scene.len())
        .step_by(step)
        .filter(|&row| bounds.distance(scene.coord[row]) == 0.0)
        .filter_map(|row| flat(scene, row))
        .collect()
}

fn flat(scene: &GaussianScene, row: usize) -> Option<Flat> {
    let sizes = scene.log_scale[row];
    let [short, middle, long] = axes_by_size(sizes);
    let opacity = scene.opacity(row);
    // NaN is neither flat nor visible.
    let is_flat = sizes[middle] - sizes[short] >= FLAT && opacity >= FAINTEST;
    let surface = f64::from(sizes[middle] + sizes[long]).exp() * f64::from(opacity);
    if !is_flat || !surface.is_finite() {
        return None;
    }
    let quat = unit_f64(scene.quat[row]);
    if !quat.iter().all(|v| v.is_finite()) {
        return None;
    }
    let normal = DVec3::from(rotation(quat).map(|r| r[short]));
    let normal = if normal.z < 0.0 { -normal } else { normal };
    Some(Flat { coord: DVec3::from(scene.coord[row].map(f64::from)), normal, surface })
}

/// Mean of the normals within `cone` degrees about `up`, by surface; no Gaussian counts for more than
/// a hundredth part, so that no huge one decides.
fn mean_normal(flats: &[Flat], up: DVec3, cone: f64) -> Option<DVec3> {
    let least = cone.to_radians().cos();
    let near = || flats.iter().filter(|f| f.normal.dot(up).abs() >= least);
    let most = near().map(|f| f.surface).sum::<f64>() / 100.0;
    let mut sum = DVec3::ZERO;
    for f in near() {
        sum += f.normal.dot(up).signum() * f.normal * f.surface.min(most);
    }
    let length = sum.length();
    (length > 0.0).then(|| sum / length)
}

/// Height of the floor along `up`.
fn floor_height(facing: &[&Flat], up: DVec3, slab: f64) -> f64 {
    let mut heights: Vec<(f64, f64)> =
        facing.iter().map(|f| (f.coord.dot(up), f.surface)).collect();
    heights.sort_by(|a, b| a.0.total_cmp(&b.0));
    // No single Gaussian makes a floor.
    let most = heights.iter().map(|h| h.1).sum::<f64>() / 100.0;
    heights.iter_mut().for_each(|h| h.1 = h.1.min(most));
    // What a slab holds that begins at each height.
    let (mut end, mut held) = (0, 0.0);
    let mut slabs = Vec::with_capacity(heights.len());
    for start in 0..heights.len() {
        while end < heights.len() && heights[end].0 <= heights[start].0 + slab {
            held += heights[end].1;
            end += 1;
        }
        slabs.push((end, held));
        held -= heights[start].1;
    }
    let fullest = slabs.iter().map(|s| s.1).fold(0.0, f64::max);
    let lowest = slabs.iter().position(|s| s.1 >= FLOOR_SHARE * fullest).unwrap_or(0);
    // The slab that begins lowest may only graze the floor: the fullest within its reach is it.
    let reach = heights[lowest].0 + slab;
    let within = (lowest..heights.len()).take_while(|&i| heights[i].0 <= reach);
    let best = within.max_by(|&a, &b| slabs[a].1.total_cmp(&slabs[b].1).then(b.cmp(&a)));
    let best = best.unwrap_or(lowest);
    let inside = &heights[best..slabs[best].0];
    let half = inside.iter().map(|h| h.1).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    for (height, weight) in inside {
        sum += weight;
        if sum >= half {
            return *height;
        }
    }
    heights[best].0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::EulerAngles;

    /// A room of 4 × 3 × 2.5 m whose floor is at 0.7: floor, table, two walls, and clutter.
    fn room() -> GaussianScene {
        let mut scene = GaussianScene::default();
        let mut bits = 7u32;
        let mut next = || {
            bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (bits >> 8) as f32 / 16_777_216.0
        };
        let flat = [0.03f32.ln(), 0.03f32.ln(), 0.002f32.ln()];
        let level = [1.0, 0.0, 0.0, 0.0];
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let mut add = |coord: [f32; 3], quat: [f32; 4], size: [f32; 3]| {
            scene.coord.push(coord);
            scene.quat.push(quat);
            scene.log_scale.push(size);
            scene.opacity_logit.push(3.0);
            scene.sh_dc.push([0.0; 3]);
        };
        for _ in 0..4000 {
            let (x, y, h) = (4.0 * next(), 3.0 * next(), 2.5 * next());
            // Normals of a floor are off by a degree or two.
            let noise = [1.0, 0.02 * (next() - 0.5), 0.02 * (next() - 0.5), 0.0];
            add([x, y, 0.7 + 0.01 * (next() - 0.5)], noise, flat);
            add([x, 0.0, 0.7 + h], [half, half, 0.0, 0.0], flat);
            add([0.0, y, 0.7 + h], [half, 0.0, half, 0.0], flat);
        }
        for _ in 0..500 {
            add([1.0 + next(), 1.0 + next(), 1.45], level, flat);
            let quat = [next() - 0.5, next() - 0.5, next() - 0.5, next() - 0.5];
            add([4.0 * next(), 3.0 * next(), 0.7 + 2.5 * next()], quat, flat);
        }
        scene
    }

    #[test]
    fn a_tilted_floor_becomes_level_at_zero() {
        let still = level(&room());
        assert!(still.has_floor() && still.tilt < 0.15, "{still:?}");
        assert!((still.floor - 0.7).abs() < 0.01, "{still:?}");
        for angles in [[3.0, 0.0, 0.0], [-12.0, 7.0, 40.0], [0.0, 20.0, 0.0]] {
            let mut scene = room();
            let turn = EulerAngles(angles).matrix();
            let translation = [10.0, -3.0, 5.0];
            scene.transform(&Similarity { rotation: turn, scale: 1.0, translation });
            let found = level(&scene);
            let due = turn[2][2].acos().to_degrees();
            assert!((found.tilt - due).abs() < 0.2, "{angles:?}: {found:?}, due {due}");
            scene.transform(&found.similarity());
            let heights = scene.coord.iter().step_by(3).take(4000).map(|p| p[2]);
            let off = heights.map(f32::abs).fold(0.0, f32::max);
            assert!(off < 0.03, "{angles:?}: the floor is off by {off}");
            let again = level(&scene);
            assert!(again.tilt < 0.1 && again.floor.abs() < 0.01, "{again:?}");
        }
    }

    #[test]
    fn without_level_surfaces_the_lowest_are_put_at_zero() {
        let mut scene = room();
        scene.log_scale.iter_mut().for_each(|s| *s = [-3.0; 3]);
        let found = level(&scene);
        assert!(!found.has_floor());
        assert_eq!((found.tilt, found.rotation), (0.0, Similarity::IDENTITY.rotation));
        assert!((found.floor - 0.7).abs() < 0.05, "{found:?}");
        let one = scene.select_rows(&[0]).unwrap();
        assert!(!level(&one).has_floor());
        assert!(level(&GaussianScene::default()).floor.is_finite());
    }

    #[test]
    fn one_huge_gaussian_decides_nothing() {
        let mut scene = room();
        scene.log_scale[1] = [2.0, 2.0, -8.0];
        scene.quat[1] = [0.99, 0.14, 0.0, 0.0];
        scene.coord[1] = [2.0, 1.0, 0.2 + 0.7];
        let found = level(&scene);
        assert!(found.tilt < 0.5 && (found.floor - 0.7).abs() < 0.02, "{found:?}");
    }
}

//! What cameras see of a room: the share that each Gaussian has in small pictures, front to back.
//!
//! Not a renderer: a Gaussian covers an upright square, evenly. That is enough to tell what is behind something
//! from what is before it, which is all that is asked for here; the crate of the renderer stands on none of
//! rooms, and rooms on none of it.

use crate::splats::{opacity, sizes};
use crate::vector::{V3, dot, sub};
use crate::walk::Camera;
use rayon::prelude::*;
use scenesplat_scene::GaussianScene;

/// Pixels of a picture, and its focal length: 77 degrees wide.
const WIDE: usize = 128;
const HIGH: usize = 96;
const FOCAL: f64 = 80.0;

/// Nearer than this nothing is in the picture, meters.
const NEAR: f64 = 0.15;

/// Depths are sorted in steps of this, meters.
const STEP: f64 = 0.004;

/// Steps of depth: beyond the last all is one.
const STEPS: usize = 4096;

/// What has less than this in all pictures together was not seen: a twentieth of one pixel's light.
const SEEN: f32 = 0.05;

/// Rows of the Gaussians that were seen.
pub(crate) fn seen(scene: &GaussianScene, cameras: &[Camera]) -> Vec<usize> {
    let pictures: Vec<Vec<(u32, f32)>> = cameras.par_iter().map(|c| shares(scene, c)).collect();
    // In the order of the cameras, whoever was first.
    let mut sums = vec![0.0_f32; scene.len()];
    for (row, share) in pictures.into_iter().flatten() {
        sums[row as usize] += share;
    }
    (0..scene.len()).filter(|&row| sums[row] > SEEN).collect()
}

struct InView {
    row: u32,
    step: u32,
    place: [f64; 2],
    half: f64,
    opacity: f32,
}

/// What a Gaussian adds to the pixels that it covers, on average over them; in one picture.
pub(crate) fn shares(scene: &GaussianScene, camera: &Camera) -> Vec<(u32, f32)> {
    let mut all = Vec::new();
    let mut starts = vec![0_u32; STEPS + 1];
    for row in 0..scene.len() {
        let from: V3 = sub(scene.coord[row].map(f64::from), camera.eye);
        let depth = dot(from, camera.forward);
        if depth < NEAR {
            continue;
        }
        let scale = FOCAL / depth;
        let x = dot(from, camera.right) * scale + WIDE as f64 / 2.0;
        let y = dot(from, camera.down) * scale + HIGH as f64 / 2.0;
        if !(0.0..WIDE as f64).contains(&x) || !(0.0..HIGH as f64).contains(&y) {
            continue;
        }
        let step = ((depth / STEP) as usize).min(STEPS - 1);
        starts[step + 1] += 1;
        all.push(InView {
            row: row as u32,
            step: step as u32,
            place: [x, y],
            half: (reach(scene, row) * scale).clamp(0.1, 4.0),
            opacity: opacity(scene, row) as f32,
        });
    }
    for step in 0..STEPS {
        starts[step + 1] += starts[step];
    }
    let mut order = vec![0_u32; all.len()];
    for (index, one) in all.iter().enumerate() {
        let at = &mut starts[one.step as usize];
        order[*at as usize] = index as u32;
        *at += 1;
    }
    let mut light = vec![1.0_f32; WIDE * HIGH];
    let shares = order.into_iter().map(|index| {
        let one = &all[index as usize];
        (one.row, cover(&mut light, one))
    });
    shares.filter(|(_, share)| *share > 0.0).collect()
}

/// About how far its visible part reaches: one and a half of the mean of its two larger sizes.
fn reach(scene: &GaussianScene, row: usize) -> f64 {
    let [a, b, c] = sizes(scene, row);
    let least = a.min(b).min(c);
    // The product of the two larger ones, whichever they are.
    1.5 * (a * b * c / least.max(1e-9)).sqrt()
}

/// Takes its part of the light that is left in the pixels that a square covers.
fn cover(light: &mut [f32], one: &InView) -> f32 {
    let [x, y] = one.place;
    let range = |v: f64, n: usize| {
        let from = (v - one.half).max(0.0) as usize;
        let to = ((v + one.half) as usize).min(n - 1);
        from..=to
    };
    let (columns, rows) = (range(x, WIDE), range(y, HIGH));
    let part = |v: f64, pixel: usize| {
        let low = (v - one.half).max(pixel as f64);
        let high = (v + one.half).min(pixel as f64 + 1.0);
        (high - low).max(0.0)
    };
    let (mut sum, mut area) = (0.0, 0.0);
    for row in rows {
        let high = part(y, row);
        for column in columns.clone() {
            let covered = (high * part(x, column)) as f32;
            let there = &mut light[row * WIDE + column];
            sum += covered * *there * one.opacity;
            area += covered;
            *there *= 1.0 - one.opacity * covered;
        }
    }
    if area > 0.0 { sum / area } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::Z;

    #[test]
    fn what_is_behind_a_wall_is_not_seen() {
        let mut scene = GaussianScene::default();
        let mut put = |coord: [f32; 3], opacity_logit: f32| {
            scene.coord.push(coord);
            scene.log_scale.push([-4.0, -4.0, -7.0]);
            scene.quat.push([1.0, 0.0, 0.0, 0.0]);
            scene.opacity_logit.push(opacity_logit);
            scene.sh_dc.push([0.0; 3]);
        };
        // A wall 2 m away, a thing before it, a thing behind it, one behind the camera, a faint one before it.
        for y in -50..50 {
            for z in -50..50 {
                put([2.0, y as f32 * 0.02, z as f32 * 0.02], 4.0);
            }
        }
        for x in [1.0, 3.0, -1.0] {
            put([x, 0.0, 0.0], 4.0);
        }
        put([1.5, 0.3, 0.0], -8.0);
        let camera = Camera {
            eye: [0.0; 3],
            right: [0.0, -1.0, 0.0],
            down: Z.map(|v| -v),
            forward: [1.0, 0.0, 0.0],
        };
        let rows = seen(&scene, &[camera]);
        let is_seen = |row: usize| rows.binary_search(&row).is_ok();
        assert!(is_seen(10_000) && !is_seen(10_001) && !is_seen(10_002) && !is_seen(10_003));
        let wall = rows.iter().filter(|&&row| row < 10_000).count();
        assert!(wall > 9_500, "{wall}");
    }
}

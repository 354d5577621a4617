//! What a depth camera that is held in the hand leaves of a room: points of the surfaces that it looked at, fused from many pictures,
//! each with the errors of range, of the camera's place, and of color that such a camera has.

use crate::dice::{between, chance, noise};
use crate::seen::shares;
use crate::splats::{holes_in, rounded_ln};
use crate::vector::{V3, add_times, dot, sub, unit_or};
use crate::walk::Camera;
use rayon::prelude::*;
use scenesplat_kernels::random::SampleRng;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::gaussian_scene::{dc_to_u8, u8_to_dc};
use scenesplat_scene::quaternion::quat_from_z_to;
use std::collections::HashMap;

/// Share of a pixel's light that a point needs in one picture to be in it.
const SEEN: f32 = 0.05;

/// Cells in which a color is looked up, meters.
const CELL: f64 = 0.03;

/// The errors of a camera.
struct Errors {
    /// Nearest and farthest range, meters.
    range: [f64; 2],
    /// Factor of the noise of the range.
    noise: f64,
    /// Spread of the place of a picture's points, meters.
    drift: f64,
    /// Share of the points that fly between an edge and what is behind it.
    flying: f64,
    /// Noise of normals.
    tilt: f64,
    /// How far from its depth a pixel's color is, meters at one meter: to the right and down.
    shift: [f64; 2],
    /// Light: gain of each channel, haze, saturation, and the spread of the gain over pictures.
    gain: V3,
    haze: f64,
    saturation: f64,
    exposure: f64,
    grit: f64,
    /// Size of a point: logarithm of the cells that it is fused in.
    ln_size: f64,
}

impl Errors {
    fn draw(rng: &mut SampleRng) -> Self {
        let gain = between(rng, 0.65, 1.12);
        Self {
            range: [0.4, between(rng, 2.4, 4.5)],
            noise: between(rng, 0.4, 1.6),
            drift: between(rng, 0.0, 0.012),
            flying: between(rng, 0.0, 0.03),
            tilt: between(rng, 0.03, 0.25),
            shift: [between(rng, -0.02, 0.02), between(rng, -0.012, 0.012)],
            gain: std::array::from_fn(|_| gain * between(rng, 0.9, 1.1)),
            haze: between(rng, -12.0, 18.0),
            saturation: between(rng, 0.6, 1.2),
            exposure: between(rng, 0.0, 0.1),
            grit: between(rng, 1.0, 7.0),
            ln_size: rounded_ln(between(rng, 0.007, 0.03)),
        }
    }

    /// A color as this camera shows it, 0 to 1.
    fn color(&self, rgb: V3, exposure: f64, rng: &mut SampleRng) -> V3 {
        let lit: V3 = std::array::from_fn(|i| rgb[i] * self.gain[i] * exposure);
        let gray = (lit[0] + lit[1] + lit[2]) / 3.0;
        let common = self.grit * noise(rng);
        std::array::from_fn(|i| {
            let v = gray + self.saturation * (lit[i] - gray);
            (v + (self.haze + common + 0.5 * self.grit * noise(rng)) / 255.0).clamp(0.0, 1.0)
        })
    }
}

/// What is left of a room of points. Nothing where no camera is.
pub(crate) fn fused(
    scene: &GaussianScene,
    cameras: &[Camera],
    rng: &mut SampleRng,
) -> GaussianScene {
    let errors = Errors::draw(rng);
    let holes = holes_in(extent(scene), 3, 0.5, rng);
    let seen_by = camera_of_rows(scene, cameras, &errors, rng);
    let rows: Vec<usize> = (0..scene.len()).filter(|&row| seen_by[row].is_some()).collect();
    let mut by_cell = HashMap::new();
    for &row in &rows {
        by_cell.entry(cell(scene.coord[row].map(f64::from))).or_insert(row);
    }
    let pictures: Vec<(V3, f64)> = (cameras.iter())
        .map(|_| {
            let drift = std::array::from_fn(|_| errors.drift * noise(rng));
            (drift, 1.0 + errors.exposure * noise(rng).clamp(-2.0, 2.0))
        })
        .collect();
    let mut kept = Vec::with_capacity(rows.len());
    let mut fused = Vec::with_capacity(rows.len());
    for row in rows {
        let p: V3 = scene.coord[row].map(f64::from);
        let is_lost = holes.iter().any(|(middle, radius)| {
            let d = sub(p, *middle);
            dot(d, d) < radius * radius
        });
        if is_lost && chance(rng, 0.85) {
            continue;
        }
        let index = seen_by[row].expect("only rows that a camera saw");
        let (drift, exposure) = pictures[index];
        kept.push(row);
        fused.push(point(scene, row, &cameras[index], &errors, (drift, exposure), &by_cell, rng));
    }
    let mut out = scene.select_rows(&kept).expect("rows are of the scene");
    for (row, one) in fused.into_iter().enumerate() {
        out.coord[row] = one.coord.map(|v| v as f32);
        out.quat[row] = quat_from_z_to(one.normal).map(|v| v as f32);
        out.log_scale[row] = one.log_scale.map(|v| v as f32);
        out.sh_dc[row] = one.color.map(|c| u8_to_dc((255.0 * c) as u8));
        if let Some(normal) = &mut out.normal {
            normal[row] = one.normal.map(|v| v as f32);
        }
    }
    out
}

struct Point {
    coord: V3,
    normal: V3,
    log_scale: V3,
    color: V3,
}

fn point(
    scene: &GaussianScene,
    row: usize,
    camera: &Camera,
    errors: &Errors,
    (drift, exposure): (V3, f64),
    by_cell: &HashMap<[i32; 3], usize>,
    rng: &mut SampleRng,
) -> Point {
    let p: V3 = scene.coord[row].map(f64::from);
    let ray = sub(p, camera.eye);
    let depth = dot(ray, camera.forward).max(0.1);
    let along = unit_or(ray, camera.forward);
    // Structured light: 1.2 mm and 1.9 mm for each square of a meter beyond 0.4 m.
    let far = (depth - 0.4).max(0.0);
    let mut off = errors.noise * (0.0012 + 0.0019 * far * far) * noise(rng);
    if chance(rng, errors.flying) {
        off += between(rng, -0.01, 0.08);
    }
    let coord: V3 = std::array::from_fn(|i| p[i] + along[i] * off + drift[i]);
    let [right, down] = errors.shift.map(|s| s * depth);
    let beside = add_times(add_times(p, camera.right, right), camera.down, down);
    let from = by_cell.get(&cell(beside)).copied().unwrap_or(row);
    let rgb: V3 = std::array::from_fn(|i| f64::from(dc_to_u8(scene.sh_dc[from][i])) / 255.0);
    let normal: V3 = scene.normal.as_ref().map_or([0.0, 0.0, 1.0], |n| n[row].map(f64::from));
    let normal = unit_or(std::array::from_fn(|i| normal[i] + errors.tilt * noise(rng)), normal);
    let wide = errors.ln_size + 0.2 * noise(rng);
    Point {
        coord,
        normal,
        log_scale: [wide, wide, wide - std::f64::consts::LN_10],
        color: errors.color(rgb, exposure, rng),
    }
}

/// Of each row one of the cameras that saw it, each as likely.
fn camera_of_rows(
    scene: &GaussianScene,
    cameras: &[Camera],
    errors: &Errors,
    rng: &mut SampleRng,
) -> Vec<Option<usize>> {
    let pictures: Vec<Vec<(u32, f32)>> = cameras.par_iter().map(|c| shares(scene, c)).collect();
    let mut seen_by = vec![None; scene.len()];
    let mut times_seen = vec![0_u32; scene.len()];
    // In the order of the cameras, whoever was first.
    for (index, picture) in pictures.iter().enumerate() {
        for &(row, share) in picture {
            let row = row as usize;
            let ray = sub(scene.coord[row].map(f64::from), cameras[index].eye);
            let depth = dot(ray, cameras[index].forward);
            if share < SEEN || !(errors.range[0]..errors.range[1]).contains(&depth) {
                continue;
            }
            times_seen[row] += 1;
            if chance(rng, 1.0 / f64::from(times_seen[row])) {
                seen_by[row] = Some(index);
            }
        }
    }
    seen_by
}

fn cell(p: V3) -> [i32; 3] {
    p.map(|v| (v / CELL).floor() as i32)
}

fn extent(scene: &GaussianScene) -> V3 {
    let most = |axis: usize| scene.coord.iter().map(|p| p[axis]).fold(0.0, f32::max);
    [most(0), most(1), most(2)].map(f64::from)
}

//! Flat first Gaussians that lie on what the depths show: means over the pixels of all frames, with their normals.

use crate::Model;
use crate::error::OptimiseError;
use crate::frame::TrainingFrame;
use crate::fused_points::{COARSER, lifted};
use crate::initial::{flat_harmonics, neighbour_log_scales};
use crate::model::{Stored, logit};
use glam::{DVec3, Vec3};
use scenesplat_scene::quaternion::quat_from_z_to;
use std::collections::HashMap;

/// Pixels tried for each surfel of the result.
const CANDIDATES: usize = 24;
/// Pixels of a row that a normal is taken over: a two hundredth of the picture's width to each side.
const REACH: u32 = 200;
/// Largest step in depth within that reach, as a share of the depth per pixel of reach over the focal length: surfaces seen at more
/// than about 84 degrees are edges.
const STEEPEST: f32 = 10.0;
/// Pixels that a cell needs where cells have this many on average: fewer are strays between an edge and what is behind it.
const LEAST: [f64; 2] = [2.0, 4.0];
/// Opacity of all.
const OPACITY: f32 = 0.95;
/// How much thinner than wide a surfel is.
const THIN: f32 = 10.0;

/// A piece of surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surfel {
    /// Where it is, units of the world.
    pub point: [f32; 3],
    /// Unit, toward the cameras.
    pub normal: [f32; 3],
    /// In 0 to 1.
    pub color: [f32; 3],
}

/// A pixel in the world.
struct Sample {
    point: Vec3,
    normal: Vec3,
    color: Vec3,
}

/// Sums over a cell.
#[derive(Default)]
struct Sums {
    point: DVec3,
    normal: DVec3,
    color: DVec3,
    count: f64,
}

/// At most `most` surfels on what the depths show, in the order in which their places are first seen.
///
/// Pixels at equal distances over all frames are lifted into the world, each with the normal of the depths around it; pixels at
/// steps in depth have none and are left out. Those in one cell give a surfel, their mean, and cells grow until there are few enough.
pub fn fused_surfels(frames: &[TrainingFrame], most: usize) -> Vec<Surfel> {
    let samples = samples(frames, CANDIDATES * most);
    let Some(first) = samples.first() else { return Vec::new() };
    let ends = samples
        .iter()
        .fold([first.point; 2], |[low, high], s| [low.min(s.point), high.max(s.point)]);
    let side = f64::from((ends[1] - ends[0]).max_element().max(1e-6));
    // Surfaces: some six sides of the box, each cell a square of them.
    let mut cell = side * (3.0 / most.max(1) as f64).sqrt() / 8.0;
    loop {
        if let Some(sums) = fused(&samples, ends[0], cell, most) {
            return sums;
        }
        cell *= COARSER;
    }
}

/// The means of cells of this size; none if there are too many.
fn fused(samples: &[Sample], low: Vec3, cell: f64, most: usize) -> Option<Vec<Surfel>> {
    let mut places: HashMap<[i64; 3], usize> = HashMap::with_capacity(2 * most);
    let mut sums: Vec<Sums> = Vec::with_capacity(most);
    // Strays are not known before the end.
    let limit = 2 * most + 1;
    for sample in samples {
        let at = ((sample.point - low).as_dvec3() / cell).floor();
        let next = sums.len();
        let place = *places.entry([at.x as i64, at.y as i64, at.z as i64]).or_insert(next);
        if place == next {
            if next == limit {
                return None;
            }
            sums.push(Sums::default());
        }
        let sums = &mut sums[place];
        sums.point += sample.point.as_dvec3();
        sums.normal += sample.normal.as_dvec3();
        sums.color += sample.color.as_dvec3();
        sums.count += 1.0;
    }
    let mean = samples.len() as f64 / sums.len() as f64;
    let least = if mean >= LEAST[1] { LEAST[0] } else { 1.0 };
    let kept: Vec<&Sums> = sums.iter().filter(|sums| sums.count >= least).collect();
    (kept.len() <= most).then(|| kept.into_iter().map(Sums::surfel).collect())
}

impl Sums {
    fn surfel(&self) -> Surfel {
        let mean = |v: DVec3| (v / self.count).as_vec3().to_array();
        // Sides of a thin thing may cancel each other.
        let normal = self.normal.try_normalize().unwrap_or(DVec3::Z).as_vec3().to_array();
        Surfel { point: mean(self.point), normal, color: mean(self.color) }
    }
}

/// About `wanted` pixels of all frames.
fn samples(frames: &[TrainingFrame], wanted: usize) -> Vec<Sample> {
    let pixels: usize = frames.iter().filter_map(|f| f.depth.as_ref()).map(Vec::len).sum();
    // Odd, so that the columns of even pictures are not always the same.
    let stride = (pixels / wanted.max(1)).max(1) | 1;
    let mut samples = Vec::new();
    let mut number = 0_usize;
    for frame in frames {
        let Some(depth) = &frame.depth else { continue };
        for i in 0..depth.len() {
            number += 1;
            if !number.is_multiple_of(stride) || !frame.shows(i) {
                continue;
            }
            if let Some(normal) = normal(frame, depth, i) {
                let color = Vec3::from([0, 1, 2].map(|c| frame.rgb.at(3 * i + c)));
                samples.push(Sample { point: lifted(frame, i, depth[i]).into(), normal, color });
            }
        }
    }
    samples
}

/// The normal of the depths around a pixel, toward the camera; none at a step in depth, where a depth is missing, and at the border.
fn normal(frame: &TrainingFrame, depth: &[f32], i: usize) -> Option<Vec3> {
    let v = &frame.view;
    let (w, h) = (v.width as usize, v.height as usize);
    let reach = (v.width / REACH).max(1) as usize;
    let (x, y) = (i % w, i / w);
    if x < reach || y < reach || x + reach >= w || y + reach >= h {
        return None;
    }
    let z = depth[i];
    let limit = STEEPEST * z * reach as f32 / v.fx.min(v.fy);
    let near = |j: usize| {
        let there = depth[j];
        let good = there > 0.01 && there.is_finite() && (there - z).abs() <= limit;
        good.then(|| Vec3::from(lifted(frame, j, there)))
    };
    if !(z > 0.01 && z.is_finite()) {
        return None;
    }
    let across = near(i + reach)? - near(i - reach)?;
    let down = near(i + reach * w)? - near(i - reach * w)?;
    // Down × right looks back at the camera, which looks along right × down.
    down.cross(across).try_normalize()
}

/// Gaussians of surfels: discs as wide as their spacing, a tenth as thick, nearly opaque.
///
/// # Errors
/// If a coordinate is not finite.
pub fn from_surfels(surfels: &[Surfel], sh_degree: u8) -> Result<Model, OptimiseError> {
    let points: Vec<[f32; 3]> = surfels.iter().map(|s| s.point).collect();
    let wide = neighbour_log_scales(&points, 1.0)?;
    let rows: Vec<Stored> = (surfels.iter().zip(wide))
        .map(|(surfel, wide)| Stored {
            mean: surfel.point,
            log_scale: [wide, wide, wide - THIN.ln()],
            quat: quat_from_z_to(surfel.normal.map(f64::from)).map(|v| v as f32),
            logit: logit(OPACITY),
        })
        .collect();
    let sh = flat_harmonics(surfels.iter().map(|s| s.color), sh_degree);
    Model::from_arrays(&rows, sh, sh_degree)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Colors;
    use crate::frame::tests::view;
    use scenesplat_scene::gaussian_scene::SH_C0;

    /// Looks along +z from z = −2, 60 × 40 pixels, at what `depth` says of column and row.
    fn frame(depth: impl Fn(usize, usize) -> f32) -> TrainingFrame {
        let mut frame = crate::frame::tests::frame(view(60, 40), None);
        (frame.view.fx, frame.view.fy, frame.view.cx, frame.view.cy) = (50.0, 50.0, 30.0, 20.0);
        frame.rgb = Colors::Floats((0..3 * 2400).map(|k| [0.25, 0.5, 0.75][k % 3]).collect());
        frame.depth = Some((0..2400).map(|i| depth(i % 60, i / 60)).collect());
        frame
    }

    #[test]
    fn a_plane_gives_discs_on_it_that_look_at_the_camera() {
        // z = 3 + x / 2 in the camera: depth d of the column (c + 0.5 - 30) / 50 = t is 3 + t d / 2, so d = 3 / (1 - t / 2).
        let slope = |c: usize, _| 3.0 / (1.0 - (c as f32 + 0.5 - 30.0) / 100.0);
        let surfels = fused_surfels(&[frame(slope)], 300);
        assert!((100..=300).contains(&surfels.len()), "{}", surfels.len());
        let want = Vec3::new(0.5, 0.0, -1.0).normalize();
        for s in &surfels {
            // The world's z is the camera's less 2.
            let off = s.point[2] + 2.0 - (3.0 + s.point[0] / 2.0);
            assert!(off.abs() < 1e-4, "{off}");
            assert!(Vec3::from(s.normal).dot(want) > 0.9999, "{:?}", s.normal);
            assert_eq!(s.color, [0.25, 0.5, 0.75]);
        }
        let model = from_surfels(&surfels, 1).unwrap();
        for i in 0..surfels.len() {
            let row = model.row(i);
            assert!((row.log_scale[0] - row.log_scale[2] - 10f32.ln()).abs() < 1e-5);
            let [w, x, y, z] = row.quat;
            let thin = Vec3::new(
                2.0 * (x * z + w * y),
                2.0 * (y * z - w * x),
                1.0 - 2.0 * (x * x + y * y),
            );
            assert!(thin.dot(want) > 0.9999, "{thin:?}");
            assert!((row.logit - 19f32.ln()).abs() < 1e-4);
            assert!((model.gaussians.sh[12 * i] + 0.25 / SH_C0).abs() < 1e-5);
        }
    }

    #[test]
    fn pixels_at_steps_in_depth_are_left_out_and_views_are_averaged() {
        // A wall at 4 and a box at 2 before it, with a column between them that flies at 3.
        let step = |c: usize, _| match c {
            0..30 => 2.0,
            30 => 3.0,
            _ => 4.0,
        };
        let surfels = fused_surfels(&[frame(step)], 4000);
        assert!(surfels.len() > 1500);
        assert!(surfels.iter().all(|s| s.point[2] == 0.0 || s.point[2] == 2.0));
        // Two views of one wall, 2 cm apart in depth: in cells larger than that, what is between them.
        let pair = [frame(|_, _| 3.0), frame(|_, _| 3.02)];
        let surfels = fused_surfels(&pair, 60);
        assert!((10..=60).contains(&surfels.len()), "{}", surfels.len());
        let mean = surfels.iter().map(|s| s.point[2]).sum::<f32>() / surfels.len() as f32;
        assert!((mean - 1.01).abs() < 0.003, "{mean}");
    }

    #[test]
    fn nothing_comes_of_nothing() {
        assert!(fused_surfels(&[], 10).is_empty());
        assert!(fused_surfels(&[crate::frame::tests::frame(view(6, 4), None)], 10).is_empty());
        for bad in [0.0, f32::NAN, f32::INFINITY, -1.0] {
            assert!(fused_surfels(&[frame(|_, _| bad)], 10).is_empty(), "{bad}");
        }
        // Hidden pixels do not count.
        let mut hidden = frame(|_, _| 3.0);
        hidden.mask = Some(vec![0; 2400]);
        assert!(fused_surfels(&[hidden], 10).is_empty());
        assert_eq!(fused_surfels(&[frame(|_, _| 3.0)], 1).len(), 1);
        assert!(from_surfels(&[], 3).unwrap().is_empty());
    }
}

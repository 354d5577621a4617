//! Scenes that are rooms as captures have them, and scenes that are none: what the classifier of
//! [`scenesplat::recognition`] is fitted to. All of them are made here, so that real files can test it.

use super::RecognitionError;
use scenesplat::kernels::random::{SampleRng, direction, sample_rng, unit};
use scenesplat::rooms::{Capture, SyntheticRoomSettings, generate};
use scenesplat::scene::edit::merge;
use scenesplat::scene::vector::rotation;
use scenesplat::scene::{GaussianScene, SceneError, Similarity, robust_bounds};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Gaussians of a made shape.
const POINTS: usize = 24_000;

/// Fewest and most Gaussians of a thing that stands alone.
const THING: std::ops::Range<usize> = 600..9000;

/// A shape that is no room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Points anywhere in a cube.
    Cube,
    /// Points about one place.
    Cloud,
    /// Heaps of points, each of one color.
    Heaps,
    /// A ball.
    Ball,
    /// A bent tube that ends in itself.
    Knot,
    /// Hills with trees.
    Hills,
    /// A picture whose bright parts stand out of it.
    Relief,
    /// A closed box of the size of a toy.
    Box,
    /// A figure of balls.
    Figure,
}

/// All of them.
pub const SHAPES: [Shape; 9] = [
    Shape::Cube,
    Shape::Cloud,
    Shape::Heaps,
    Shape::Ball,
    Shape::Knot,
    Shape::Hills,
    Shape::Relief,
    Shape::Box,
    Shape::Figure,
];

/// A room as rooms are made.
///
/// # Errors
/// If it cannot be generated.
pub fn room(seed: u64, number: u64, capture: Capture) -> Result<GaussianScene, RecognitionError> {
    Ok(generate(&settings(seed, number, capture))?.scene)
}

fn settings(seed: u64, room: u64, capture: Capture) -> SyntheticRoomSettings {
    let seen_share = if capture == Capture::Scan { 0.5 } else { 0.0 };
    SyntheticRoomSettings {
        seed,
        room,
        capture,
        seen_share,
        flat_share: 0.3,
        ..SyntheticRoomSettings::default()
    }
}

/// Part of a room, as a careless capture has it: thinned, noisy, in another light.
///
/// # Errors
/// If it cannot be generated.
pub fn part(seed: u64, number: u64, capture: Capture) -> Result<GaussianScene, RecognitionError> {
    let mut rng = sample_rng(seed, number, 1);
    let scene = room(seed, number, capture)?;
    let middle = scene.coord[below(&mut rng, scene.len())];
    let reach = 1.5 + 3.0 * unit(&mut rng);
    let every = 1 + below(&mut rng, 4);
    let mut scene = ball(&scene, middle, reach, every)?;
    let noise = 0.03 * unit(&mut rng);
    light(&mut scene, &mut rng);
    for p in &mut scene.coord {
        let off = direction(&mut rng);
        let far = 2.0 * noise * unit(&mut rng);
        p.iter_mut().zip(off).for_each(|(p, off)| *p += (far * off) as f32);
    }
    Ok(scene)
}

/// What of a scene lies within `reach` of a place, and every `every`th row of it.
///
/// # Errors
/// If its columns differ in length.
pub fn ball(
    scene: &GaussianScene,
    middle: [f32; 3],
    reach: f64,
    every: usize,
) -> Result<GaussianScene, SceneError> {
    let away = |p: &[f32; 3]| (0..3).map(|i| f64::from(p[i] - middle[i]).powi(2)).sum::<f64>();
    let rows: Vec<usize> = (0..scene.len())
        .filter(|&row| row % every == 0 && away(&scene.coord[row]) < reach * reach)
        .collect();
    scene.select_rows(&rows)
}

/// One thing of a room, alone, in any size and in many cases in any pose.
///
/// # Errors
/// If it cannot be generated.
pub fn thing(seed: u64, number: u64, capture: Capture) -> Result<GaussianScene, RecognitionError> {
    let mut rng = sample_rng(seed, number, 2);
    let scene = room(seed, number, capture)?;
    let mut things: BTreeMap<i32, Vec<usize>> = BTreeMap::new();
    for (row, id) in scene.instance.iter().flatten().enumerate().filter(|(_, id)| **id >= 0) {
        things.entry(*id).or_default().push(row);
    }
    let things: Vec<Vec<usize>> =
        things.into_values().filter(|rows| THING.contains(&rows.len())).collect();
    let rows = &things[below(&mut rng, things.len())];
    let mut scene = scene.select_rows(rows)?;
    pose(&mut scene, &mut rng);
    light(&mut scene, &mut rng);
    Ok(scene)
}

/// A room in which a shape stands that is no part of it, and the first row of the shape.
///
/// # Errors
/// If it cannot be generated.
pub fn mixed(
    seed: u64,
    number: u64,
    capture: Capture,
) -> Result<(GaussianScene, usize), RecognitionError> {
    let mut rng = sample_rng(seed, number, 4);
    let room = room(seed, number, capture)?;
    let kind = SHAPES[below(&mut rng, SHAPES.len())];
    let shape = shape(seed, number, kind);
    // Some of its Gaussians, as dense as the room's, 0.5 to 1.5 m large, on the floor or in the air.
    let rows: Vec<usize> = (0..shape.len()).step_by(4).collect();
    let mut shape = shape.select_rows(&rows)?;
    let size = robust_bounds(&shape.coord).extent().into_iter().fold(0.0, f64::max);
    let scale = (0.5 + unit(&mut rng)) / size.max(1e-6);
    let place = room.coord[below(&mut rng, room.len())].map(f64::from);
    shape.transform(&Similarity { scale, ..Similarity::IDENTITY });
    let bounds = robust_bounds(&shape.coord);
    let translation = [0, 1, 2].map(|i| place[i] - f64::midpoint(bounds.low[i], bounds.high[i]));
    shape.transform(&Similarity { translation, ..Similarity::IDENTITY });
    let plain = GaussianScene { segment: None, instance: None, normal: None, ..room };
    let foreign = plain.len();
    Ok((merge(vec![plain, shape])?.0, foreign))
}

/// A shape, as points or as an optimised scene has its Gaussians.
pub fn shape(seed: u64, number: u64, shape: Shape) -> GaussianScene {
    let mut rng = sample_rng(seed, number, 3);
    let mut points = Points { rng: &mut rng, coord: Vec::new(), color: Vec::new() };
    points.add(shape);
    let Points { coord, color, .. } = points;
    let count = coord.len();
    let mut scene = GaussianScene {
        log_scale: vec![[0.01_f32.ln(); 3]; count],
        quat: vec![[1.0, 0.0, 0.0, 0.0]; count],
        opacity_logit: vec![f32::INFINITY; count],
        sh_dc: color,
        coord,
        ..GaussianScene::default()
    };
    if unit(&mut rng) < 0.5 {
        splat(&mut scene, &mut rng);
    }
    scene
}

fn below(rng: &mut SampleRng, bound: usize) -> usize {
    ((unit(rng) * bound as f64) as usize).min(bound.saturating_sub(1))
}

/// Sizes, turns and opacities as optimised scenes have them.
fn splat(scene: &mut GaussianScene, rng: &mut SampleRng) {
    let size = robust_bounds(&scene.coord).extent().into_iter().fold(0.0, f64::max);
    for row in 0..scene.len() {
        let base = (size * 0.004).ln() + 1.5 * (unit(rng) + unit(rng) - 1.0);
        scene.log_scale[row] = [0; 3].map(|_| (base - 2.5 * unit(rng)) as f32);
        let [a, b] = [unit(rng), unit(rng)];
        let (s, c) = ((1.0 - a).sqrt(), a.sqrt());
        let turn = [c * (TAU * b).cos(), s, 0.0, c * (TAU * b).sin()];
        scene.quat[row] = turn.map(|v| v as f32);
        scene.opacity_logit[row] = (5.0 * unit(rng) - 3.0) as f32;
    }
}

/// Another light: brighter or darker, paler, and not the same for all.
fn light(scene: &mut GaussianScene, rng: &mut SampleRng) {
    let (gain, bias, pale) = (0.5 + unit(rng), 0.3 * (unit(rng) - 0.5), 0.5 * unit(rng));
    for color in &mut scene.sh_dc {
        let mean = f64::from(color.iter().sum::<f32>()) / 3.0;
        let off = 0.5 * (unit(rng) - 0.5);
        for value in color {
            let paler = f64::from(*value) * (1.0 - pale) + mean * pale;
            *value = (paler * gain + bias + off) as f32;
        }
    }
}

/// The size of a toy, or of a room, and half of the time any pose.
fn pose(scene: &mut GaussianScene, rng: &mut SampleRng) {
    let size = robust_bounds(&scene.coord).extent().into_iter().fold(0.0, f64::max);
    let scale = (0.8 + 2.7 * unit(rng)) / size.max(1e-6);
    let quat: [f64; 4] = match unit(rng) < 0.5 {
        true => [1.0, 0.0, 0.0, unit(rng) - 0.5],
        false => [0; 4].map(|_| unit(rng) - 0.5),
    };
    let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
    let rotation = rotation(quat.map(|v| v / norm));
    scene.transform(&Similarity { rotation, scale, translation: [0.0; 3] });
}

struct Points<'r> {
    rng: &'r mut SampleRng,
    coord: Vec<[f32; 3]>,
    color: Vec<[f32; 3]>,
}

impl Points<'_> {
    fn unit(&mut self) -> f64 {
        unit(self.rng)
    }

    /// About normal, of spread 1.
    fn normal(&mut self) -> f64 {
        (0..6).map(|_| self.unit()).sum::<f64>().mul_add(1.414, -4.243)
    }

    fn paint(&mut self) -> [f64; 3] {
        [0; 3].map(|_| 3.4 * self.unit() - 1.7)
    }

    fn put(&mut self, place: [f64; 3], color: [f64; 3], noise: f64) {
        let off = noise * self.normal();
        self.coord.push(place.map(|v| v as f32));
        self.color.push(color.map(|v| (v + off) as f32));
    }

    fn ball(&mut self, middle: [f64; 3], radius: f64, color: [f64; 3], count: usize) {
        for _ in 0..count {
            let out = direction(self.rng);
            self.put([0, 1, 2].map(|i| middle[i] + radius * out[i]), color, 0.15);
        }
    }

    fn add(&mut self, shape: Shape) {
        match shape {
            Shape::Cube => {
                let size = 1.0 + 4.0 * self.unit();
                for _ in 0..POINTS {
                    let (place, color) = ([0; 3].map(|_| size * self.unit()), self.paint());
                    self.put(place, color, 0.0);
                }
            }
            Shape::Cloud => {
                let (size, paint) = (0.3 + 1.2 * self.unit(), self.paint());
                for _ in 0..POINTS {
                    let place = [0; 3].map(|_| size * self.normal());
                    self.put(place, paint, 0.8);
                }
            }
            Shape::Heaps => self.heaps(),
            Shape::Ball => {
                let (radius, color) = (0.4 + 1.6 * self.unit(), self.paint());
                self.ball([0.0; 3], radius, color, POINTS);
            }
            Shape::Knot => self.knot(),
            Shape::Hills => self.hills(),
            Shape::Relief => self.relief(),
            Shape::Box => self.closed_box(),
            Shape::Figure => {
                for _ in 0..8 {
                    let middle = [0; 3].map(|_| 1.4 * self.unit());
                    let (radius, color) = (0.15 + 0.35 * self.unit(), self.paint());
                    self.ball(middle, radius, color, POINTS / 8);
                }
            }
        }
    }

    fn heaps(&mut self) {
        let size = 1.0 + 4.0 * self.unit();
        for _ in 0..40 {
            let (middle, color) = ([0; 3].map(|_| size * self.unit()), self.paint());
            let wide = size * (0.01 + 0.04 * self.unit());
            for _ in 0..POINTS / 40 {
                let place = middle.map(|v| v + wide * self.normal());
                self.put(place, color, 0.1);
            }
        }
    }

    fn knot(&mut self) {
        let (size, thick) = (0.3 + 0.5 * self.unit(), 0.02 + 0.1 * self.unit());
        let color = self.paint();
        for _ in 0..POINTS {
            let t = TAU * self.unit();
            let r = 2.0 + (3.0 * t).cos();
            let place = [r * (2.0 * t).cos(), r * (2.0 * t).sin(), -(3.0 * t).sin()];
            let place = place.map(|v| size * v + thick * self.normal());
            self.put(place, [color[0] + t.cos(), color[1] + t.sin(), color[2]], 0.1);
        }
    }

    fn hills(&mut self) {
        let (size, high) = (6.0 + 14.0 * self.unit(), 0.2 + 0.8 * self.unit());
        let [a, b] = [0; 2].map(|_| 0.4 + self.unit());
        let height = move |x: f64, y: f64| high * ((a * x).sin() + (b * y).cos());
        for _ in 0..POINTS / 2 {
            let (x, y) = (size * self.unit(), size * self.unit());
            let z = height(x, y) + 0.03 * self.normal();
            self.put([x, y, z], [-0.9, -0.2, -1.0], 0.25);
        }
        for _ in 0..15 {
            let (x, y, tall) = (size * self.unit(), size * self.unit(), 1.5 + 3.0 * self.unit());
            for _ in 0..POINTS / 30 {
                let crown = [x + 0.8 * self.normal(), y + 0.8 * self.normal()];
                let z = height(x, y) + tall + 0.7 * self.normal();
                self.put([crown[0], crown[1], z], [-1.1, -0.3, -1.1], 0.4);
            }
        }
    }

    fn relief(&mut self) {
        let (size, deep) = (1.0 + 2.5 * self.unit(), 0.1 + 0.4 * self.unit());
        let waves: Vec<[f64; 4]> = (0..6)
            .map(|_| [9.0 * self.unit(), 9.0 * self.unit(), TAU * self.unit(), self.unit()])
            .collect();
        let lies = self.unit() < 0.5;
        for _ in 0..POINTS {
            let (x, y) = (size * self.unit(), 0.75 * size * self.unit());
            let bright: f64 = waves.iter().map(|w| w[3] * (w[0] * x + w[1] * y + w[2]).sin()).sum();
            let out = deep * bright / 3.0 + 0.05 * deep * self.normal();
            let place = if lies { [x, y, out] } else { [x, out, y] };
            self.put(place, [0.5 * bright, 0.4 * bright, 0.3 * bright], 0.3);
        }
    }

    fn closed_box(&mut self) {
        let size = [0; 3].map(|_| 0.2 + 0.7 * self.unit());
        for face in 0..6 {
            let color = self.paint();
            for _ in 0..POINTS / 6 {
                let mut place = size.map(|side| side * self.unit());
                place[face / 2] = size[face / 2] * (face % 2) as f64;
                self.put(place, color, 0.1);
            }
        }
    }
}

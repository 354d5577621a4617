//! Scenes, cameras and maps of segments.

use crate::support::{Scene, pinhole};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_rasterizer::lifting::{
    LabelledPicture, LabelledView, LiftRule, LiftSettings, Lifter, NO_SEGMENT, SegmentMap,
    ViewWeights, view_weights,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, View};

/// The golden scene's maps of segments.
pub fn golden_maps(scene: &Scene) -> Vec<SegmentMap> {
    let [width, height] = [scene.views[0].width, scene.views[0].height];
    let map = |ids: &[i32]| {
        let ids = ids.iter().map(|&id| if id < 0 { NO_SEGMENT } else { id as u16 });
        SegmentMap::new(width, height, ids.collect()).unwrap()
    };
    let pixels = scene.views[0].pixels();
    scene.golden.ints("seg").chunks_exact(pixels).map(map).collect()
}

/// A cloud of Gaussians in front of cameras that look along +z, slightly turned.
pub fn cloud(count: usize, views: usize, size: [u32; 2], seed: u64) -> (Gaussians, Vec<View>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut gaussians = Gaussians { sh_degree: 0, ..Gaussians::default() };
    for _ in 0..count {
        let mut any = |low: f32, high: f32| rng.random_range(low..high);
        gaussians.means.push([any(-1.5, 1.5), any(-1.0, 1.0), any(1.5, 4.0)]);
        gaussians.quats.push([any(-1.0, 1.0), any(-1.0, 1.0), any(-1.0, 1.0), any(0.1, 1.0)]);
        gaussians.scales.push([any(0.01, 0.2), any(0.01, 0.2), any(0.01, 0.2)]);
        gaussians.opacities.push(any(0.02, 1.0));
        gaussians.sh.extend([0.0; 3]);
    }
    let view = |i: usize| {
        let (sin, cos) = (0.1 * i as f32 - 0.1).sin_cos();
        let shift = 0.1 * i as f32;
        let world_to_camera =
            [[cos, 0.0, sin, shift], [0.0, 1.0, 0.0, -shift], [-sin, 0.0, cos, 0.0]];
        let middle = pinhole(size, size[0] as f32, 0.0);
        View { world_to_camera, cy: middle.cy + 0.3, ..middle }
    };
    (gaussians, (0..views).map(view).collect())
}

/// Cells around random points, some of them no segment.
pub fn voronoi([width, height]: [u32; 2], segments: u16, seed: u64) -> SegmentMap {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let point = |_| [rng.random_range(0..width), rng.random_range(0..height)].map(f64::from);
    let points: Vec<[f64; 2]> = (0..segments + segments / 5).map(point).collect();
    let nearest = |i: u32| {
        let (x, y) = (f64::from(i % width), f64::from(i / width));
        let distance = |p: &[f64; 2]| (p[0] - x).powi(2) + (p[1] - y).powi(2);
        let order = |a: &usize, b: &usize| distance(&points[*a]).total_cmp(&distance(&points[*b]));
        (0..points.len()).min_by(order).unwrap() as u16
    };
    let ids =
        (0..width * height).map(nearest).map(|id| if id < segments { id } else { NO_SEGMENT });
    SegmentMap::new(width, height, ids.collect()).unwrap()
}

/// One segment everywhere.
pub fn uniform([width, height]: [u32; 2], id: u16) -> SegmentMap {
    SegmentMap::new(width, height, vec![id; (width * height) as usize]).unwrap()
}

/// Random rows.
pub fn rows(count: usize, dim: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count * dim).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// A picture without depth.
pub fn picture<'a>(
    view: &'a View,
    levels: &'a [SegmentMap],
    features: &'a [f32],
) -> LabelledPicture<'a> {
    LabelledPicture { view, levels, features, depth: None }
}

pub fn lifter(gaussians: &Gaussians, levels: usize, dim: usize) -> Lifter<'_> {
    Lifter::new(gaussians, levels, dim, LiftSettings::default()).unwrap()
}

/// Weights of a picture without depth.
pub fn weights(
    gaussians: &Gaussians,
    view: &View,
    levels: &[SegmentMap],
    rule: LiftRule,
) -> ViewWeights {
    let picture = LabelledView { view, levels, depth: None };
    view_weights(gaussians, &picture, rule, &RasterSettings::default()).unwrap()
}

/// Weights of the first granularity. `[gaussians, segments]`
pub fn dense(weights: &ViewWeights, gaussians: usize, segments: usize) -> Vec<f32> {
    let mut out = vec![0.0; gaussians * segments];
    for w in &weights.levels[0] {
        out[w.gaussian as usize * segments + w.segment as usize] = w.weight;
    }
    out
}

/// Weights of all pixels.
pub fn totals(weights: &ViewWeights, gaussians: usize) -> Vec<f32> {
    let mut out = vec![0.0; gaussians];
    weights.totals.iter().for_each(|&(i, w)| out[i as usize] = w);
    out
}

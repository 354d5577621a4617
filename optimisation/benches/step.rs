//! Parts of a training step at 640 × 480 on the Gaussians of a synthetic surface, on one and two threads.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{Criterion, criterion_group, criterion_main};
use scenesplat_optimisation::depth_loss::{DepthOutliers, DepthScratch, depth_loss};
use scenesplat_optimisation::initial::{InitialSettings, from_points};
use scenesplat_optimisation::{
    Adam, AdamSettings, Colors, ImageComparison, Model, OptimiseSettings, Optimiser, Regularisers,
    SsimPadding, TrainingFrame,
};
use scenesplat_rasterizer::backward::{
    GradMask, Gradients, TraceRequest, Upstream, backward_into, trace,
};
use scenesplat_rasterizer::{View, colors, project, tile_lists};
use std::time::Duration;

/// As the program: the system's allocator would add page faults to every picture.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const ROWS: usize = 100_000;
const SIZE: [u32; 2] = [640, 480];

/// Points of a wavy wall that fills the picture.
fn model() -> Model {
    let side = (ROWS as f64).sqrt() as usize;
    let at = |i: usize| {
        let (x, y) = ((i % side) as f32 / side as f32, (i / side) as f32 / side as f32);
        [3.2 * x - 1.6, 2.4 * y - 1.2, 2.0 + 0.3 * (9.0 * x).sin() * (7.0 * y).cos()]
    };
    let points: Vec<[f32; 3]> = (0..ROWS).map(at).collect();
    let color = |p: &[f32; 3]| p.map(|v| 0.5 + 0.5 * (13.0 * v).sin());
    let colors: Vec<[f32; 3]> = points.iter().map(color).collect();
    let settings = InitialSettings { opacity: 0.5, scale: 1.0, sh_degree: 3, random_quats: true };
    from_points(&points, &colors, &settings, 1).expect("a wall")
}

fn frame() -> TrainingFrame {
    let [width, height] = SIZE;
    let view = View {
        world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.]],
        fx: 400.0,
        fy: 400.0,
        cx: 320.0,
        cy: 240.0,
        width,
        height,
    };
    let pixels = view.pixels();
    let rgb = (0..3 * pixels).map(|i| (128.0 + 100.0 * (i as f32 * 0.01).sin()) as u8).collect();
    let depth = Some(vec![2.0; pixels]);
    TrainingFrame { name: "wall".into(), view, rgb: Colors::Bytes(rgb), depth, mask: None }
}

fn parts(c: &mut Criterion) {
    let (model, frame) = (model(), frame());
    let settings = OptimiseSettings { sh_every: 0, ..OptimiseSettings::scenesplat() };
    let (raster, view, g) = (settings.raster(), &frame.view, model.gaussians());
    let mut truth = Vec::new();
    frame.rgb.put(&mut truth);
    let request = TraceRequest { rgb: true, depth: true, sh_degree: Some(3) };
    let traced = trace(g, view, &raster, request).expect("a wall");
    let rgb = traced.picture.rgb.clone().unwrap_or_default();
    let drawn = traced.picture.depth_accumulated.clone().unwrap_or_default();
    let measured = frame.depth.clone().unwrap_or_default();
    let mut group = c.benchmark_group("optimise_100k_640x480");
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let name = |part: &str| format!("{part}/{threads}_threads");
        group.bench_function(name("project"), |b| {
            b.iter(|| pool.install(|| project(g, view, &raster)));
        });
        let projected = project(g, view, &raster).expect("a wall");
        group.bench_function(name("colors_sh3"), |b| {
            b.iter(|| pool.install(|| colors(g, view, &projected, 3)));
        });
        group.bench_function(name("sort_and_tiles"), |b| {
            b.iter(|| pool.install(|| tile_lists(&projected, view, &raster)));
        });
        group.bench_function(name("trace_rgb_depth"), |b| {
            b.iter(|| pool.install(|| trace(g, view, &raster, request)));
        });
        for padding in [SsimPadding::Reflect, SsimPadding::Valid] {
            let weights = scenesplat_optimisation::ImageWeights { ssim: 0.2, padding };
            let mut both = ImageComparison::new(640, 480, weights).expect("a size");
            let mut slope = vec![0.0; rgb.len()];
            group.bench_function(name(&format!("l1_ssim_{padding}")), |b| {
                b.iter(|| pool.install(|| both.compare(&rgb, &truth, None, &mut slope)));
            });
        }
        let (mut scratch, mut slope) = (DepthScratch::default(), vec![0.0; drawn.len()]);
        group.bench_function(name("depth_l1"), |b| {
            let rule = DepthOutliers::MedianRule;
            b.iter(|| depth_loss(&drawn, &measured, None, rule, 1.0, &mut scratch, &mut slope));
        });
        let sign = |v: &f32| if *v > 0.3 { 1e-6 } else { -1e-6 };
        let (up_rgb, up_depth): (Vec<f32>, Vec<f32>) =
            (rgb.iter().map(sign).collect(), drawn.iter().map(sign).collect());
        let upstream = Upstream {
            rgb: Some(&up_rgb),
            depth_accumulated: Some(&up_depth),
            ..Upstream::default()
        };
        let mut gradients = Gradients::zeros(g, 0);
        let all = GradMask::all();
        group.bench_function(name("backward"), |b| {
            b.iter(|| {
                let out = &mut gradients;
                pool.install(|| backward_into(g, view, &raster, &traced, &upstream, all, out))
            });
        });
        let (mut other, mut gradients) = (model.clone(), Gradients::zeros(g, 0));
        let mut adam = Adam::new(&other, AdamSettings::default());
        let rates = settings.rates_at(0, 1.0);
        group.bench_function(name("adam_59"), |b| {
            b.iter(|| {
                let regularisers = Regularisers { opacity: 0.01, scale: 0.01 };
                pool.install(|| {
                    adam.step(&mut other, &mut gradients, &rates, regularisers, 3);
                });
            });
        });
        let frames = [frame.clone()];
        let mut optimiser = Optimiser::new(model.clone(), &frames, settings).expect("a wall");
        group.bench_function(name("step"), |b| {
            b.iter(|| pool.install(|| optimiser.step(&frames)));
        });
    }
    group.finish();
}

fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
}

criterion_group!(name = benches; config = criterion(); targets = parts);
criterion_main!(benches);

//! Labels of the garden: weights of one picture, and features of 768 values from them.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod common;

use common::{SEGMENTS, criterion, garden, pool, voronoi};
use criterion::measurement::WallTime;
use criterion::{BatchSize, BenchmarkGroup, Criterion, criterion_group, criterion_main};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::ThreadPool;
use scenesplat_rasterizer::lifting::{
    DepthTolerance, FinaliseSettings, LabelledPicture, LabelledView, LiftRule, LiftSettings,
    Lifter, SegmentMap, view_weights,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, RenderRequest, View, render};
use std::hint::black_box;

const DIM: usize = 768;

/// Features of all views.
fn lift_features(
    group: &mut BenchmarkGroup<'_, WallTime>,
    pool: &ThreadPool,
    gaussians: &Gaussians,
    views: &[View],
    (levels, features): (&[SegmentMap], &[f32]),
) {
    let threads = pool.current_num_threads();
    let mut lifter = Lifter::new(gaussians, 1, DIM, LiftSettings::default()).expect("a lifter");
    for view in views {
        let picture = LabelledPicture { view, levels, features, depth: None };
        pool.install(|| lifter.add(&picture)).expect("weights");
    }
    println!("{} weights of {} pictures", lifter.num_weights(), views.len());
    for (name, finalise) in
        [("mean", FinaliseSettings::default()), ("robust", FinaliseSettings::robust())]
    {
        group.bench_function(format!("features_{name}_3_views/{threads}_threads"), |b| {
            let take = |block| {
                black_box(block);
                Ok(())
            };
            pool.install(|| b.iter(|| lifter.features(0, &finalise, take).expect("features")));
        });
    }
}

fn lift_garden(c: &mut Criterion) {
    let Some((gaussians, views)) = garden() else { return };
    let (view, settings) = (&views[0], &RasterSettings::default());
    let maps: Vec<SegmentMap> = (0..4).map(|l| voronoi(view.width, view.height, l)).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let features: Vec<f32> = (0..SEGMENTS * DIM).map(|_| rng.random_range(-1.0f32..1.0)).collect();
    let mut group = c.benchmark_group("lift_garden_d768");
    for threads in [1, 2] {
        let pool = pool(threads);
        // The yardstick: a pass over the same pixels that keeps nothing but the light left.
        group.bench_function(format!("alpha_only/{threads}_threads"), |b| {
            let request = RenderRequest::default();
            pool.install(|| b.iter(|| render(black_box(&gaussians), view, settings, &request)));
        });
        for levels in [1, 4] {
            let picture = LabelledView { view, levels: &maps[..levels], depth: None };
            let name = format!("weights_{levels}_levels/{threads}_threads");
            group.bench_function(name, |b| {
                let run = || view_weights(&gaussians, &picture, LiftRule::AlphaWeighted, settings);
                pool.install(|| b.iter(run));
            });
        }
        let picture = LabelledView { view, levels: &maps[..1], depth: None };
        group.bench_function(format!("centre_pixel/{threads}_threads"), |b| {
            let run = || view_weights(&gaussians, &picture, LiftRule::CentrePixel, settings);
            pool.install(|| b.iter(run));
        });
        // With the median depth of the same picture, as `lift-labels` takes it.
        let depth = Some(DepthTolerance::RENDERED);
        group.bench_function(format!("picture_own_depth/{threads}_threads"), |b| {
            let levels = &maps[..1];
            let picture = LabelledPicture { view, levels, features: &features, depth: None };
            let empty = || {
                let settings = LiftSettings { depth, ..LiftSettings::default() };
                Lifter::new(&gaussians, 1, DIM, settings).expect("a lifter")
            };
            let add = |mut lifter: Lifter<'_>| lifter.add(&picture).expect("weights");
            pool.install(|| b.iter_batched(empty, add, BatchSize::LargeInput));
        });
        lift_features(&mut group, &pool, &gaussians, &views, (&maps[..1], &features));
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = lift_garden);
criterion_main!(benches);

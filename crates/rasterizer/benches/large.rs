//! 1.5 million real Gaussians at 640×480: rendering, the backward pass and lifting.
//!
//! The largest real scene of the shared data has half a million, so it stands here three times, side
//! by side and all in the picture.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod common;

use common::{SEGMENTS, criterion, pool, signs, voronoi};
use criterion::{Criterion, criterion_group, criterion_main};
use scenesplat_rasterizer::backward::{
    GradMask, Gradients, TraceRequest, Upstream, Workspace, trace,
};
use scenesplat_rasterizer::lifting::{
    FinaliseSettings, LabelledPicture, LabelledView, LiftRule, LiftSettings, Lifter, view_weights,
};
use scenesplat_rasterizer::{Gaussians, RasterSettings, RenderRequest, View, render};
use scenesplat_scene::formats::{ReadOptions, open_scene};
use scenesplat_test_support::shared;
use std::hint::black_box;

const DIM: usize = 768;
/// Copies of the scene.
const COPIES: usize = 3;

/// The scene three times, and a camera in front of it.
fn playbots() -> Option<(Gaussians, View)> {
    let path = shared("real/objects/playbot_sog2_lod/0_0")?;
    let scene = open_scene(&path, &ReadOptions::default()).expect("a scene").scene;
    let one = Gaussians::from_scene(&scene).expect("activated values");
    let mut all = Gaussians { sh_degree: one.sh_degree, ..Gaussians::default() };
    for copy in 0..COPIES {
        // 2 units wide each.
        let shift = 2.1 * (copy as f32 - (COPIES - 1) as f32 / 2.0);
        all.means.extend(one.means.iter().map(|m| [m[0] + shift, m[1], m[2]]));
        all.quats.extend(&one.quats);
        all.scales.extend(&one.scales);
        all.opacities.extend(&one.opacities);
        all.sh.extend(&one.sh);
    }
    // Its y points down, as a camera's does.
    let view = View {
        world_to_camera: [[1., 0., 0., 0.], [0., 1., 0., 0.5], [0., 0., 1., 5.0]],
        fx: 480.0,
        fy: 480.0,
        cx: 320.0,
        cy: 240.0,
        width: 640,
        height: 480,
    };
    Some((all, view))
}

fn large(c: &mut Criterion) {
    let Some((gaussians, view)) = playbots() else { return };
    let settings = &RasterSettings::default();
    let rgb = RenderRequest::rgb();
    let seen = render(&gaussians, &view, settings, &rgb).expect("a picture");
    println!("{} Gaussians, {:?}", gaussians.len(), seen.work);
    let mut group = c.benchmark_group("large_1500k");
    let traced = trace(&gaussians, &view, settings, TraceRequest::rgb()).expect("a picture");
    let gradient = signs(3 * view.pixels());
    let upstream = Upstream { rgb: Some(&gradient), ..Upstream::default() };
    let (mut out, mut workspace) = (Gradients::zeros(&gaussians, 0), Workspace::new());
    let map = [voronoi(view.width, view.height, 0)];
    for threads in [1, 2] {
        let pool = pool(threads);
        group.bench_function(format!("rgb/{threads}_threads"), |b| {
            b.iter(|| pool.install(|| render(&gaussians, &view, settings, &rgb)));
        });
        group.bench_function(format!("backward_rgb/{threads}_threads"), |b| {
            let mask = GradMask::all();
            b.iter(|| {
                let out = &mut out;
                pool.install(|| {
                    workspace.backward(&gaussians, &view, settings, &traced, &upstream, mask, out)
                })
            });
        });
        group.bench_function(format!("lift_weights/{threads}_threads"), |b| {
            let picture = LabelledView { view: &view, levels: &map, depth: None };
            let run = || view_weights(&gaussians, &picture, LiftRule::AlphaWeighted, settings);
            pool.install(|| b.iter(run));
        });
        let features = vec![0.5; SEGMENTS * DIM];
        let mut lifter =
            Lifter::new(&gaussians, 1, DIM, LiftSettings::default()).expect("a lifter");
        let picture =
            LabelledPicture { view: &view, levels: &map, features: &features, depth: None };
        lifter.add(&picture).expect("weights");
        group.bench_function(format!("lift_features_1_view/{threads}_threads"), |b| {
            let finalise = FinaliseSettings::default();
            let take = |block| {
                black_box(block);
                Ok(())
            };
            pool.install(|| b.iter(|| lifter.features(0, &finalise, take).expect("features")));
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = large);
criterion_main!(benches);

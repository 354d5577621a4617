//! The backward pass from a picture of the garden, on one and two threads.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod common;

use common::{criterion, garden, pool, signs};
use criterion::{Criterion, criterion_group, criterion_main};
use scenesplat_rasterizer::RasterSettings;
use scenesplat_rasterizer::backward::{
    FeatureGradient, GradMask, Gradients, TraceRequest, Upstream, Workspace, trace,
};

fn render_backward_garden(c: &mut Criterion) {
    let Some((gaussians, views)) = garden() else { return };
    let (view, settings) = (&views[0], &RasterSettings::default());
    let traced = trace(&gaussians, view, settings, TraceRequest::rgb_depth()).expect("a garden");
    let pixels = view.pixels();
    let (rgb, plane) = (signs(3 * pixels), signs(pixels));
    let color = Upstream { rgb: Some(&rgb), ..Upstream::default() };
    let depth = Upstream { depth_expected: Some(&plane), alpha: Some(&plane), ..color };
    let all = GradMask::all();
    let opacities = GradMask { opacities: true, ..GradMask::none() };
    let rows = [
        ("rgb", color, all),
        ("rgb_alpha_depth", depth, all),
        ("sh_only", color, GradMask::sh_only()),
        ("opacities_only", color, opacities),
    ];
    let mut group = c.benchmark_group("render_backward_garden");
    let (mut out, mut workspace) = (Gradients::zeros(&gaussians, 0), Workspace::new());
    for threads in [1, 2] {
        let pool = pool(threads);
        for (name, upstream, mask) in &rows {
            group.bench_function(format!("{name}/{threads}_threads"), |b| {
                b.iter(|| {
                    let out = &mut out;
                    pool.install(|| {
                        workspace
                            .backward(&gaussians, view, settings, &traced, upstream, *mask, out)
                    })
                });
            });
        }
        group.bench_function(format!("trace_rgb/{threads}_threads"), |b| {
            b.iter(|| pool.install(|| trace(&gaussians, view, settings, TraceRequest::rgb())));
        });
    }
    let pool = pool(1);
    let dim = 32;
    let (features, gradient) = (signs(gaussians.len() * dim), signs(pixels * dim));
    let features = FeatureGradient { features: &features, gradient: &gradient, dim };
    let upstream = Upstream { features: Some(features), ..Upstream::default() };
    let mut out = Gradients::zeros(&gaussians, dim);
    group.bench_function("features_32/1_threads", |b| {
        b.iter(|| {
            let out = &mut out;
            pool.install(|| {
                workspace.backward(&gaussians, view, settings, &traced, &upstream, all, out)
            })
        });
    });
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = render_backward_garden);
criterion_main!(benches);

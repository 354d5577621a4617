//! The way back from a picture of the garden, on one and two threads.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

#[path = "../tests/support/mod.rs"]
mod support;

use criterion::{Criterion, criterion_group, criterion_main};
use rayon::ThreadPoolBuilder;
use scenesplat_rasterizer::RasterSettings;
use scenesplat_rasterizer::backward::{
    FeatureGradient, GradMask, Gradients, TraceRequest, Upstream, backward_into, trace,
};
use std::time::Duration;

/// Gradients that look like those of an L1 loss: ±1 per value.
fn signs(len: usize) -> Vec<f32> {
    (0..len as u32)
        .map(|i| if i.wrapping_mul(2_654_435_769) >> 31 == 0 { 1.0 } else { -1.0 })
        .collect()
}

fn render_backward_garden(c: &mut Criterion) {
    let Some((gaussians, views)) = support::garden() else { return };
    let (view, settings) = (&views[0], &RasterSettings::default());
    let traced = trace(&gaussians, view, settings, TraceRequest::rgb_depth()).expect("a garden");
    let pixels = view.pixels();
    let (rgb, plane) = (signs(3 * pixels), signs(pixels));
    let colour = Upstream { rgb: Some(&rgb), ..Upstream::default() };
    let depth = Upstream { depth_expected: Some(&plane), alpha: Some(&plane), ..colour };
    let all = GradMask::all();
    let opacities = GradMask { opacities: true, ..GradMask::none() };
    let rows = [
        ("rgb", colour, all),
        ("rgb_alpha_depth", depth, all),
        ("sh_only", colour, GradMask::sh_only()),
        ("opacities_only", colour, opacities),
    ];
    let mut group = c.benchmark_group("render_backward_garden");
    let mut out = Gradients::zeros(&gaussians, 0);
    for threads in [1, 2] {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        for (name, upstream, mask) in &rows {
            group.bench_function(format!("{name}/{threads}_threads"), |b| {
                b.iter(|| {
                    let out = &mut out;
                    pool.install(|| {
                        backward_into(&gaussians, view, settings, &traced, upstream, *mask, out)
                    })
                });
            });
        }
        group.bench_function(format!("trace_rgb/{threads}_threads"), |b| {
            b.iter(|| pool.install(|| trace(&gaussians, view, settings, TraceRequest::rgb())));
        });
    }
    let pool = ThreadPoolBuilder::new().num_threads(1).build().expect("a thread pool");
    let dim = 32;
    let (features, gradient) = (signs(gaussians.len() * dim), signs(pixels * dim));
    let features = FeatureGradient { features: &features, gradient: &gradient, dim };
    let upstream = Upstream { features: Some(features), ..Upstream::default() };
    let mut out = Gradients::zeros(&gaussians, dim);
    group.bench_function("features_32/1_threads", |b| {
        b.iter(|| {
            let out = &mut out;
            pool.install(|| backward_into(&gaussians, view, settings, &traced, &upstream, all, out))
        });
    });
    group.finish();
}

fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
}

criterion_group!(name = benches; config = criterion(); targets = render_backward_garden);
criterion_main!(benches);

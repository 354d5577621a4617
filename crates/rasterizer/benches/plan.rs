//! What a scan of a scene costs beside a picture of it.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod common;

use common::{criterion, garden, pool};
use criterion::{Criterion, criterion_group, criterion_main};
use scenesplat_rasterizer::{RasterSettings, RenderRequest, SceneProfile, render};

fn plan_garden(c: &mut Criterion) {
    let Some((gaussians, views)) = garden() else { return };
    let mut plain = gaussians.clone();
    for row in plain.sh.chunks_mut(48) {
        row[3..].fill(0.0);
    }
    let mut group = c.benchmark_group("plan_garden");
    let pool = pool(1);
    let settings = RasterSettings::default();
    group.bench_function("render", |b| {
        let run = || render(&gaussians, &views[0], &settings, &RenderRequest::rgb());
        b.iter(|| pool.install(run));
    });
    group.bench_function("scan", |b| b.iter(|| pool.install(|| SceneProfile::scan(&gaussians))));
    // Bands that are all 0 have to be read to the end.
    group.bench_function("scan_absent_bands", |b| {
        b.iter(|| pool.install(|| SceneProfile::scan(&plain)));
    });
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = plan_garden);
criterion_main!(benches);

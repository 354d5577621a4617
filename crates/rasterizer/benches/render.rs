//! Rendering of the garden: whole pictures on one and two threads, and the stages.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod common;

use common::{criterion, garden, pool};
use criterion::{Criterion, criterion_group, criterion_main};
use scenesplat_rasterizer::{
    DepthRequest, RasterSettings, RenderRequest, Span, TILE, TileVisitor, blend, colors, project,
    render, render_features, tile_lists,
};
use std::hint::black_box;

const PIXELS: usize = TILE * TILE;

/// The loop by itself.
struct Nothing;

impl TileVisitor for Nothing {
    type Output = f32;
    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, _: Span<'_>) {}
    fn finish(self, transmittance: &[f32; PIXELS], _: &[u32; PIXELS]) -> f32 {
        transmittance[0]
    }
}

fn render_garden(c: &mut Criterion) {
    let Some((gaussians, views)) = garden() else { return };
    let (view, settings) = (&views[0], &RasterSettings::default());
    let mut group = c.benchmark_group("render_garden");
    let depth = DepthRequest { accumulated: true, ..DepthRequest::default() };
    let requests = [
        ("rgb", RenderRequest::rgb()),
        ("rgb_depth", RenderRequest { depth, ..RenderRequest::rgb() }),
        ("alpha", RenderRequest::default()),
        ("contributions", RenderRequest { contributions: true, ..RenderRequest::default() }),
    ];
    for threads in [1, 2] {
        let pool = pool(threads);
        for (name, request) in &requests {
            let run = || render(&gaussians, view, settings, request);
            let id = format!("{name}/{threads}_threads");
            group.bench_function(id, |b| b.iter(|| pool.install(run)));
        }
        let projected = project(&gaussians, view, settings).expect("a garden");
        let lists = tile_lists(&projected, view, settings);
        let mut stage = |name: &str, run: &(dyn Fn() + Sync)| {
            group.bench_function(format!("{name}/{threads}_threads"), |b| {
                b.iter(|| pool.install(run));
            });
        };
        stage("project", &|| drop(black_box(project(&gaussians, view, settings))));
        stage("colors", &|| drop(black_box(colors(&gaussians, view, &projected, 3))));
        stage("tile_lists", &|| drop(black_box(tile_lists(&projected, view, settings))));
        stage("blend_nothing", &|| {
            drop(black_box(blend(&projected, &lists, view, settings, |_| Nothing)));
        });
    }
    let pool = pool(1);
    for dim in [16, 64] {
        let features = vec![0.5; gaussians.len() * dim];
        let run = || render_features(&gaussians, view, settings, &features, dim);
        let id = format!("features_{dim}/1_threads");
        group.bench_function(id, |b| b.iter(|| pool.install(run)));
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = render_garden);
criterion_main!(benches);

//! Nearest neighbors between the two halves of a room's points.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use scenesplat_kernels::neighbors::KdTree;
use std::num::NonZero;
use support::{criterion, points};

fn neighbors(c: &mut Criterion) {
    let points = points();
    let (reference, query) = points.split_at(points.len() / 2);
    let build = || KdTree::new(reference).expect("finite points");
    let mut group = c.benchmark_group("neighbors");
    group.throughput(Throughput::Elements(reference.len() as u64));
    group.bench_function("500k/build", |bench| bench.iter(build));
    let tree = build();
    group.throughput(Throughput::Elements(query.len() as u64));
    for k in [1, 4, 25] {
        group.bench_function(format!("500k/{k}_nn"), |bench| {
            bench.iter(|| tree.map_nearest(query, k, || (), |(), _, near| near[k - 1].row));
        });
    }
    // One after the other, in random order, on one thread; beside kiddo, which settles equal distances otherwise.
    let few = &query[..10_000];
    group.throughput(Throughput::Elements(few.len() as u64));
    group.bench_function("10k/25_nn_single", |bench| {
        bench.iter(|| few.iter().map(|&q| tree.nearest(q, 25).len()).sum::<usize>());
    });
    let wide = |points: &[[f32; 3]]| points.iter().map(|p| p.map(f64::from)).collect::<Vec<_>>();
    let (entries, few) = (wide(reference), wide(few));
    let other: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&entries).expect("points");
    let count = NonZero::new(25).expect("not zero");
    let nearest =
        |q: &[f64; 3]| other.query(q).nearest_n::<SquaredEuclidean<f64>>(count).execute().len();
    group.bench_function("10k/25_nn_single_kiddo", |bench| {
        bench.iter(|| few.iter().map(nearest).sum::<usize>());
    });
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = neighbors);
criterion_main!(benches);

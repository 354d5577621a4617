//! 25 nearest neighbors of one point after the other, in random order, on one thread: ours beside kiddo's, on the same input.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

#[path = "../../../crates/kernels/benches/support/mod.rs"]
mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use scenesplat_kernels::neighbors::KdTree;
use std::num::NonZero;
use support::{criterion, points};

fn neighbors(c: &mut Criterion) {
    let points = points();
    let (reference, query) = points.split_at(points.len() / 2);
    let few = &query[..10_000];
    let tree = KdTree::new(reference).expect("finite points");
    let mut group = c.benchmark_group("neighbors");
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

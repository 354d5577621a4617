//! Nearest neighbors between the two halves of a room's points.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::neighbors::KdTree;
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
    // One after the other, in random order, on one thread; `benches/kiddo` does the same with another tree.
    let few = &query[..10_000];
    group.throughput(Throughput::Elements(few.len() as u64));
    group.bench_function("10k/25_nn_single", |bench| {
        bench.iter(|| few.iter().map(|&q| tree.nearest(q, 25).len()).sum::<usize>());
    });
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = neighbors);
criterion_main!(benches);

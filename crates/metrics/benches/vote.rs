//! The neighbor vote between the two halves of a room's points, tree included.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

#[path = "../../kernels/benches/support/mod.rs"]
mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_metrics::vote;
use support::{criterion, points};

fn votes(c: &mut Criterion) {
    const NUM_CLASSES: usize = 20;
    let points = points();
    let (reference, query) = points.split_at(points.len() / 2);
    // Labels by place, as real ones: patches of half a meter.
    let labels: Vec<i32> = reference
        .iter()
        .map(|p| (p.iter().map(|v| (v / 0.5) as i32).sum::<i32>()).rem_euclid(NUM_CLASSES as i32))
        .collect();
    let mut group = c.benchmark_group("vote");
    group.throughput(Throughput::Elements(query.len() as u64));
    group.bench_function("500k/25_nn", |bench| {
        bench.iter(|| vote(reference, &labels, None, query, 25, NUM_CLASSES));
    });
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = votes);
criterion_main!(benches);

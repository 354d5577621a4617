//! Points grouped by voxel.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::grid_sample::{KeyOrder, voxel_groups};
use support::{criterion, points};

fn groups(c: &mut Criterion) {
    let coord = points();
    let mut group = c.benchmark_group("grid_sample");
    group.throughput(Throughput::ElementsAndBytes {
        elements: coord.len() as u64,
        // Points in; order and voxel of each out.
        bytes: 20 * coord.len() as u64,
    });
    for (name, grid_size, key_order) in [
        ("morton_2cm", 0.02, KeyOrder::Morton),
        ("fnv_2cm", 0.02, KeyOrder::Fnv),
        ("fnv_5cm", 0.05, KeyOrder::Fnv),
    ] {
        group.bench_function(format!("1M/{name}"), |bench| {
            bench.iter(|| voxel_groups(&coord, grid_size, key_order));
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = groups);
criterion_main!(benches);

//! Codes and orders along space-filling curves.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::serialization::{Curve, argsort, codes, depth_of};
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use support::{cells, criterion, short, voxels};

fn curves(c: &mut Criterion) {
    let grid_coord = cells();
    let depth = depth_of(&grid_coord).expect("cells in range");
    let mut group = c.benchmark_group("codes");
    group.throughput(Throughput::ElementsAndBytes {
        elements: grid_coord.len() as u64,
        bytes: 20 * grid_coord.len() as u64,
    });
    for curve in Curve::ALL {
        group.bench_function(format!("1M/{}", curve.name()), |bench| {
            bench.iter(|| codes(curve, &grid_coord, depth));
        });
    }
    group.finish();

    let hilbert = codes(Curve::Hilbert, &grid_coord, depth);
    let mut group = c.benchmark_group("argsort");
    group.throughput(Throughput::ElementsAndBytes {
        elements: hilbert.len() as u64,
        bytes: 12 * hilbert.len() as u64,
    });
    group.bench_function("1M/hilbert", |bench| bench.iter(|| argsort(&hilbert)));
    group.finish();
}

fn clouds(c: &mut Criterion) {
    let mut group = c.benchmark_group("serialized_cloud");
    for grid_coord in [voxels(20_000), voxels(100_000), cells()] {
        let n = grid_coord.len();
        group.throughput(Throughput::ElementsAndBytes {
            elements: n as u64,
            // Cells in; codes, order and inverse of four curves out.
            bytes: (12 + 4 * 16) * n as u64,
        });
        group.bench_function(format!("{}/4_orders", short(n)), |bench| {
            bench.iter_batched(
                || grid_coord.clone(),
                |cells| SerializedCloud::new(cells, vec![0, n], &Curve::ALL, CurveDepth::PerScene),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = curves, clouds);
criterion_main!(benches);

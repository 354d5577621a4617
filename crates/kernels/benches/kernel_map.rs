//! Tables of input–output pairs of a convolution.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::kernel_map::KernelMap;
use support::{criterion, voxels};

fn maps(c: &mut Criterion) {
    let grid_coord = voxels(100_000);
    let offsets = [0, grid_coord.len()];
    let mut group = c.benchmark_group("kernel_map");
    for size in [3, 5] {
        let map = KernelMap::build(&grid_coord, &offsets, size).expect("voxels of a room");
        group.throughput(Throughput::ElementsAndBytes {
            elements: grid_coord.len() as u64,
            // Cells in, two row numbers a pair out.
            bytes: (12 * grid_coord.len() + 8 * map.num_pairs()) as u64,
        });
        group.bench_function(format!("100k/k{size}"), |bench| {
            bench.iter(|| KernelMap::build(&grid_coord, &offsets, size));
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = maps);
criterion_main!(benches);

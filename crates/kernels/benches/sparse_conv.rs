//! Submanifold convolution over 3³ taps, tables prebuilt.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::Precision;
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_kernels::sparse_conv::{
    PackedConv, backward_bias, backward_input, backward_weight, forward,
};
use support::{criterion, random, voxels};

const ROWS: usize = 100_000;
const PRECISIONS: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];

fn map() -> KernelMap {
    KernelMap::build(&voxels(ROWS), &[0, ROWS], 3).expect("voxels of a room")
}

fn forwards(c: &mut Criterion) {
    let map = map();
    let mut group = c.benchmark_group("conv3");
    for width in [32, 64, 128, 256, 768] {
        let (x, bias) = (random(ROWS * width), random(width));
        let weight = random(27 * width * width);
        let mut out = vec![0.0; ROWS * width];
        group.throughput(Throughput::Elements((2 * map.num_pairs() * width * width) as u64));
        for precision in PRECISIONS {
            let weight = PackedConv::with_precision(precision, &weight, width, width, 27);
            group.bench_function(format!("100k/{width}_ch/{precision}"), |bench| {
                bench.iter(|| forward(&map, &x, &weight, Some(&bias), &mut out));
            });
        }
    }
    group.finish();
}

fn backwards(c: &mut Criterion) {
    let map = map();
    let mut group = c.benchmark_group("conv3_backward");
    for width in [32, 64] {
        let (x, grad) = (random(ROWS * width), random(ROWS * width));
        let weight = random(27 * width * width);
        let (mut dx, mut dw) = (vec![0.0; ROWS * width], vec![0.0; weight.len()]);
        group.throughput(Throughput::Elements((4 * map.num_pairs() * width * width) as u64));
        for precision in PRECISIONS.into_iter().filter(|p| p.has_gradient()) {
            group.bench_function(format!("100k/{width}_ch/{precision}"), |bench| {
                bench.iter(|| {
                    backward_input(precision, &map, &grad, &weight, width, width, &mut dx);
                    backward_weight(precision, &map, &x, &grad, width, width, &mut dw);
                    backward_bias(&grad, width)
                });
            });
        }
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = forwards, backwards);
criterion_main!(benches);

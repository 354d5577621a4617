//! Attention inside patches of 1024 points; without the products around it.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::Precision;
use scenesplat_kernels::patch_attention::{Heads, backward, forward_with};
use scenesplat_kernels::serialization::Curve;
use scenesplat_kernels::serialized_cloud::{CurveDepth, SerializedCloud};
use support::{criterion, random, voxels};

const ROWS: usize = 100_000;
const PATCH_SIZE: usize = 1024;

fn attention(c: &mut Criterion) {
    let offsets = vec![0, ROWS];
    let cloud = SerializedCloud::new(voxels(ROWS), offsets, &[Curve::Z], CurveDepth::PerScene)
        .expect("voxels of a room");
    let (patches, order) = (cloud.patches(PATCH_SIZE), &cloud.order(0).order);
    let products: usize = patches.patches().iter().map(|p| p.own * p.len).sum();

    let mut group = c.benchmark_group("attention");
    for (count, dim) in [(4, 16), (16, 48)] {
        let heads = Heads { count, dim };
        let width = heads.channels();
        let qkv = random(3 * ROWS * width);
        let mut out = vec![0.0; ROWS * width];
        // Two products: queries with keys, weights with values.
        group.throughput(Throughput::Elements((4 * products * width) as u64));
        for precision in [Precision::F32, Precision::Bf16] {
            group.bench_function(format!("100k/{width}_ch/{precision}"), |bench| {
                bench.iter(|| forward_with(precision, &qkv, heads, &patches, order, &mut out));
            });
        }
        // What it costs that rows lie anywhere.
        let in_order: Vec<u32> = (0..ROWS as u32).collect();
        group.bench_function(format!("100k_rows_in_order/{width}_ch/f32"), |bench| {
            bench.iter(|| {
                forward_with(Precision::F32, &qkv, heads, &patches, &in_order, &mut out);
            });
        });
        let (grad, mut dqkv) = (random(ROWS * width), vec![0.0; qkv.len()]);
        group.throughput(Throughput::Elements((10 * products * width) as u64));
        group.bench_function(format!("backward_100k/{width}_ch/f32"), |bench| {
            bench.iter(|| backward(&qkv, heads, &patches, order, &grad, &mut dqkv));
        });
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = attention);
criterion_main!(benches);

//! Normalization, group reductions and row copies: everything whose limit is memory, not arithmetic.
//!
//! Floors at 40 GB/s, counting every input once and every output once, of 100 000 rows of 64 (25.6 MB)
//! and of 768 (307 MB) channels:
//!
//! | operation | arrays | 64 channels | 768 channels |
//! |---|---|---|---|
//! | forward, apply, gather | 2 | 1.3 ms | 15 ms |
//! | statistics | 1 | 0.64 ms | 7.7 ms |
//! | LayerNorm backward | 3 | 1.9 ms | 23 ms |
//! | BatchNorm backward | 5: the sums are needed before the first gradient | 3.2 ms | 38 ms |
//! | reduce, four rows a group | 1.25 | 0.8 ms | 9.6 ms |
//! | its backward, mean | 1.25 | 0.8 ms | 9.6 ms |
//! | its backward, maximum | 2.25 | 1.4 ms | 17 ms |
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::permute::gather_rows;
use scenesplat_kernels::segment::{Groups, Reduce, reduce, reduce_backward};
use scenesplat_kernels::{batch_norm, layer_norm};
use support::{criterion, random};

const ROWS: usize = 100_000;
/// Rows of a group: about what pooling by two finds on surfaces.
const GROUP: usize = 4;

/// A permutation of the rows without any locality.
fn shuffled() -> Vec<u32> {
    // The step has no divisor in common with the number of rows.
    (0..ROWS as u64).map(|i| (i * 38_197 % ROWS as u64) as u32).collect()
}

fn norms(c: &mut Criterion) {
    for channels in [64, 768] {
        let (x, grad) = (random(ROWS * channels), random(ROWS * channels));
        let (weight, bias) = (random(channels), random(channels));
        let mut out = vec![0.0; ROWS * channels];
        let array = 4 * (ROWS * channels) as u64;

        let mut group = c.benchmark_group("layer_norm");
        group.throughput(Throughput::Bytes(2 * array));
        group.bench_function(format!("100k/{channels}/forward"), |bench| {
            bench.iter(|| layer_norm::forward(&x, None, &weight, &bias, 1e-5, &mut out));
        });
        group.throughput(Throughput::Bytes(3 * array));
        group.bench_function(format!("100k/{channels}/backward"), |bench| {
            bench.iter(|| layer_norm::backward(&x, &grad, &weight, 1e-5, &mut out));
        });
        group.finish();

        let mut group = c.benchmark_group("batch_norm");
        group.throughput(Throughput::Bytes(array));
        group.bench_function(format!("100k/{channels}/statistics"), |bench| {
            bench.iter(|| batch_norm::statistics(&x, channels));
        });
        group.throughput(Throughput::Bytes(2 * array));
        for gelu in [false, true] {
            let name = if gelu { "apply_gelu" } else { "apply" };
            group.bench_function(format!("100k/{channels}/{name}"), |bench| {
                bench.iter(|| batch_norm::apply(&x, &weight, &bias, gelu, &mut out));
            });
        }
        let s = batch_norm::statistics(&x, channels);
        let inverse: Vec<f64> = s.var.iter().map(|v| 1.0 / (v + 1e-3).sqrt()).collect();
        group.throughput(Throughput::Bytes(5 * array));
        group.bench_function(format!("100k/{channels}/backward"), |bench| {
            bench.iter(|| {
                batch_norm::backward(&x, &grad, &weight, &s.mean, &inverse, true, &mut out)
            });
        });
        group.finish();
    }
}

fn rows(c: &mut Criterion) {
    let order = shuffled();
    let offsets = (0..=ROWS).step_by(GROUP).map(|o| o as u32).collect();
    let groups = Groups::new(order.clone(), offsets).expect("groups fit");
    for channels in [64, 768] {
        let x = random(ROWS * channels);
        let pooled = random(groups.len() * channels);
        let mut few = pooled.clone();
        let mut out = vec![0.0; ROWS * channels];
        let array = 4 * (ROWS * channels) as u64;

        let mut group = c.benchmark_group("permute");
        group.throughput(Throughput::Bytes(2 * array));
        group.bench_function(format!("100k/{channels}/gather"), |bench| {
            bench.iter(|| gather_rows(&x, channels, &order, &mut out));
        });
        group.finish();

        let mut group = c.benchmark_group("segment");
        for (how, name) in [(Reduce::Mean, "mean"), (Reduce::Max, "max")] {
            group.throughput(Throughput::Bytes(array + array / GROUP as u64));
            group.bench_function(format!("100k/{channels}/{name}"), |bench| {
                bench.iter(|| reduce(&x, channels, &groups, how, &mut few));
            });
            let read = if how == Reduce::Max { 2 * array } else { array };
            group.throughput(Throughput::Bytes(read + array / GROUP as u64));
            group.bench_function(format!("100k/{channels}/{name}_backward"), |bench| {
                bench.iter(|| reduce_backward(&x, channels, &groups, how, &pooled, &mut out));
            });
        }
        group.finish();
    }
}

criterion_group!(name = benches; config = criterion(); targets = norms, rows);
criterion_main!(benches);

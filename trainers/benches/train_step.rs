//! One step of training the segmentation network: forward, cross entropy and Lovász softmax,
//! backward, AdamW; with and without recomputed blocks.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

#[path = "../../crates/kernels/benches/support/mod.rs"]
mod support;
/// The step of `scenesplat bench`.
#[allow(dead_code, reason = "the program also compares gradients")]
#[path = "../../cli/src/bench/train_step.rs"]
mod train_step;

use candle_core::{Device, Tensor};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::Precision;
use scenesplat_models::{Compute, ModelConfig, PointCloud, PointTransformerV3Config};
use support::{criterion, features, short, voxels};
use train_step::TrainStep;

/// As the program: the system's allocator would add page faults to every product.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn steps(c: &mut Criterion) {
    let config = PointTransformerV3Config { in_channels: 11, ..PointTransformerV3Config::semseg() };
    let mut group = c.benchmark_group("train_step_semseg");
    for n in [10_000, 50_000] {
        let feat = Tensor::from_vec(features(n), (n, 11), &Device::Cpu).expect("11 channels");
        let points = PointCloud::single(voxels(n), feat).expect("equal rows");
        group.throughput(Throughput::Elements(n as u64));
        for precision in [Precision::F32, Precision::Bf16] {
            let compute = Compute { precision, ..config.compute };
            let config = PointTransformerV3Config { compute, ..config.clone() };
            let config = ModelConfig::new(config).with_classes(20);
            for recompute in [false, true] {
                let mut step =
                    TrainStep::new(&config, points.clone(), recompute).expect("a network");
                let kept = if recompute { "recompute" } else { "keep" };
                group.bench_function(format!("{}/{precision}/{kept}", short(n)), |bench| {
                    bench.iter(|| step.run().expect("a finite loss"));
                });
            }
        }
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = steps);
criterion_main!(benches);

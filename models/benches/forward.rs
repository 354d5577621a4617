//! Whole networks, from voxels and features to the output: serialization and tables included.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

#[path = "../../crates/kernels/benches/support/mod.rs"]
mod support;

use candle_core::{Device, Tensor};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scenesplat_kernels::Precision;
use scenesplat_models::weights::WeightSource;
use scenesplat_models::{
    Backbone, Compute, Forward, LitePtConfig, ModelConfig, ParamStore, PointCloud,
    PointTransformerV3Config,
};
use support::{criterion, features, short, voxels};

/// As the program: the system's allocator would add page faults to every product.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Where they differ in speed on a processor without tiles.
const PRECISIONS: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];

fn cloud(n: usize) -> PointCloud {
    let feat = Tensor::from_vec(features(n), (n, 11), &Device::Cpu).expect("11 channels");
    PointCloud::new(voxels(n), feat, vec![0, n]).expect("equal rows")
}

fn bench(
    c: &mut Criterion,
    name: &str,
    precision: Precision,
    network: &dyn Backbone,
    sizes: &[usize],
) {
    let mut group = c.benchmark_group(name);
    for &n in sizes {
        let points = cloud(n);
        group.throughput(Throughput::Elements(n as u64));
        group.bench_function(format!("{}/{precision}", short(n)), |bench| {
            bench.iter(|| {
                let mut rng = ChaCha8Rng::seed_from_u64(0);
                network.forward(&points, &mut Forward::eval(&mut rng)).expect("a forward pass")
            });
        });
    }
    group.finish();
}

fn weights() -> ParamStore {
    ParamStore::frozen(WeightSource::hashed(0, ""))
}

fn language(c: &mut Criterion) {
    for precision in PRECISIONS {
        let compute = Compute { precision, ..Compute::default() };
        let config = PointTransformerV3Config { compute, ..PointTransformerV3Config::language() };
        let network = ModelConfig::new(config).build(weights().builder()).expect("a network");
        bench(c, "forward_language", precision, network.as_ref(), &[10_000, 20_000, 100_000]);
    }
}

fn segmentation(c: &mut Criterion) {
    let mut sizes = vec![10_000, 20_000, 100_000, 400_000];
    if free_memory().is_none_or(|free| free >= MILLION_BYTES) {
        sizes.push(1_000_000);
    } else {
        eprintln!("too little memory for a million voxels: left out");
    }
    for precision in PRECISIONS {
        let compute = Compute { precision, ..Compute::default() };
        let config = PointTransformerV3Config {
            in_channels: 11,
            compute,
            ..PointTransformerV3Config::semseg()
        };
        let network = ModelConfig::new(config)
            .with_classes(20)
            .build(weights().builder())
            .expect("a network");
        bench(c, "forward_semseg", precision, network.as_ref(), &sizes);
    }
}

/// LitePT-S with 768-wide features at unit length.
fn litept_language(c: &mut Criterion) {
    for precision in PRECISIONS {
        let compute = Compute { precision, ..Compute::default() };
        let network = ModelConfig::new(LitePtConfig::small())
            .with_projection(768)
            .with_compute(compute)
            .build(weights().builder())
            .expect("a network");
        let sizes = [10_000, 20_000, 100_000, 400_000];
        bench(c, "forward_litept_s_language", precision, network.as_ref(), &sizes);
    }
}

/// Memory that the segmentation network takes for a million voxels, with some to spare.
const MILLION_BYTES: u64 = 8_000_000_000;

/// Memory that can be had without swapping, bytes; `None` where the system does not tell.
fn free_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib * 1024)
}

criterion_group!(name = benches; config = criterion(); targets = language, litept_language, segmentation);
criterion_main!(benches);

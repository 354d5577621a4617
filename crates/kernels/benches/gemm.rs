//! Matrix products and the fused two-layer network.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, mlp};
use support::{criterion, random, short};

const PRECISIONS: [Precision; 3] = [Precision::F32, Precision::Bf16, Precision::Int8];

fn packed(precision: Precision, k: usize, n: usize) -> PackedMatrix {
    PackedMatrix::from_strided_with(precision, &random(k * n), k, n, 1, k)
}

fn products(c: &mut Criterion) {
    const ROWS: usize = 100_000;
    let mut group = c.benchmark_group("gemm");
    for width in [32, 64, 256, 768] {
        let a = random(ROWS * width);
        let mut out = vec![0.0; ROWS * width];
        group.throughput(Throughput::ElementsAndBytes {
            elements: (2 * ROWS * width * width) as u64,
            bytes: (8 * ROWS * width) as u64,
        });
        for precision in PRECISIONS {
            let b = packed(precision, width, width);
            group.bench_function(format!("{}/{width}_ch/{precision}", short(ROWS)), |bench| {
                bench.iter(|| gemm(&a, &b, Epilogue::default(), &mut out));
            });
        }
    }
    group.finish();
}

fn networks(c: &mut Criterion) {
    const ROWS: usize = 20_000;
    let mut group = c.benchmark_group("mlp");
    for width in [64, 768] {
        let hidden = 4 * width;
        let (a, bias) = (random(ROWS * width), random(hidden));
        let mut out = vec![0.0; ROWS * width];
        group.throughput(Throughput::Elements((4 * ROWS * width * hidden) as u64));
        for precision in PRECISIONS {
            let first = packed(precision, width, hidden);
            let second = packed(precision, hidden, width);
            group.bench_function(format!("{}/{width}_ch/{precision}", short(ROWS)), |bench| {
                bench.iter(|| {
                    let epilogue = Epilogue { residual: Some(&a), ..Epilogue::default() };
                    mlp(&a, (&first, &bias), &second, epilogue, &mut out);
                });
            });
        }
    }
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = products, networks);
criterion_main!(benches);

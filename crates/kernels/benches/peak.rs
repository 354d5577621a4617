//! What this CPU can do at most: multiply–adds that never leave the registers, and sums over an
//! array far larger than any cache.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

mod support;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rayon::prelude::*;
use scenesplat_kernels::simd::Isa;
use std::hint::black_box;
use support::criterion;

/// Independent sums: enough to hide the latency of a multiply–add on two units.
const SUMS: usize = 12;
const STEPS: usize = 1_000_000;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{STEPS, SUMS};
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx512f")]
    pub fn avx512(factor: f32) -> f32 {
        let factor = _mm512_set1_ps(factor);
        let mut sums = [factor; SUMS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm512_fmadd_ps(*sum, factor, factor);
            }
        }
        sums.into_iter().map(|s| _mm512_reduce_add_ps(s)).sum()
    }

    #[target_feature(enable = "avx512f,avx512bf16")]
    pub fn avx512_bf16(factor: f32) -> f32 {
        let pairs = _mm512_cvtne2ps_pbh(_mm512_set1_ps(factor), _mm512_set1_ps(factor));
        let mut sums = [_mm512_set1_ps(factor); SUMS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm512_dpbf16_ps(*sum, pairs, pairs);
            }
        }
        sums.into_iter().map(|s| _mm512_reduce_add_ps(s)).sum()
    }

    #[target_feature(enable = "avx2,fma")]
    pub fn avx2(factor: f32) -> f32 {
        let factor = _mm256_set1_ps(factor);
        let mut sums = [factor; SUMS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm256_fmadd_ps(*sum, factor, factor);
            }
        }
        sums.into_iter().map(|s| _mm_cvtss_f32(_mm256_castps256_ps128(s))).sum()
    }
}

/// Lanes of a register and the loop over them.
type MultiplyAdd = (usize, fn(f32) -> f32);

/// The loop for the instruction set in use; none where there is no version for the CPU.
#[cfg(target_arch = "x86_64")]
fn multiply_add() -> Option<MultiplyAdd> {
    match Isa::current() {
        // SAFETY: the instruction set was detected.
        isa if isa >= Isa::Avx512 => Some((16, |factor| unsafe { x86::avx512(factor) })),
        // SAFETY: as above.
        Isa::Avx2 => Some((8, |factor| unsafe { x86::avx2(factor) })),
        _ => None,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn multiply_add() -> Option<MultiplyAdd> {
    None
}

fn peak(c: &mut Criterion) {
    let threads = rayon::current_num_threads();
    let mut group = c.benchmark_group("peak");
    if let Some((lanes, run)) = multiply_add() {
        let operations = 2 * lanes * SUMS * STEPS;
        let name = Isa::current().min(Isa::Avx512).name();
        group.throughput(Throughput::Elements(operations as u64));
        group.bench_function(format!("{name}/1_thread"), |bench| {
            bench.iter(|| run(black_box(0.5)));
        });
        group.throughput(Throughput::Elements((operations * threads) as u64));
        group.bench_function(format!("{name}/all_threads"), |bench| {
            bench.iter(|| rayon::broadcast(|_| run(black_box(0.5))));
        });
    }
    #[cfg(target_arch = "x86_64")]
    if Isa::current() >= Isa::Avx512Bf16 {
        let operations = 2 * 32 * SUMS * STEPS;
        // SAFETY: the instruction set was detected.
        let run = |factor| unsafe { x86::avx512_bf16(factor) };
        group.throughput(Throughput::Elements((operations * threads) as u64));
        group.bench_function("avx512bf16/all_threads", |bench| {
            bench.iter(|| rayon::broadcast(|_| run(black_box(0.5))));
        });
    }
    let values = vec![1_u64; 1 << 25];
    group.throughput(Throughput::Bytes((values.len() * 8) as u64));
    group.bench_function("read_256_MiB/all_threads", |bench| {
        bench.iter(|| values.par_chunks(1 << 17).map(|part| part.iter().sum::<u64>()).sum::<u64>());
    });
    group.finish();
}

criterion_group!(name = benches; config = criterion(); targets = peak);
criterion_main!(benches);

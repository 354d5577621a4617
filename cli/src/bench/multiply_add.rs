//! Loops that do nothing but multiply and add in registers: the most a processor can do.

use scenesplat::kernels::simd::Isa;

/// Independent sums: enough to hide the latency of a multiply–add on two units.
const SUMS: usize = 12;
/// Rounds of a loop.
const STEPS: usize = 1_000_000;

/// One of the loops.
#[derive(Clone, Copy)]
pub struct Loop {
    /// Operations of one run on one thread; a multiply–add counts as two.
    pub flop: u64,
    /// Runs it; the argument keeps the compiler from knowing the result.
    pub run: fn(f32) -> f32,
}

/// The f32 loop of the instruction set in use.
pub fn f32_loop() -> Loop {
    let per_lane = (2 * SUMS * STEPS) as u64;
    match Isa::current() {
        #[cfg(target_arch = "x86_64")]
        isa if isa >= Isa::Avx512 => Loop {
            flop: 16 * per_lane,
            // SAFETY: the instruction set was detected.
            run: |factor| unsafe { x86::avx512(factor) },
        },
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => Loop {
            flop: 8 * per_lane,
            // SAFETY: as above.
            run: |factor| unsafe { x86::avx2(factor) },
        },
        _ => Loop { flop: 16 * per_lane, run: portable },
    }
}

/// The bf16 loop with f32 sums, where the processor has instructions for it.
pub fn bf16_loop() -> Option<Loop> {
    #[cfg(target_arch = "x86_64")]
    if Isa::current() >= Isa::Avx512Bf16 {
        return Some(Loop {
            flop: 32 * (2 * SUMS * STEPS) as u64,
            // SAFETY: the instruction set was detected.
            run: |factor| unsafe { x86::avx512_bf16(factor) },
        });
    }
    None
}

/// The loop of 8-bit integers with i32 sums, where the processor has instructions for it.
pub fn int8_loop() -> Option<Loop> {
    #[cfg(target_arch = "x86_64")]
    {
        let per_lane = (2 * SUMS * STEPS) as u64;
        if Isa::current() >= Isa::Avx512 && is_x86_feature_detected!("avx512vnni") {
            return Some(Loop {
                flop: 64 * per_lane,
                // SAFETY: the instruction set was detected.
                run: |factor| unsafe { x86::avx512_vnni(factor) },
            });
        }
        if Isa::current() >= Isa::Avx2 && is_x86_feature_detected!("avxvnni") {
            return Some(Loop {
                flop: 32 * per_lane,
                // SAFETY: as above.
                run: |factor| unsafe { x86::avx_vnni(factor) },
            });
        }
    }
    None
}

/// Plain Rust: whatever the target's compiler makes of sixteen sums side by side.
fn portable(factor: f32) -> f32 {
    let factor = [factor; 16];
    let mut sums = [factor; SUMS];
    for _ in 0..STEPS {
        for sum in &mut sums {
            for (s, f) in sum.iter_mut().zip(factor) {
                *s = *s * f + f;
            }
        }
    }
    sums.iter().flatten().sum()
}

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

    #[target_feature(enable = "avx512f,avx512vnni")]
    pub fn avx512_vnni(factor: f32) -> f32 {
        let factor = _mm512_set1_epi32(factor.to_bits().cast_signed());
        let mut sums = [factor; SUMS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm512_dpbusd_epi32(*sum, factor, factor);
            }
        }
        sums.into_iter().map(|s| _mm512_reduce_add_epi32(s) as f32).sum()
    }

    #[target_feature(enable = "avx2,avxvnni")]
    pub fn avx_vnni(factor: f32) -> f32 {
        let factor = _mm256_set1_epi32(factor.to_bits().cast_signed());
        let mut sums = [factor; SUMS];
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm256_dpbusd_avx_epi32(*sum, factor, factor);
            }
        }
        sums.into_iter().map(|s| _mm256_extract_epi32::<0>(s) as f32).sum()
    }
}

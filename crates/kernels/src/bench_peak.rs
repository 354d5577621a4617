//! The most that a processor and its memory can do: loops that `scenesplat bench` compares all others with.

use crate::simd::Isa;
use rayon::prelude::*;

/// Independent sums: enough to hide the latency of a multiply–add on two units.
const SUMS: usize = 12;
/// Rounds of a loop.
const STEPS: usize = 1_000_000;

/// A loop that does nothing but multiply and add in registers.
#[derive(Clone, Copy)]
pub struct Loop {
    /// Operations of one run on one thread; a multiply–add counts as two.
    pub flop: u64,
    /// Runs it; the argument keeps the compiler from knowing the result.
    pub run: fn(f32) -> f32,
}

/// The sum of an array by all threads: as fast as memory can be read, if it is far larger than any cache.
pub fn sum(values: &[u64]) -> u64 {
    /// Words that one task sums.
    const CHUNK: usize = 1 << 17;
    values.par_chunks(CHUNK).map(|part| part.iter().sum::<u64>()).sum()
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
    #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
    if Isa::current() == Isa::Amx {
        return Some(Loop {
            flop: tiles::PRODUCTS * 2 * 16 * 16 * 32,
            // SAFETY: the instruction set was detected, and Linux asked for the tiles.
            run: |_| unsafe { tiles::bf16() },
        });
    }
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
    #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
    if Isa::current() == Isa::Amx && tiles::have_bytes() {
        return Some(Loop {
            flop: tiles::PRODUCTS * 2 * 16 * 16 * 64,
            // SAFETY: as above.
            run: |_| unsafe { tiles::int8() },
        });
    }
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

/// Products of tiles: six sums, all of them of the same two tiles.
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
mod tiles {
    use std::arch::asm;
    use std::arch::x86_64::{__cpuid, __cpuid_count};

    /// One takes a tile unit 16 cycles.
    const ROUNDS: u64 = 60_000;
    /// Products of one run.
    pub const PRODUCTS: u64 = 6 * ROUNDS;

    #[repr(C, align(64))]
    struct Configuration([u8; 64]);

    /// Eight tiles of 16 rows of 64 bytes, as the kernels have them.
    static FULL: Configuration = {
        let mut image = [0; 64];
        image[0] = 1; // palette
        let mut tile = 0;
        while tile < 8 {
            image[16 + 2 * tile] = 64;
            image[48 + tile] = 16;
            tile += 1;
        }
        Configuration(image)
    };

    /// Whether tiles multiply bytes; asked where there are tiles.
    #[allow(unused_unsafe)] // CPUID is safe in newer versions of Rust than the oldest supported one.
    pub fn have_bytes() -> bool {
        // SAFETY: every x86-64 CPU has CPUID.
        unsafe { __cpuid(0).eax >= 7 && __cpuid_count(7, 0).edx & (1 << 25) != 0 }
    }

    macro_rules! products {
        ($name:ident, $product:literal) => {
            /// # Safety
            /// The processor has tiles, and the system lets this process use them.
            pub unsafe fn $name() -> f32 {
                // SAFETY: by the caller's promise; 64 bytes are read, and all that changes is named.
                unsafe {
                    asm!(
                        "ldtilecfg [{configuration}]",
                        "tilezero tmm6",
                        "tilezero tmm7",
                        "2:",
                        concat!($product, " tmm0, tmm6, tmm7"),
                        concat!($product, " tmm1, tmm6, tmm7"),
                        concat!($product, " tmm2, tmm6, tmm7"),
                        concat!($product, " tmm3, tmm6, tmm7"),
                        concat!($product, " tmm4, tmm6, tmm7"),
                        concat!($product, " tmm5, tmm6, tmm7"),
                        "dec {rounds}",
                        "jnz 2b",
                        configuration = in(reg) &FULL,
                        rounds = inout(reg) ROUNDS => _,
                        out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                        out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                        options(nostack)
                    );
                }
                0.0
            }
        };
    }

    products!(bf16, "tdpbf16ps");
    products!(int8, "tdpbssd");
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

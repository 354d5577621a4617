//! Which instruction sets there are, and which of them is used.

use std::sync::OnceLock;

/// Instruction sets that kernels have a version for, slowest first; each includes the ones before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Isa {
    /// Plain Rust, any CPU.
    Portable,
    /// WebAssembly with registers of 128 bits; the same bits as plain Rust, for nothing is fused.
    #[cfg(target_arch = "wasm32")]
    Simd128,
    /// AVX2 with FMA.
    Avx2,
    /// AVX-512F.
    Avx512,
    /// AVX-512F with dot products of bf16 pairs.
    Avx512Bf16,
    /// As before, with bf16 tiles.
    Amx,
}

impl Isa {
    /// All of them, slowest first.
    #[cfg(not(target_arch = "wasm32"))]
    pub const ALL: [Self; 5] =
        [Self::Portable, Self::Avx2, Self::Avx512, Self::Avx512Bf16, Self::Amx];
    /// All of them, slowest first.
    #[cfg(target_arch = "wasm32")]
    pub const ALL: [Self; 2] = [Self::Portable, Self::Simd128];

    /// The instruction set in use: the best that the CPU has, or a lower one named by the
    /// environment variable `SCENESPLAT_ISA` (`portable`, `avx2`, `avx512`, `avx512bf16`, `amx`;
    /// anything else counts as `portable`, and receipts name what was used).
    pub fn current() -> Self {
        static CURRENT: OnceLock<Isa> = OnceLock::new();
        *CURRENT.get_or_init(|| {
            let best = Self::best();
            let Ok(name) = std::env::var("SCENESPLAT_ISA") else { return best };
            // A library has no channel for a warning here, and a typo must not go unnoticed in a
            // measurement: what cannot be read is the slowest.
            let named = Self::ALL.into_iter().find(|isa| isa.name() == name);
            named.unwrap_or(Self::Portable).min(best)
        })
    }

    #[cfg(target_arch = "x86_64")]
    fn best() -> Self {
        let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
        if avx2 && is_x86_feature_detected!("avx512f") {
            if !is_x86_feature_detected!("avx512bf16") {
                return Self::Avx512;
            }
            #[cfg(target_os = "linux")]
            if crate::gemm::amx::available() {
                return Self::Amx;
            }
            Self::Avx512Bf16
        } else if avx2 {
            Self::Avx2
        } else {
            Self::Portable
        }
    }

    /// A program of a browser is compiled for one set, and does not start without it.
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    fn best() -> Self {
        Self::Simd128
    }

    #[cfg(not(any(
        target_arch = "x86_64",
        all(target_arch = "wasm32", target_feature = "simd128")
    )))]
    fn best() -> Self {
        Self::Portable
    }

    /// Name as the environment variable spells it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            #[cfg(target_arch = "wasm32")]
            Self::Simd128 => "simd128",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Avx512Bf16 => "avx512bf16",
            Self::Amx => "amx",
        }
    }
}

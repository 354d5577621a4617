//! Plain loops compiled for each instruction set: rounding is a call without SSE4.1, and vectors are
//! short without AVX.

/// Calls `$f`, an `#[inline(always)]` function, compiled for the instruction set `$isa`.
///
/// `$isa` comes from [`RasterSettings::isa`](crate::RasterSettings::isa). Nothing is fused that was
/// not written so: results are the same for all.
macro_rules! with_isa {
    ($isa:expr, $f:ident($($arg:ident: $t:ty),* $(,)?) -> $out:ty; $($value:expr),* $(,)?) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx2,fma")]
        unsafe fn avx512($($arg: $t),*) -> $out {
            $f($($arg),*)
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2($($arg: $t),*) -> $out {
            $f($($arg),*)
        }
        match $isa {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the settings name no more than the CPU has.
            isa if isa >= scenesplat_kernels::simd::Isa::Avx512 => unsafe { avx512($($value),*) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            scenesplat_kernels::simd::Isa::Avx2 => unsafe { avx2($($value),*) },
            _ => $f($($value),*),
        }
    }};
}
pub(crate) use with_isa;

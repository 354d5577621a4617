//! Dot products of four bytes: of unsigned rows and signed columns, with sums of i32.

use crate::gemm::micro::TileProducts;
use crate::simd::{Isa, Vector};
use std::sync::OnceLock;

/// How the CPU multiplies bytes; all give the same integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Dots {
    /// Plain Rust.
    Plain,
    /// Pairs of 16 bits, from bytes of which one side has lost its sign to the other.
    Avx2,
    /// Dot products in registers of 256 bits.
    AvxVnni,
    /// Dot products in registers of 512 bits.
    Avx512Vnni,
}

impl Dots {
    /// All of them.
    #[cfg(test)]
    pub(crate) const ALL: [Self; 4] = [Self::Plain, Self::Avx2, Self::AvxVnni, Self::Avx512Vnni];

    /// The fastest that the CPU has and `SCENESPLAT_ISA` allows.
    pub(crate) fn current() -> Self {
        static CURRENT: OnceLock<Dots> = OnceLock::new();
        *CURRENT.get_or_init(|| {
            let fastest_first = [Self::Avx512Vnni, Self::AvxVnni, Self::Avx2];
            fastest_first.into_iter().find(|d| d.is_there()).unwrap_or(Self::Plain)
        })
    }

    /// Whether it may be used.
    pub(crate) fn is_there(self) -> bool {
        let isa = Isa::current();
        match self {
            Self::Plain => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => isa >= Isa::Avx2,
            #[cfg(target_arch = "x86_64")]
            Self::AvxVnni => isa >= Isa::Avx2 && is_x86_feature_detected!("avxvnni"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Vnni => isa >= Isa::Avx512 && is_x86_feature_detected!("avx512vnni"),
            #[cfg(not(target_arch = "x86_64"))]
            _ => isa != Isa::Portable,
        }
    }
}

/// Scales and starting values from a panel's first column on.
#[derive(Clone, Copy)]
pub(crate) struct ColumnScales {
    pub scales: *const f32,
    pub starts: *const i32,
}

/// The scale behind the words of a row.
#[inline(always)]
unsafe fn row_scale(row: *const u32, steps: usize) -> f32 {
    // SAFETY: the caller's row has a word more than steps.
    f32::from_bits(unsafe { row.add(steps).read() })
}

/// Sixteen sums in plain Rust.
pub(crate) struct Plain;

impl TileProducts for Plain {
    type Element = u32;
    type Factor = [u32; 16];
    type Sum = [i32; 16];
    type Value = crate::simd::Plain;
    type Row = f32;
    type Columns = ColumnScales;
    type Scale = Self::Value;
    #[inline(always)]
    unsafe fn load(p: *const u32) -> [u32; 16] {
        // SAFETY: the trait's contract.
        unsafe { p.cast::<[u32; 16]>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn splat(x: u32) -> [u32; 16] {
        [x; 16]
    }
    #[inline(always)]
    unsafe fn multiply_add(a: [u32; 16], b: [u32; 16], mut sum: [i32; 16]) -> [i32; 16] {
        for ((sum, a), b) in sum.iter_mut().zip(a).zip(b) {
            for (a, b) in a.to_ne_bytes().into_iter().zip(b.to_ne_bytes()) {
                *sum = sum.wrapping_add(i32::from(a) * i32::from(b.cast_signed()));
            }
        }
        sum
    }
    #[inline(always)]
    unsafe fn row(row: *const u32, steps: usize) -> f32 {
        // SAFETY: the trait's contract.
        unsafe { row_scale(row, steps) }
    }
    #[inline(always)]
    unsafe fn start(columns: ColumnScales, at: usize) -> [i32; 16] {
        // SAFETY: as above.
        unsafe { columns.starts.add(at).cast::<[i32; 16]>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn scale(columns: ColumnScales, at: usize) -> Self::Value {
        // SAFETY: as above.
        unsafe { Self::Value::load(columns.scales.add(at)) }
    }
    #[inline(always)]
    unsafe fn finish(sum: [i32; 16], row: f32, scale: Self::Value) -> Self::Value {
        let sum = sum.map(|sum| sum as f32);
        // SAFETY: as above.
        unsafe { Self::Value::load(sum.as_ptr()).mul(scale).mul(Self::Value::splat(row)) }
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512Vnni, AvxVnni};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{ColumnScales, TileProducts, row_scale};
    use std::arch::x86_64::*;

    /// The dot products of one register type; `$add` multiplies and adds.
    macro_rules! registers {
        ($(#[$doc:meta])* $name:ident, $int:ty, $float:ty, $load:ident, $splat:ident, $to_float:ident,
         $load_float:ident, $splat_float:ident, $mul:ident,
         start: ($starts:ident) => $start:expr,
         add: ($a:ident, $b:ident, $sum:ident) => $add:expr) => {
            $(#[$doc])*
            pub(crate) struct $name;

            impl TileProducts for $name {
                type Element = u32;
                type Factor = $int;
                type Sum = $int;
                type Value = $float;
                type Row = f32;
                type Columns = ColumnScales;
                type Scale = $float;
                #[inline(always)]
                unsafe fn load(p: *const u32) -> $int {
                    // SAFETY: the trait's contract.
                    unsafe { $load(p.cast()) }
                }
                #[inline(always)]
                unsafe fn splat(x: u32) -> $int {
                    // SAFETY: as above.
                    unsafe { $splat(x.cast_signed()) }
                }
                #[inline(always)]
                unsafe fn multiply_add($a: $int, $b: $int, $sum: $int) -> $int {
                    // SAFETY: as above.
                    unsafe { $add }
                }
                #[inline(always)]
                unsafe fn row(row: *const u32, steps: usize) -> f32 {
                    // SAFETY: as above.
                    unsafe { row_scale(row, steps) }
                }
                #[inline(always)]
                unsafe fn start(columns: ColumnScales, at: usize) -> $int {
                    // SAFETY: as above.
                    unsafe {
                        let $starts = columns.starts.add(at);
                        $start
                    }
                }
                #[inline(always)]
                unsafe fn scale(columns: ColumnScales, at: usize) -> $float {
                    // SAFETY: as above.
                    unsafe { $load_float(columns.scales.add(at)) }
                }
                #[inline(always)]
                unsafe fn finish(sum: $int, row: f32, scale: $float) -> $float {
                    // SAFETY: as above.
                    unsafe { $mul($mul($to_float(sum), scale), $splat_float(row)) }
                }
            }
        };
    }

    registers!(
        /// AVX512-VNNI.
        Avx512Vnni, __m512i, __m512, _mm512_loadu_si512, _mm512_set1_epi32, _mm512_cvtepi32_ps,
        _mm512_loadu_ps, _mm512_set1_ps, _mm512_mul_ps,
        start: (starts) => _mm512_loadu_si512(starts.cast()),
        add: (a, b, sum) => _mm512_dpbusd_epi32(sum, a, b)
    );

    registers!(
        /// AVX-VNNI.
        AvxVnni, __m256i, __m256, _mm256_loadu_si256, _mm256_set1_epi32, _mm256_cvtepi32_ps,
        _mm256_loadu_ps, _mm256_set1_ps, _mm256_mul_ps,
        start: (starts) => _mm256_loadu_si256(starts.cast()),
        add: (a, b, sum) => _mm256_dpbusd_avx_epi32(sum, a, b)
    );

    registers!(
        /// AVX2. Two products with a byte without sign may not fit into 16 bits, so rows get their
        /// signs back and give them to the columns: the sum is at most 2 · 127², and starts at 0.
        Avx2, __m256i, __m256, _mm256_loadu_si256, _mm256_set1_epi32, _mm256_cvtepi32_ps,
        _mm256_loadu_ps, _mm256_set1_ps, _mm256_mul_ps,
        start: (_starts) => _mm256_setzero_si256(),
        add: (a, b, sum) => {
            let a = _mm256_xor_si256(a, _mm256_set1_epi8(-128));
            let pairs = _mm256_maddubs_epi16(_mm256_abs_epi8(a), _mm256_sign_epi8(b, a));
            _mm256_add_epi32(sum, _mm256_madd_epi16(pairs, _mm256_set1_epi16(1)))
        }
    );
}

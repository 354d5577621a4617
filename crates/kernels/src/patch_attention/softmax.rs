//! What the softmax needs of a register: a short exponential and a test of all lanes.

use crate::simd::{Plain, Vector};

/// `(2ˣ − 1) / x` for `0 ≤ x ≤ 1`, lowest power first: our own minimax fit, 8.3e-8 relative in 2ˣ.
/// As 1 is added exactly, 2⁰ is exactly 1, and a row that sees only itself returns its value.
const EXP2_POLY: [f32; 5] = [0.693_151_3, 0.240_164_45, 0.055_799_913, 0.009_017_03, 0.001_867_13];

/// A register that a softmax can be computed in.
pub(super) trait SoftmaxVector: Vector {
    /// `2ˣ`: 0 for −∞ and below about −126 or −149 (depending on the instruction set), +∞ from 128
    /// or a little below, NaN for NaN.
    ///
    /// # Safety
    /// The instruction set must be there.
    #[inline(always)]
    unsafe fn exp2(self) -> Self {
        // SAFETY: the caller's instruction set.
        unsafe {
            // Order matters for NaN: `min`/`max` return the second operand then. At these bounds
            // the power below is 0 and +∞.
            let x = Self::splat(128.4).min(Self::splat(-126.6).max(self));
            let n = x.sub(Self::splat(0.5)).round();
            power_of_fraction(x.sub(n)).scale_by_power(n)
        }
    }

    /// Whether every lane is at most `bound`; NaN is not.
    ///
    /// # Safety
    /// The instruction set must be there.
    #[inline(always)]
    unsafe fn all_at_most(self, bound: f32) -> bool {
        let mut lanes = [f32::NEG_INFINITY; 16];
        // SAFETY: a register has at most 16 lanes; the caller's instruction set.
        unsafe { self.store(lanes.as_mut_ptr()) };
        lanes.iter().all(|&v| v <= bound)
    }

    /// Sum of the lanes, in their order.
    ///
    /// # Safety
    /// The instruction set must be there.
    #[inline(always)]
    unsafe fn total(self) -> f32 {
        let mut lanes = [0f32; 16];
        // SAFETY: as above.
        unsafe { self.store(lanes.as_mut_ptr()) };
        lanes[..Self::LANES].iter().sum()
    }
}

/// `2ˣ` for `0 ≤ x ≤ 1` (and a rounding error beyond).
#[inline(always)]
unsafe fn power_of_fraction<V: Vector>(x: V) -> V {
    // SAFETY: the caller's instruction set.
    unsafe {
        let mut sum = V::splat(EXP2_POLY[4]);
        for c in EXP2_POLY[..4].iter().rev() {
            sum = sum.fma(x, V::splat(*c));
        }
        sum.fma(x, V::splat(1.0))
    }
}

impl SoftmaxVector for Plain {}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
impl SoftmaxVector for std::arch::wasm32::v128 {
    #[inline(always)]
    unsafe fn all_at_most(self, bound: f32) -> bool {
        use std::arch::wasm32::{f32x4_le, f32x4_splat, i32x4_all_true};
        i32x4_all_true(f32x4_le(self, f32x4_splat(bound)))
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{SoftmaxVector, power_of_fraction};
    use std::arch::x86_64::*;

    impl SoftmaxVector for __m256 {
        #[inline(always)]
        unsafe fn all_at_most(self, bound: f32) -> bool {
            // SAFETY: the trait's contract.
            unsafe {
                _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(self, _mm256_set1_ps(bound))) == 0xff
            }
        }
    }

    impl SoftmaxVector for __m512 {
        #[inline(always)]
        unsafe fn exp2(self) -> Self {
            // SAFETY: the trait's contract; `dispatch_softmax!` enables AVX512DQ too.
            unsafe {
                // `x − ⌊x⌋`, 0 for ±∞; `scalef` takes the floor of its exponent by itself and has
                // the right limits.
                let fraction = _mm512_reduce_ps::<0x09>(self);
                _mm512_scalef_ps(power_of_fraction(fraction), self)
            }
        }

        #[inline(always)]
        unsafe fn all_at_most(self, bound: f32) -> bool {
            // SAFETY: the trait's contract.
            unsafe { _mm512_cmp_ps_mask::<_CMP_LE_OQ>(self, _mm512_set1_ps(bound)) == 0xffff }
        }
    }
}

/// Runs `$body` with the best instruction set for attention.
///
/// As [`crate::simd::dispatch`], but AVX-512 must include DQ (every such server CPU since 2017 has
/// it), and `$MR` and `$NV` are bound to rows and registers of the tile that fits the register file.
macro_rules! dispatch_softmax {
    (($($arg:ident: $t:ty),* $(,)?), $V:ident, $MR:ident, $NV:ident => $body:expr) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
        unsafe fn avx512($($arg: $t),*) {
            type $V = std::arch::x86_64::__m512;
            const $MR: usize = 6;
            const $NV: usize = 4;
            // SAFETY: the features are enabled here; the rest is the caller's promise.
            unsafe { $body }
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2($($arg: $t),*) {
            type $V = std::arch::x86_64::__m256;
            const $MR: usize = 6;
            const $NV: usize = 2;
            // SAFETY: as above.
            unsafe { $body }
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        unsafe fn simd128($($arg: $t),*) {
            type $V = std::arch::wasm32::v128;
            const $MR: usize = 6;
            const $NV: usize = 2;
            // SAFETY: as above.
            unsafe { $body }
        }
        #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
        unsafe fn portable($($arg: $t),*) {
            type $V = $crate::simd::Plain;
            const $MR: usize = 2;
            const $NV: usize = 1;
            // SAFETY: as above.
            unsafe { $body }
        }
        match $crate::simd::Isa::current() {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the features were detected.
            isa if isa >= $crate::simd::Isa::Avx512 && is_x86_feature_detected!("avx512dq") => unsafe {
                avx512($($arg),*)
            },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the feature was detected; a CPU with AVX-512 has AVX2.
            isa if isa >= $crate::simd::Isa::Avx2 => unsafe { avx2($($arg),*) },
            #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
            // SAFETY: plain Rust.
            _ => unsafe { portable($($arg),*) },
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            // SAFETY: the program was compiled for it, and would not have started without.
            _ => unsafe { simd128($($arg),*) },
        }
    }};
}
pub(super) use dispatch_softmax;

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    unsafe fn exp2_slice<V: SoftmaxVector>(values: &mut [f32]) {
        for chunk in values.chunks_exact_mut(16) {
            for part in chunk.chunks_exact_mut(V::LANES) {
                // SAFETY: the part is one register long; the caller's instruction set.
                unsafe { V::load(part.as_ptr()).exp2().store(part.as_mut_ptr()) };
            }
        }
    }

    fn exp2(values: &mut [f32]) {
        assert_eq!(values.len() % 16, 0);
        dispatch_softmax!((values: &mut [f32]), V, _MR, _NV => exp2_slice::<V>(values));
    }

    #[test]
    fn exp2_is_accurate_and_total() {
        let x: Vec<f32> =
            (0..160_000).map(|i| (-125.9 + 253.8 * f64::from(i) / 159_999.0) as f32).collect();
        let mut y = x.clone();
        exp2(&mut y);
        for (x, y) in x.iter().zip(&y) {
            let want = f64::from(*x).exp2();
            // 1.5 units in the last place of a value just above a power of two.
            assert!((f64::from(*y) - want).abs() < 1.8e-7 * want, "2^{x} = {y}, want {want}");
        }
        let mut special = [
            0.0,
            -0.0,
            f32::NEG_INFINITY,
            -1e30,
            f32::MIN,
            -150.0,
            f32::INFINITY,
            1e30,
            f32::MAX,
            129.0,
            f32::NAN,
            -1e-30,
            1e-30,
            -1e-8,
            1.0,
            -1.0,
        ];
        exp2(&mut special);
        assert_eq!(
            special[..10],
            [
                1.0,
                1.0,
                0.0,
                0.0,
                0.0,
                0.0,
                f32::INFINITY,
                f32::INFINITY,
                f32::INFINITY,
                f32::INFINITY
            ]
        );
        assert!(special[10].is_nan());
        for (got, want) in special[11..].iter().zip([1.0f32, 1.0, 1.0, 2.0, 0.5]) {
            assert!((got - want).abs() < 2e-7 * want, "{got} {want}");
        }
    }
}

//! Rounding of f32 rows to bf16.
//!
//! Two neighbors along k share one `u32`, the even one in the low half: the order in which both
//! AVX512-BF16 and AMX read them, and also that of a plain row of bf16 values in memory.

use crate::simd::dispatch;

/// Largest finite bf16.
const MOST: u32 = 0x7f7f;

/// The bf16 nearest to `x`, ties to even; overflow gives ∞, NaN gives NaN.
#[inline(always)]
pub(crate) fn round(x: f32) -> u32 {
    let bits = x.to_bits();
    let rounded = (bits.wrapping_add(0x7fff + ((bits >> 16) & 1))) >> 16;
    if x.is_nan() { (bits >> 16) | 0x40 } else { rounded }
}

/// The value of a bf16.
#[inline(always)]
pub(crate) fn widen(bits: u32) -> f32 {
    f32::from_bits(bits << 16)
}

/// `x` as the sum of two bf16 numbers: the nearest one and the nearest to what it leaves. Where the
/// nearest one is ∞ both are cut off instead, so that their sum is finite. ±∞ and NaN leave 0.
#[inline(always)]
pub(crate) fn split(x: f32) -> (u32, u32) {
    let near = round(x);
    let overflows = x.is_finite() && near & 0x7fff > MOST;
    let high = if overflows { near & 0x8000 | MOST } else { near };
    let rest = x - widen(high);
    let low = if overflows { rest.to_bits() >> 16 } else { round(rest) };
    (high, if x.is_finite() { low } else { 0 })
}

/// `to = from`, each value rounded to bf16 and widened again.
pub(crate) fn round_values(from: &[f32], to: &mut [f32]) {
    #[inline(always)]
    unsafe fn run(from: &[f32], to: &mut [f32]) {
        for (t, f) in to.iter_mut().zip(from) {
            *t = widen(round(*f));
        }
    }
    // The register type plays no part; the loop is compiled for the instruction set.
    dispatch!((from: &[f32], to: &mut [f32]), _V => run(from, to));
}

/// Pairs of `from` into `to`, the rest of `to` zero.
pub(crate) fn round_pairs(from: &[f32], to: &mut [u32]) {
    let (pairs, rest) = to.split_at_mut(from.len().div_ceil(2));
    rest.fill(0);
    #[cfg(target_arch = "x86_64")]
    if crate::simd::Isa::current() >= crate::simd::Isa::Avx512Bf16 {
        // SAFETY: the instruction set is there.
        return unsafe { x86::round_pairs(from, pairs) };
    }
    let whole = from.len() / 2;
    for (t, f) in pairs.iter_mut().zip(from.chunks_exact(2)) {
        *t = round(f[0]) | round(f[1]) << 16;
    }
    if whole < pairs.len() {
        pairs[whole] = round(from[2 * whole]);
    }
}

/// Pairs of the high and of the low parts of `from`; the rest of both is zero.
pub(crate) fn split_pairs(from: &[f32], high: &mut [u32], low: &mut [u32]) {
    #[inline(always)]
    unsafe fn run(from: &[f32], high: &mut [u32], low: &mut [u32]) {
        for ((h, l), f) in high.iter_mut().zip(low).zip(from.chunks_exact(2)) {
            let (first, second) = (split(f[0]), split(f[1]));
            *h = first.0 | second.0 << 16;
            *l = first.1 | second.1 << 16;
        }
    }
    let whole = from.len() / 2;
    high[whole..].fill(0);
    low[whole..].fill(0);
    dispatch!((from: &[f32], high: &mut [u32], low: &mut [u32]), _V => run(from, high, low));
    if from.len() % 2 == 1 {
        (high[whole], low[whole]) = split(from[2 * whole]);
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    /// As the function outside; subnormal values count as zero here.
    #[target_feature(enable = "avx512f,avx512bf16")]
    pub(super) unsafe fn round_pairs(from: &[f32], to: &mut [u32]) {
        let whole = from.len() / 32 * 32;
        // SAFETY: loads stay below `from.len()`, stores below half of that, rounded up; masked lanes
        // are not touched.
        unsafe {
            let mut i = 0;
            while i < whole {
                let low = _mm512_loadu_ps(from.as_ptr().add(i));
                let high = _mm512_loadu_ps(from.as_ptr().add(i + 16));
                let pairs: __m512i = std::mem::transmute(_mm512_cvtne2ps_pbh(high, low));
                _mm512_storeu_si512(to.as_mut_ptr().add(i / 2).cast(), pairs);
                i += 32;
            }
            while i < from.len() {
                let count = (from.len() - i).min(16);
                let values =
                    _mm512_maskz_loadu_ps(((1u32 << count) - 1) as u16, from.as_ptr().add(i));
                let pairs: __m512i =
                    std::mem::transmute(_mm512_cvtne2ps_pbh(_mm512_setzero_ps(), values));
                let mask = (1u16 << count.div_ceil(2)) - 1;
                _mm512_mask_storeu_epi32(to.as_mut_ptr().add(i / 2).cast(), mask, pairs);
                i += 16;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_to_nearest_even() {
        // 1 + 2⁻⁸ lies between 1 and 1 + 2⁻⁷, and 1 is even.
        let step = 2f32.powi(-8);
        for (x, want) in [
            (1.0, 1.0),
            (1.0 + step, 1.0),
            (1.0 + step * 1.001, 1.0 + 2.0 * step),
            (1.0 + 3.0 * step, 1.0 + 4.0 * step),
            (-1.0 - 3.0 * step, -1.0 - 4.0 * step),
            (0.0, 0.0),
            (f32::MAX, f32::INFINITY),
            (f32::NEG_INFINITY, f32::NEG_INFINITY),
        ] {
            assert_eq!(widen(round(x)), want, "{x}");
        }
        assert!(widen(round(f32::NAN)).is_nan());
        assert!(widen(round(f32::from_bits(0x7f80_0001))).is_nan());
    }

    #[test]
    fn pairs_of_any_length_are_the_rounded_values() {
        for n in [0_usize, 1, 2, 15, 16, 17, 31, 32, 33, 63, 64, 100, 768] {
            let x: Vec<f32> = (0..n).map(|i| (i as f32 * 0.37).sin() * 1e3).collect();
            let mut pairs = vec![u32::MAX; n.div_ceil(2) + 3];
            round_pairs(&x, &mut pairs);
            for (i, x) in x.iter().enumerate() {
                assert_eq!(pairs[i / 2] >> (16 * (i % 2)) & 0xffff, round(*x), "{n} {i}");
            }
            assert_eq!(pairs[n.div_ceil(2)..], [0; 3]);
            assert!(n % 2 == 0 || pairs[n / 2] >> 16 == 0);
        }
    }

    #[test]
    fn two_parts_hold_sixteen_bits() {
        for i in 0..100_000 {
            let x = (i as f32 * 0.731).sin() * 10f32.powi(i % 64 - 29);
            let (h, l) = split(x);
            let sum = f64::from(widen(h)) + f64::from(widen(l));
            assert!((sum - f64::from(x)).abs() <= f64::from(x.abs()) * 2f64.powi(-17), "{x}");
        }
        let (h, l) = split(f32::MAX);
        let sum = (f64::from(widen(h)) + f64::from(widen(l))) / f64::from(f32::MAX);
        assert!(sum > 0.9999 && sum <= 1.0, "{sum}");
        assert_eq!(split(f32::INFINITY), (0x7f80, 0));
        assert!(widen(split(f32::NAN).0).is_nan());
        let mut parts = [[1u32; 3]; 2];
        let [high, low] = &mut parts;
        split_pairs(&[1.0, 1.0 + 2f32.powi(-12), 3.0], high, low);
        assert_eq!(parts, [[0x3f80_3f80, 0x4040, 0], [0x3980 << 16, 0, 0]]);
    }
}

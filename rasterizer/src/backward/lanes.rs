//! Eight pixels at a time.
//!
//! A Gaussian covers six pixels of a row of a tile on average, so registers of eight, placed at any
//! pixel of the row, do less than those of sixteen. With AVX-512VL the same eight lanes have
//! twice the registers to live in.

use crate::lanes::EXP2;

/// Lanes of a register.
pub(crate) const LANES: usize = 8;

/// Eight f32 values.
///
/// # Safety
/// Methods may only run on a CPU with the implementor's instruction set; pointers must be valid
/// for eight values.
pub(crate) trait Lanes: Copy {
    /// One truth value per lane.
    type Mask: Copy;
    unsafe fn splat(x: f32) -> Self;
    unsafe fn load(p: *const f32) -> Self;
    unsafe fn store(self, p: *mut f32);
    unsafe fn add(self, o: Self) -> Self;
    unsafe fn sub(self, o: Self) -> Self;
    unsafe fn mul(self, o: Self) -> Self;
    unsafe fn div(self, o: Self) -> Self;
    unsafe fn min(self, o: Self) -> Self;
    /// `self · a + b`, fused where the instruction set can.
    unsafe fn fma(self, a: Self, b: Self) -> Self;
    /// `b − self · a`, likewise.
    unsafe fn negative_fma(self, a: Self, b: Self) -> Self;
    /// `2^self` for values up to 0, bit for bit that of the forward pass.
    unsafe fn exp2(self) -> Self;
    /// `self ≥ o`; false for NaN.
    unsafe fn at_least(self, o: Self) -> Self::Mask;
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    unsafe fn any(mask: Self::Mask) -> bool;
    /// `self` where the mask is set, else 0.
    unsafe fn keep(self, mask: Self::Mask) -> Self;
    /// `self` where the mask is set, else `o`.
    unsafe fn or_else(self, mask: Self::Mask, o: Self) -> Self;
    /// The sum of the lanes of each of eight registers.
    unsafe fn sums(v: [Self; 8]) -> Self;
    /// The sum of the lanes.
    unsafe fn sum(self) -> f32;
}

/// Plain floats, any CPU.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f32; LANES]);

impl Plain {
    #[inline(always)]
    fn zip(mut self, o: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        for (a, b) in self.0.iter_mut().zip(o.0) {
            *a = f(*a, b);
        }
        self
    }
}

impl Lanes for Plain {
    type Mask = [bool; LANES];
    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        Self([x; LANES])
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for eight readable values.
        Self(unsafe { p.cast::<[f32; LANES]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for eight writable values.
        unsafe { p.cast::<[f32; LANES]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    unsafe fn add(self, o: Self) -> Self {
        self.zip(o, |a, b| a + b)
    }
    #[inline(always)]
    unsafe fn sub(self, o: Self) -> Self {
        self.zip(o, |a, b| a - b)
    }
    #[inline(always)]
    unsafe fn mul(self, o: Self) -> Self {
        self.zip(o, |a, b| a * b)
    }
    #[inline(always)]
    unsafe fn div(self, o: Self) -> Self {
        self.zip(o, |a, b| a / b)
    }
    #[inline(always)]
    unsafe fn min(self, o: Self) -> Self {
        self.zip(o, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    unsafe fn fma(mut self, a: Self, b: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = self.0[i] * a.0[i] + b.0[i];
        }
        self
    }
    #[inline(always)]
    unsafe fn negative_fma(mut self, a: Self, b: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = b.0[i] - self.0[i] * a.0[i];
        }
        self
    }
    #[inline(always)]
    unsafe fn exp2(mut self) -> Self {
        // Adding and subtracting 1.5 · 2²³ leaves the nearest integer.
        const MAGIC: f32 = 12_582_912.0;
        for x in &mut self.0 {
            let power = if *x > -100.0 { *x } else { -100.0 };
            let n = (power + MAGIC) - MAGIC;
            let f = power - n;
            let poly = EXP2[..5].iter().rev().fold(EXP2[5], |p, c| p * f + c);
            *x = poly * f32::from_bits(((n as i32 + 127) as u32) << 23);
        }
        self
    }
    #[inline(always)]
    unsafe fn at_least(self, o: Self) -> Self::Mask {
        let mut mask = [false; LANES];
        for i in 0..LANES {
            mask[i] = self.0[i] >= o.0[i];
        }
        mask
    }
    #[inline(always)]
    unsafe fn both(mut a: Self::Mask, b: Self::Mask) -> Self::Mask {
        for (a, b) in a.iter_mut().zip(b) {
            *a &= b;
        }
        a
    }
    #[inline(always)]
    unsafe fn any(mask: Self::Mask) -> bool {
        mask.contains(&true)
    }
    #[inline(always)]
    unsafe fn keep(mut self, mask: Self::Mask) -> Self {
        for (a, keep) in self.0.iter_mut().zip(mask) {
            *a = if keep { *a } else { 0.0 };
        }
        self
    }
    #[inline(always)]
    unsafe fn or_else(mut self, mask: Self::Mask, o: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = if mask[i] { self.0[i] } else { o.0[i] };
        }
        self
    }
    #[inline(always)]
    unsafe fn sums(v: [Self; 8]) -> Self {
        Self(v.map(|v| {
            // SAFETY: plain Rust.
            unsafe { v.sum() }
        }))
    }
    #[inline(always)]
    unsafe fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + b) + (c + d)) + ((e + f) + (g + h))
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{LANES, Lanes};
    use crate::lanes::EXP2;
    use std::arch::x86_64::*;

    macro_rules! methods {
        ($($name:ident($me:ident $(, $arg:ident: $t:ty)*) -> $out:ty = $e:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name($me $(, $arg: $t)*) -> $out {
                // SAFETY: the trait's contract: the instruction set is there.
                unsafe { $e }
            }
        )*};
    }

    impl Lanes for __m256 {
        type Mask = __m256;
        #[inline(always)]
        unsafe fn splat(x: f32) -> Self {
            // SAFETY: the trait's contract, here and below.
            unsafe { _mm256_set1_ps(x) }
        }
        #[inline(always)]
        unsafe fn load(p: *const f32) -> Self {
            const { assert!(LANES == 8) };
            // SAFETY: as above, and the caller vouches for eight values.
            unsafe { _mm256_loadu_ps(p) }
        }
        #[inline(always)]
        unsafe fn store(self, p: *mut f32) {
            // SAFETY: as above.
            unsafe { _mm256_storeu_ps(p, self) }
        }
        methods! {
            add(self, o: Self) -> Self = _mm256_add_ps(self, o);
            sub(self, o: Self) -> Self = _mm256_sub_ps(self, o);
            mul(self, o: Self) -> Self = _mm256_mul_ps(self, o);
            div(self, o: Self) -> Self = _mm256_div_ps(self, o);
            min(self, o: Self) -> Self = _mm256_min_ps(self, o);
            fma(self, a: Self, b: Self) -> Self = _mm256_fmadd_ps(self, a, b);
            negative_fma(self, a: Self, b: Self) -> Self = _mm256_fnmadd_ps(self, a, b);
            at_least(self, o: Self) -> Self::Mask = _mm256_cmp_ps::<_CMP_GE_OQ>(self, o);
            keep(self, mask: Self::Mask) -> Self = _mm256_and_ps(self, mask);
            or_else(self, mask: Self::Mask, o: Self) -> Self = _mm256_blendv_ps(o, self, mask);
        }
        #[inline(always)]
        unsafe fn exp2(self) -> Self {
            // SAFETY: as above.
            unsafe {
                // The second operand is what comes of a NaN.
                let x = _mm256_max_ps(self, _mm256_set1_ps(-100.0));
                let n = _mm256_round_ps::<0x08>(x);
                let f = _mm256_sub_ps(x, n);
                let mut poly = _mm256_set1_ps(EXP2[5]);
                for k in (0..5).rev() {
                    poly = _mm256_fmadd_ps(poly, f, _mm256_set1_ps(EXP2[k]));
                }
                // Adds n to the exponent.
                let power = _mm256_slli_epi32::<23>(_mm256_cvtps_epi32(n));
                _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(poly), power))
            }
        }
        #[inline(always)]
        unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            // SAFETY: as above.
            unsafe { _mm256_and_ps(a, b) }
        }
        #[inline(always)]
        unsafe fn any(mask: Self::Mask) -> bool {
            // SAFETY: as above.
            unsafe { _mm256_movemask_ps(mask) != 0 }
        }
        #[inline(always)]
        unsafe fn sums(v: [Self; 8]) -> Self {
            // SAFETY: as above.
            unsafe {
                let ab = _mm256_hadd_ps(v[0], v[1]);
                let cd = _mm256_hadd_ps(v[2], v[3]);
                let ef = _mm256_hadd_ps(v[4], v[5]);
                let gh = _mm256_hadd_ps(v[6], v[7]);
                let low = _mm256_hadd_ps(ab, cd);
                let high = _mm256_hadd_ps(ef, gh);
                let across = _mm256_permute2f128_ps::<0x21>(low, high);
                _mm256_add_ps(_mm256_blend_ps::<0xF0>(low, high), across)
            }
        }
        #[inline(always)]
        unsafe fn sum(self) -> f32 {
            // SAFETY: as above.
            unsafe {
                // The order of `sums`.
                let pairs = _mm256_hadd_ps(self, self);
                let fours = _mm256_hadd_ps(pairs, pairs);
                let high = _mm256_extractf128_ps::<1>(fours);
                _mm_cvtss_f32(_mm_add_ss(_mm256_castps256_ps128(fours), high))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    unsafe fn check<V: Lanes>() {
        let value = |i: usize| (i as f32 * 0.37).sin();
        let values: Vec<f32> = (0..64).map(value).collect();
        // SAFETY: 64 values; the caller vouches for the CPU.
        unsafe {
            let v: [V; 8] = std::array::from_fn(|k| V::load(values.as_ptr().add(8 * k)));
            let mut sums = [0.0f32; 8];
            V::sums(v).store(sums.as_mut_ptr());
            for k in 0..8 {
                let want: f64 = values[8 * k..8 * k + 8].iter().map(|v| f64::from(*v)).sum();
                assert!((f64::from(sums[k]) - want).abs() < 1e-6, "{k}: {sums:?}");
                assert_eq!(v[k].sum(), sums[k], "one order of adding");
            }
            let nan = V::splat(f32::NAN);
            assert!(!V::any(nan.at_least(V::splat(0.0))), "NaN is no pixel's α");
            let mask = V::load(values.as_ptr()).at_least(V::splat(0.5));
            let (mut kept, mut chosen) = ([0.0f32; 8], [0.0f32; 8]);
            V::load(values.as_ptr()).keep(mask).store(kept.as_mut_ptr());
            V::load(values.as_ptr()).or_else(mask, V::splat(-7.0)).store(chosen.as_mut_ptr());
            for i in 0..8 {
                let takes = values[i] >= 0.5;
                assert_eq!(kept[i], if takes { values[i] } else { 0.0 });
                assert_eq!(chosen[i], if takes { values[i] } else { -7.0 });
            }
        }
    }

    #[test]
    fn registers_do_what_they_say() {
        // SAFETY: any CPU.
        unsafe { check::<Plain>() };
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: just detected.
            unsafe { check::<std::arch::x86_64::__m256>() };
        }
    }
}

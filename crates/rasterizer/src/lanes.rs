//! Eight or sixteen pixels of a row of a tile at a time, in the registers of each instruction set.
//!
//! A Gaussian covers five pixels of a row of a tile on average, so registers of eight, placed at any
//! pixel of the row, hold less of what is outside than those of sixteen, which always hold the row.
//! Where there are registers of sixteen they win in the forward pass all the same: half of the
//! instructions, and nothing to find out about places. The backward pass, with its ten sums per Gaussian,
//! is faster with eight; AVX-512VL gives these twice the registers to live in.

use scenesplat_kernels::simd::Isa;

/// Coefficients of the polynomial for `2^f`, `f` in ±½, lowest power first: the one of degree 5, with
/// `2⁰` exact, whose largest relative error is least. That is 9.1e-8, with f32 arithmetic 1.9e-7.
#[allow(clippy::approx_constant, reason = "near ln 2, but not it: that gives a larger error")]
const EXP2: [f32; 6] =
    [1.0, 0.693_147, 0.240_222_42, 0.055_507_336, 0.009_671_513, 0.001_326_472_7];

/// Lanes of the registers that can be placed at any pixel of a row.
pub(crate) const LANES: usize = 8;

/// A register of f32 values.
///
/// # Safety
/// Methods may only run on a CPU with the implementor's instruction set; pointers must be valid
/// for [`Lanes::COUNT`] values.
pub(crate) trait Lanes: Copy {
    /// Values of a register: 8 or 16.
    const COUNT: usize;
    /// One truth value per lane.
    type Mask: Copy;
    unsafe fn splat(x: f32) -> Self;
    unsafe fn load(p: *const f32) -> Self;
    unsafe fn store(self, p: *mut f32);
    unsafe fn add(self, o: Self) -> Self;
    unsafe fn sub(self, o: Self) -> Self;
    unsafe fn mul(self, o: Self) -> Self;
    /// The smaller; `o` if either is NaN.
    unsafe fn min(self, o: Self) -> Self;
    /// The larger; `o` if either is NaN.
    unsafe fn max(self, o: Self) -> Self;
    /// `self · a + b`, fused where the instruction set can.
    unsafe fn fma(self, a: Self, b: Self) -> Self;
    /// `2^self` for values up to 0, within 3e-7 of it; below −100 anything up to 2⁻¹⁰⁰, NaN
    /// anything.
    unsafe fn exp2(self) -> Self;
    /// `self ≥ o`; false for NaN.
    unsafe fn at_least(self, o: Self) -> Self::Mask;
    /// `self > o`; false for NaN.
    unsafe fn above(self, o: Self) -> Self::Mask;
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Lane 0 in the lowest bit.
    unsafe fn bits(mask: Self::Mask) -> u32;
    /// `−self` where the mask is set, else `self`.
    unsafe fn negate(self, mask: Self::Mask) -> Self;
    /// `self` where the mask is set, else 0.
    unsafe fn keep(self, mask: Self::Mask) -> Self;
    /// `self` where the mask is set, else `o`.
    unsafe fn or_else(self, mask: Self::Mask, o: Self) -> Self;
}

/// A register of eight, with what the backward pass needs.
///
/// # Safety
/// As [`Lanes`].
pub(crate) trait Lanes8: Lanes {
    unsafe fn div(self, o: Self) -> Self;
    /// `b − self · a`, fused where the instruction set can.
    unsafe fn negative_fma(self, a: Self, b: Self) -> Self;
    /// The sum of the lanes of each of eight registers.
    unsafe fn sums(v: [Self; 8]) -> Self;
    /// The sum of the lanes.
    unsafe fn sum(self) -> f32;
}

/// Work on the values of a span, in the registers that the span came in.
pub(crate) trait OnLanes {
    /// Runs the work on registers of type `L`.
    ///
    /// # Safety
    /// The CPU has the instruction set of `L`.
    unsafe fn run<L: Lanes>(self);
}

/// Does some work in registers of `count` values, 8 or 16.
///
/// The pixel loop knows its registers, its visitors do not; where this is inlined into the loop the
/// comparison of `count` is gone.
///
/// # Panics
/// If there are no such registers.
///
/// # Safety
/// `isa` is no more than the CPU has, as [`RasterSettings::isa`](crate::RasterSettings::isa) is.
#[inline(always)]
pub(crate) unsafe fn on_lanes(isa: Isa, count: usize, work: impl OnLanes) {
    debug_assert!(isa <= Isa::current());
    #[cfg(target_arch = "x86_64")]
    {
        if count == 16 && isa >= Isa::Avx512 {
            // SAFETY: the caller's promise.
            return unsafe { work.run::<std::arch::x86_64::__m512>() };
        }
        if count == LANES && isa >= Isa::Avx2 {
            // SAFETY: as above; FMA is part of every set above portable.
            return unsafe { work.run::<std::arch::x86_64::__m256>() };
        }
    }
    assert!(count == LANES, "registers of {count} values");
    // SAFETY: plain Rust.
    unsafe { work.run::<Plain>() }
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
    const COUNT: usize = LANES;
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
    unsafe fn min(self, o: Self) -> Self {
        self.zip(o, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    unsafe fn max(self, o: Self) -> Self {
        self.zip(o, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    unsafe fn fma(mut self, a: Self, b: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = self.0[i] * a.0[i] + b.0[i];
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
    unsafe fn above(self, o: Self) -> Self::Mask {
        let mut mask = [false; LANES];
        for i in 0..LANES {
            mask[i] = self.0[i] > o.0[i];
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
    unsafe fn bits(mask: Self::Mask) -> u32 {
        mask.iter().rev().fold(0, |bits, &m| bits << 1 | u32::from(m))
    }
    #[inline(always)]
    unsafe fn negate(mut self, mask: Self::Mask) -> Self {
        for (a, negate) in self.0.iter_mut().zip(mask) {
            *a = if negate { -*a } else { *a };
        }
        self
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
}

impl Lanes8 for Plain {
    #[inline(always)]
    unsafe fn div(self, o: Self) -> Self {
        self.zip(o, |a, b| a / b)
    }
    #[inline(always)]
    unsafe fn negative_fma(mut self, a: Self, b: Self) -> Self {
        for i in 0..LANES {
            self.0[i] = b.0[i] - self.0[i] * a.0[i];
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
    use super::{EXP2, LANES, Lanes, Lanes8};
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

    macro_rules! intrinsics {
        ($($name:ident($($arg:ident: $t:ty),*) -> $out:ty = $e:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name($($arg: $t),*) -> $out {
                // SAFETY: as above, and the caller vouches for the values behind pointers.
                unsafe { $e }
            }
        )*};
    }

    impl Lanes for __m256 {
        const COUNT: usize = LANES;
        type Mask = __m256;
        intrinsics! {
            splat(x: f32) -> Self = _mm256_set1_ps(x);
            load(p: *const f32) -> Self = _mm256_loadu_ps(p);
            both(a: Self::Mask, b: Self::Mask) -> Self::Mask = _mm256_and_ps(a, b);
            bits(mask: Self::Mask) -> u32 = _mm256_movemask_ps(mask) as u32;
        }
        methods! {
            store(self, p: *mut f32) -> () = _mm256_storeu_ps(p, self);
            add(self, o: Self) -> Self = _mm256_add_ps(self, o);
            sub(self, o: Self) -> Self = _mm256_sub_ps(self, o);
            mul(self, o: Self) -> Self = _mm256_mul_ps(self, o);
            min(self, o: Self) -> Self = _mm256_min_ps(self, o);
            max(self, o: Self) -> Self = _mm256_max_ps(self, o);
            fma(self, a: Self, b: Self) -> Self = _mm256_fmadd_ps(self, a, b);
            at_least(self, o: Self) -> Self::Mask = _mm256_cmp_ps::<_CMP_GE_OQ>(self, o);
            above(self, o: Self) -> Self::Mask = _mm256_cmp_ps::<_CMP_GT_OQ>(self, o);
            negate(self, mask: Self::Mask) -> Self =
                _mm256_xor_ps(self, _mm256_and_ps(mask, _mm256_set1_ps(-0.0)));
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
    }

    impl Lanes8 for __m256 {
        methods! {
            div(self, o: Self) -> Self = _mm256_div_ps(self, o);
            negative_fma(self, a: Self, b: Self) -> Self = _mm256_fnmadd_ps(self, a, b);
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

    impl Lanes for __m512 {
        const COUNT: usize = 16;
        type Mask = __mmask16;
        intrinsics! {
            splat(x: f32) -> Self = _mm512_set1_ps(x);
            load(p: *const f32) -> Self = _mm512_loadu_ps(p);
        }
        methods! {
            store(self, p: *mut f32) -> () = _mm512_storeu_ps(p, self);
            add(self, o: Self) -> Self = _mm512_add_ps(self, o);
            sub(self, o: Self) -> Self = _mm512_sub_ps(self, o);
            mul(self, o: Self) -> Self = _mm512_mul_ps(self, o);
            min(self, o: Self) -> Self = _mm512_min_ps(self, o);
            max(self, o: Self) -> Self = _mm512_max_ps(self, o);
            fma(self, a: Self, b: Self) -> Self = _mm512_fmadd_ps(self, a, b);
            at_least(self, o: Self) -> Self::Mask = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(self, o);
            above(self, o: Self) -> Self::Mask = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self, o);
            keep(self, mask: Self::Mask) -> Self = _mm512_maskz_mov_ps(mask, self);
            or_else(self, mask: Self::Mask, o: Self) -> Self = _mm512_mask_blend_ps(mask, o, self);
        }
        #[inline(always)]
        unsafe fn exp2(self) -> Self {
            // SAFETY: as above.
            unsafe {
                let n = _mm512_roundscale_ps::<0x08>(self);
                let f = _mm512_sub_ps(self, n);
                let mut poly = _mm512_set1_ps(EXP2[5]);
                for k in (0..5).rev() {
                    poly = _mm512_fmadd_ps(poly, f, _mm512_set1_ps(EXP2[k]));
                }
                _mm512_scalef_ps(poly, n)
            }
        }
        #[inline(always)]
        unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
            a & b
        }
        #[inline(always)]
        unsafe fn bits(mask: Self::Mask) -> u32 {
            u32::from(mask)
        }
        #[inline(always)]
        unsafe fn negate(self, mask: Self::Mask) -> Self {
            // SAFETY: as above.
            unsafe {
                let (bits, sign) = (_mm512_castps_si512(self), _mm512_set1_epi32(i32::MIN));
                _mm512_castsi512_ps(_mm512_mask_xor_epi32(bits, mask, bits, sign))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sixteen lanes are enough for every register.
    fn wave() -> Vec<f32> {
        (0..64).map(|i| (i as f32 * 0.37).sin()).collect()
    }

    unsafe fn lane<V: Lanes>(v: V) -> Vec<f32> {
        let mut out = vec![0.0f32; V::COUNT];
        // SAFETY: as many values; the caller vouches for the CPU.
        unsafe { v.store(out.as_mut_ptr()) };
        out
    }

    unsafe fn check_sums<V: Lanes8>() {
        let values = wave();
        // SAFETY: 64 values; the caller vouches for the CPU.
        unsafe {
            let v: [V; 8] = std::array::from_fn(|k| V::load(values.as_ptr().add(8 * k)));
            let sums = lane(V::sums(v));
            for k in 0..8 {
                let want: f64 = values[8 * k..8 * k + 8].iter().map(|v| f64::from(*v)).sum();
                assert!((f64::from(sums[k]) - want).abs() < 1e-6, "{k}: {sums:?}");
                assert_eq!(v[k].sum(), sums[k], "one order of adding");
            }
        }
    }

    unsafe fn check<V: Lanes>() {
        let values = wave();
        let all = (1u32 << V::COUNT) - 1;
        // SAFETY: 64 values; the caller vouches for the CPU.
        unsafe {
            let (zero, v) = (V::splat(0.0), V::load(values.as_ptr()));
            let nan = V::splat(f32::NAN);
            assert_eq!(V::bits(nan.at_least(zero)), 0, "NaN is no pixel's α");
            assert_eq!(V::bits(nan.above(zero)), 0, "nor above anything");
            assert_eq!(lane(nan.min(zero)), lane(zero));
            assert_eq!(lane(nan.max(zero)), lane(zero));
            let ramp: Vec<f32> = (0..16).map(|i| i as f32).collect();
            let ramp = V::load(ramp.as_ptr());
            let (at_least, above) = (ramp.at_least(V::splat(3.0)), ramp.above(V::splat(3.0)));
            assert_eq!([V::bits(at_least), V::bits(above)], [all & !0b111, all & !0b1111]);
            assert_eq!(V::bits(V::both(at_least, above)), all & !0b1111);
            let mask = v.at_least(V::splat(0.5));
            let (kept, turned) = (lane(v.keep(mask)), lane(v.negate(mask)));
            let chosen = lane(v.or_else(mask, V::splat(-7.0)));
            let fused = lane(v.fma(ramp, V::splat(0.25)));
            let difference = lane(v.sub(ramp).mul(v));
            for i in 0..V::COUNT {
                let (x, r) = (values[i], i as f32);
                let takes = x >= 0.5;
                assert_eq!(kept[i], if takes { x } else { 0.0 });
                assert_eq!(chosen[i], if takes { x } else { -7.0 });
                assert_eq!(turned[i], if takes { -x } else { x });
                assert!((fused[i] - (x * r + 0.25)).abs() < 1e-6);
                assert_eq!(difference[i], (x - r) * x);
            }
            for start in 0..200 {
                let x: Vec<f32> = (0..V::COUNT).map(|i| -0.003 * (16 * start + i) as f32).collect();
                for (x, power) in x.iter().zip(lane(V::load(x.as_ptr()).exp2())) {
                    let want = f64::from(*x).exp2();
                    assert!((f64::from(power) - want).abs() < 3e-7 * want, "2^{x} = {power}");
                }
            }
            for x in [-100.0, -126.0, -1e9] {
                let power = lane(V::splat(x).exp2())[0];
                assert!((0.0..=1e-30).contains(&power), "2^{x} = {power}");
            }
        }
    }

    #[test]
    fn registers_do_what_they_say() {
        // SAFETY: any CPU.
        unsafe {
            check::<Plain>();
            check_sums::<Plain>();
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: just detected.
            unsafe {
                check::<std::arch::x86_64::__m256>();
                check_sums::<std::arch::x86_64::__m256>();
            }
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: as above.
            unsafe { check::<std::arch::x86_64::__m512>() };
        }
    }
}

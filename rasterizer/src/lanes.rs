//! Sixteen f32 at once: one row of a tile, in the registers of each instruction set.

/// Coefficients of the polynomial for `2^f`, `f` in ±½, lowest power first: the one of degree 5, with
/// `2⁰` exact, whose largest relative error is least. That is 9.1e-8, with f32 arithmetic 1.9e-7.
#[allow(clippy::approx_constant, reason = "near ln 2, but not it: that gives a larger error")]
pub(crate) const EXP2: [f32; 6] =
    [1.0, 0.693_147, 0.240_222_42, 0.055_507_336, 0.009_671_513, 0.001_326_472_7];

/// A row of sixteen f32.
///
/// # Safety
/// Every method may only run on a CPU with the implementor's instruction set.
pub(crate) trait Lanes: Copy {
    /// One truth value per lane.
    type Mask: Copy;
    unsafe fn splat(x: f32) -> Self;
    unsafe fn load(from: &[f32; 16]) -> Self;
    unsafe fn store(self, to: &mut [f32; 16]);
    unsafe fn add(self, o: Self) -> Self;
    unsafe fn sub(self, o: Self) -> Self;
    unsafe fn mul(self, o: Self) -> Self;
    /// The smaller; `o` if either is NaN.
    unsafe fn min(self, o: Self) -> Self;
    /// `self · a + b`, fused where the instruction set can.
    unsafe fn fma(self, a: Self, b: Self) -> Self;
    /// `2^self` for values up to 0, within 3e-7 of it; below −100 anything up to 2⁻¹⁰⁰, NaN
    /// anything.
    unsafe fn exp2(self) -> Self;
    /// `self ≥ o`; false for NaN.
    unsafe fn ge(self, o: Self) -> Self::Mask;
    /// `self > o`; false for NaN.
    unsafe fn gt(self, o: Self) -> Self::Mask;
    unsafe fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// `a` and not `b`.
    unsafe fn and_not(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Lane 0 in the lowest bit.
    unsafe fn bits(mask: Self::Mask) -> u32;
    unsafe fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
}

/// Plain Rust; compilers turn the loops into whatever the target has.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f32; 16]);

macro_rules! plain {
    ($($name:ident($($arg:ident),*) = |$i:ident| $e:expr;)*) => {$(
        #[inline(always)]
        unsafe fn $name(self $(, $arg: Self)*) -> Self {
            Self(std::array::from_fn(|$i| $e(self.0[$i] $(, $arg.0[$i])*)))
        }
    )*};
}

impl Lanes for Plain {
    type Mask = [bool; 16];
    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        Self([x; 16])
    }
    #[inline(always)]
    unsafe fn load(from: &[f32; 16]) -> Self {
        Self(*from)
    }
    #[inline(always)]
    unsafe fn store(self, to: &mut [f32; 16]) {
        *to = self.0;
    }
    plain! {
        add(o) = |i| |a: f32, b: f32| a + b;
        sub(o) = |i| |a: f32, b: f32| a - b;
        mul(o) = |i| |a: f32, b: f32| a * b;
        min(o) = |i| |a: f32, b: f32| if a < b { a } else { b };
        fma(a, b) = |i| |x: f32, a: f32, b: f32| x * a + b;
        exp2() = |i| plain_exp2;
    }
    #[inline(always)]
    unsafe fn ge(self, o: Self) -> [bool; 16] {
        std::array::from_fn(|i| self.0[i] >= o.0[i])
    }
    #[inline(always)]
    unsafe fn gt(self, o: Self) -> [bool; 16] {
        std::array::from_fn(|i| self.0[i] > o.0[i])
    }
    #[inline(always)]
    unsafe fn and(a: [bool; 16], b: [bool; 16]) -> [bool; 16] {
        std::array::from_fn(|i| a[i] & b[i])
    }
    #[inline(always)]
    unsafe fn and_not(a: [bool; 16], b: [bool; 16]) -> [bool; 16] {
        std::array::from_fn(|i| a[i] & !b[i])
    }
    #[inline(always)]
    unsafe fn bits(mask: [bool; 16]) -> u32 {
        mask.iter().rev().fold(0, |bits, &m| bits << 1 | u32::from(m))
    }
    #[inline(always)]
    unsafe fn select(mask: [bool; 16], yes: Self, no: Self) -> Self {
        Self(std::array::from_fn(|i| if mask[i] { yes.0[i] } else { no.0[i] }))
    }
}

/// See [`Lanes::exp2`].
#[inline(always)]
fn plain_exp2(x: f32) -> f32 {
    // Adding and subtracting 1.5 · 2²³ leaves the nearest integer.
    const MAGIC: f32 = 12_582_912.0;
    // The comparison is false for NaN, which then ends here too.
    let x = if x > -100.0 { x } else { -100.0 };
    let n = (x + MAGIC) - MAGIC;
    let f = x - n;
    let poly = EXP2[..5].iter().rev().fold(EXP2[5], |p, c| p * f + c);
    poly * f32::from_bits(((n as i32 + 127) << 23) as u32)
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{EXP2, Lanes};
    use std::arch::x86_64::*;

    macro_rules! methods {
        ($($name:ident($($arg:ident: $t:ty),*) -> $out:ty = $e:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name($($arg: $t),*) -> $out {
                // SAFETY: the trait's contract: the instruction set is there.
                unsafe { $e }
            }
        )*};
    }

    impl Lanes for __m512 {
        type Mask = __mmask16;
        methods! {
            splat(x: f32) -> Self = _mm512_set1_ps(x);
            load(from: &[f32; 16]) -> Self = _mm512_loadu_ps(from.as_ptr());
            and(a: __mmask16, b: __mmask16) -> __mmask16 = _mm512_kand(a, b);
            and_not(a: __mmask16, b: __mmask16) -> __mmask16 = _mm512_kandn(b, a);
            select(mask: __mmask16, yes: Self, no: Self) -> Self =
                _mm512_mask_blend_ps(mask, no, yes);
        }
        #[inline(always)]
        unsafe fn bits(mask: __mmask16) -> u32 {
            u32::from(mask)
        }
        #[inline(always)]
        unsafe fn store(self, to: &mut [f32; 16]) {
            // SAFETY: as above.
            unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self) }
        }
        #[inline(always)]
        unsafe fn add(self, o: Self) -> Self {
            // SAFETY: as above.
            unsafe { _mm512_add_ps(self, o) }
        }
        #[inline(always)]
        unsafe fn sub(self, o: Self) -> Self {
            // SAFETY: as above.
            unsafe { _mm512_sub_ps(self, o) }
        }
        #[inline(always)]
        unsafe fn mul(self, o: Self) -> Self {
            // SAFETY: as above.
            unsafe { _mm512_mul_ps(self, o) }
        }
        #[inline(always)]
        unsafe fn min(self, o: Self) -> Self {
            // SAFETY: as above.
            unsafe { _mm512_min_ps(self, o) }
        }
        #[inline(always)]
        unsafe fn fma(self, a: Self, b: Self) -> Self {
            // SAFETY: as above.
            unsafe { _mm512_fmadd_ps(self, a, b) }
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
        unsafe fn ge(self, o: Self) -> __mmask16 {
            // SAFETY: as above.
            unsafe { _mm512_cmp_ps_mask::<_CMP_GE_OQ>(self, o) }
        }
        #[inline(always)]
        unsafe fn gt(self, o: Self) -> __mmask16 {
            // SAFETY: as above.
            unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self, o) }
        }
    }

    /// Two registers of eight.
    #[derive(Clone, Copy)]
    pub(crate) struct Pair(__m256, __m256);

    macro_rules! pairwise {
        ($($name:ident($($arg:ident),*) = $f:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name(self $(, $arg: Self)*) -> Self {
                // SAFETY: as above.
                unsafe { Self($f(self.0 $(, $arg.0)*), $f(self.1 $(, $arg.1)*)) }
            }
        )*};
    }

    #[inline(always)]
    unsafe fn exp2(x: __m256) -> __m256 {
        // SAFETY: as above.
        unsafe {
            // The second operand is what comes of a NaN.
            let x = _mm256_max_ps(x, _mm256_set1_ps(-100.0));
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

    impl Lanes for Pair {
        type Mask = Self;
        methods! {
            splat(x: f32) -> Self = Self(_mm256_set1_ps(x), _mm256_set1_ps(x));
            load(from: &[f32; 16]) -> Self =
                Self(_mm256_loadu_ps(from.as_ptr()), _mm256_loadu_ps(from.as_ptr().add(8)));
            and(a: Self, b: Self) -> Self =
                Self(_mm256_and_ps(a.0, b.0), _mm256_and_ps(a.1, b.1));
            and_not(a: Self, b: Self) -> Self =
                Self(_mm256_andnot_ps(b.0, a.0), _mm256_andnot_ps(b.1, a.1));
            bits(mask: Self) -> u32 =
                (_mm256_movemask_ps(mask.0) | _mm256_movemask_ps(mask.1) << 8) as u32;
            select(mask: Self, yes: Self, no: Self) -> Self = Self(
                _mm256_blendv_ps(no.0, yes.0, mask.0),
                _mm256_blendv_ps(no.1, yes.1, mask.1)
            );
        }
        #[inline(always)]
        unsafe fn store(self, to: &mut [f32; 16]) {
            // SAFETY: as above.
            unsafe {
                _mm256_storeu_ps(to.as_mut_ptr(), self.0);
                _mm256_storeu_ps(to.as_mut_ptr().add(8), self.1);
            }
        }
        pairwise! {
            add(o) = _mm256_add_ps;
            sub(o) = _mm256_sub_ps;
            mul(o) = _mm256_mul_ps;
            min(o) = _mm256_min_ps;
            fma(a, b) = _mm256_fmadd_ps;
            exp2() = exp2;
        }
        #[inline(always)]
        unsafe fn ge(self, o: Self) -> Self {
            // SAFETY: as above.
            unsafe {
                Self(
                    _mm256_cmp_ps::<_CMP_GE_OQ>(self.0, o.0),
                    _mm256_cmp_ps::<_CMP_GE_OQ>(self.1, o.1),
                )
            }
        }
        #[inline(always)]
        unsafe fn gt(self, o: Self) -> Self {
            // SAFETY: as above.
            unsafe {
                Self(
                    _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, o.0),
                    _mm256_cmp_ps::<_CMP_GT_OQ>(self.1, o.1),
                )
            }
        }
    }
}
#[cfg(target_arch = "x86_64")]
pub(crate) use x86::Pair;

//! Registers of f32, one type for each instruction set.

/// A register of f32 lanes.
///
/// # Safety
/// Every method may only run on a CPU with the implementor's instruction set; pointers must be
/// valid for [`Vector::LANES`] values.
pub(crate) trait Vector: Copy {
    /// Values per register. Divides 16, so a panel of 16 columns is a whole number of registers.
    const LANES: usize;
    unsafe fn zero() -> Self;
    unsafe fn splat(x: f32) -> Self;
    unsafe fn load(p: *const f32) -> Self;
    unsafe fn store(self, p: *mut f32);
    /// The first `n` lanes from memory, `n` at most [`Vector::LANES`]; the others are 0 and their
    /// memory is left alone.
    unsafe fn load_first(p: *const f32, n: usize) -> Self;
    /// Stores the first `n` lanes, `n` at most [`Vector::LANES`].
    unsafe fn store_first(self, p: *mut f32, n: usize);
    unsafe fn add(self, o: Self) -> Self;
    unsafe fn sub(self, o: Self) -> Self;
    unsafe fn mul(self, o: Self) -> Self;
    unsafe fn div(self, o: Self) -> Self;
    unsafe fn max(self, o: Self) -> Self;
    unsafe fn min(self, o: Self) -> Self;
    /// `self · a + b`, fused where the instruction set can.
    unsafe fn fma(self, a: Self, b: Self) -> Self;
    /// Multiplies by `2^n`, `n` given as an integral f32 in `-126..=127`.
    unsafe fn scale_by_power(self, n: Self) -> Self;
    /// Nearest integer, ties to even, for magnitudes below 2²².
    unsafe fn round(self) -> Self;
    /// `if self > bound { yes } else { no }` per lane; NaN takes `no`.
    unsafe fn select_gt(self, bound: Self, yes: Self, no: Self) -> Self;
}

/// Sixteen plain floats; compilers turn the loops into whatever the target has.
#[derive(Clone, Copy)]
pub(crate) struct Plain([f32; 16]);

macro_rules! plain_binary {
    ($($name:ident: $f:expr;)*) => {$(
        #[inline(always)]
        unsafe fn $name(mut self, o: Self) -> Self {
            for (a, b) in self.0.iter_mut().zip(o.0) { *a = $f(*a, b); }
            self
        }
    )*};
}

impl Vector for Plain {
    const LANES: usize = 16;
    #[inline(always)]
    unsafe fn zero() -> Self {
        Self([0.0; 16])
    }
    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        Self([x; 16])
    }
    #[inline(always)]
    unsafe fn load(p: *const f32) -> Self {
        // SAFETY: the caller vouches for 16 readable values.
        Self(unsafe { p.cast::<[f32; 16]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, p: *mut f32) {
        // SAFETY: the caller vouches for 16 writable values.
        unsafe { p.cast::<[f32; 16]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    unsafe fn load_first(p: *const f32, n: usize) -> Self {
        let mut out = [0.0; 16];
        for (i, o) in out.iter_mut().enumerate().take(n) {
            // SAFETY: the caller vouches for `n` readable values.
            *o = unsafe { p.add(i).read() };
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn store_first(self, p: *mut f32, n: usize) {
        for (i, v) in self.0.into_iter().enumerate().take(n) {
            // SAFETY: the caller vouches for `n` writable values.
            unsafe { p.add(i).write(v) };
        }
    }
    plain_binary! {
        add: |a, b| a + b;
        sub: |a, b| a - b;
        mul: |a, b| a * b;
        div: |a, b| a / b;
        max: |a: f32, b: f32| if a > b { a } else { b };
        min: |a: f32, b: f32| if a < b { a } else { b };
    }
    #[inline(always)]
    unsafe fn fma(mut self, a: Self, b: Self) -> Self {
        for i in 0..16 {
            self.0[i] = self.0[i] * a.0[i] + b.0[i];
        }
        self
    }
    #[inline(always)]
    unsafe fn scale_by_power(mut self, n: Self) -> Self {
        for i in 0..16 {
            self.0[i] *= f32::from_bits((((n.0[i] as i32) + 127) << 23) as u32);
        }
        self
    }
    #[inline(always)]
    unsafe fn round(mut self) -> Self {
        // Adding and subtracting 1.5 · 2²³ leaves the nearest integer.
        const MAGIC: f32 = 12_582_912.0;
        for a in &mut self.0 {
            *a = (*a + MAGIC) - MAGIC;
        }
        self
    }
    #[inline(always)]
    unsafe fn select_gt(self, bound: Self, yes: Self, no: Self) -> Self {
        let mut out = no;
        for i in 0..16 {
            if self.0[i] > bound.0[i] {
                out.0[i] = yes.0[i];
            }
        }
        out
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) mod x86 {
    use super::Vector;
    use std::arch::x86_64::*;

    macro_rules! intrinsics {
        ($($name:ident($($arg:ident: $t:ty),*) -> $out:ty = $e:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name($($arg: $t),*) -> $out {
                // SAFETY: the trait's contract: the instruction set is there, pointers are valid. Lanes beyond a
                // mask touch no memory.
                unsafe { $e }
            }
        )*};
    }

    macro_rules! methods {
        ($($name:ident($me:ident $(, $arg:ident: $t:ty)*) -> $out:ty = $e:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name($me $(, $arg: $t)*) -> $out {
                // SAFETY: as above.
                unsafe { $e }
            }
        )*};
    }

    /// A mask of the first `n` of 16 lanes.
    #[inline(always)]
    fn first(n: usize) -> __mmask16 {
        ((1u32 << n) - 1) as u16
    }

    /// A mask of the first `n` of 8 lanes.
    #[inline(always)]
    unsafe fn first_of_8(n: usize) -> __m256i {
        // SAFETY: the caller's instruction set.
        unsafe {
            let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            _mm256_cmpgt_epi32(_mm256_set1_epi32(n as i32), lanes)
        }
    }

    impl Vector for __m512 {
        const LANES: usize = 16;
        intrinsics! {
            zero() -> Self = _mm512_setzero_ps();
            splat(x: f32) -> Self = _mm512_set1_ps(x);
            load(p: *const f32) -> Self = _mm512_loadu_ps(p);
            load_first(p: *const f32, n: usize) -> Self = _mm512_maskz_loadu_ps(first(n), p);
        }
        methods! {
            store(self, p: *mut f32) -> () = _mm512_storeu_ps(p, self);
            store_first(self, p: *mut f32, n: usize) -> () = _mm512_mask_storeu_ps(p, first(n), self);
            add(self, b: Self) -> Self = _mm512_add_ps(self, b);
            sub(self, b: Self) -> Self = _mm512_sub_ps(self, b);
            mul(self, b: Self) -> Self = _mm512_mul_ps(self, b);
            div(self, b: Self) -> Self = _mm512_div_ps(self, b);
            max(self, b: Self) -> Self = _mm512_max_ps(self, b);
            min(self, b: Self) -> Self = _mm512_min_ps(self, b);
            fma(self, b: Self, c: Self) -> Self = _mm512_fmadd_ps(self, b, c);
            scale_by_power(self, n: Self) -> Self = _mm512_scalef_ps(self, n);
            round(self) -> Self = _mm512_roundscale_ps::<0x08>(self);
            select_gt(self, bound: Self, yes: Self, no: Self) -> Self = _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(self, bound), no, yes);
        }
    }

    impl Vector for __m256 {
        const LANES: usize = 8;
        intrinsics! {
            zero() -> Self = _mm256_setzero_ps();
            splat(x: f32) -> Self = _mm256_set1_ps(x);
            load(p: *const f32) -> Self = _mm256_loadu_ps(p);
            load_first(p: *const f32, n: usize) -> Self = _mm256_maskload_ps(p, first_of_8(n));
        }
        methods! {
            store(self, p: *mut f32) -> () = _mm256_storeu_ps(p, self);
            store_first(self, p: *mut f32, n: usize) -> () = _mm256_maskstore_ps(p, first_of_8(n), self);
            add(self, b: Self) -> Self = _mm256_add_ps(self, b);
            sub(self, b: Self) -> Self = _mm256_sub_ps(self, b);
            mul(self, b: Self) -> Self = _mm256_mul_ps(self, b);
            div(self, b: Self) -> Self = _mm256_div_ps(self, b);
            max(self, b: Self) -> Self = _mm256_max_ps(self, b);
            min(self, b: Self) -> Self = _mm256_min_ps(self, b);
            fma(self, b: Self, c: Self) -> Self = _mm256_fmadd_ps(self, b, c);
            scale_by_power(self, n: Self) -> Self = _mm256_mul_ps(
                self,
                _mm256_castsi256_ps(_mm256_slli_epi32::<23>(_mm256_add_epi32(
                    _mm256_cvtps_epi32(n),
                    _mm256_set1_epi32(127),
                ))),
            );
            round(self) -> Self = _mm256_round_ps::<0x08>(self);
            select_gt(self, bound: Self, yes: Self, no: Self) -> Self = _mm256_blendv_ps(no, yes, _mm256_cmp_ps::<_CMP_GT_OQ>(self, bound));
        }
    }
}

#[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
mod wasm {
    use super::Vector;
    use std::arch::wasm32::*;

    /// Each method is one instruction that every instance of this program has, so that its contract is about pointers alone.
    macro_rules! methods {
        ($($name:ident($me:ident $(, $arg:ident)*) = $e:expr;)*) => {$(
            #[inline(always)]
            unsafe fn $name($me $(, $arg: Self)*) -> Self {
                $e
            }
        )*};
    }

    impl Vector for v128 {
        const LANES: usize = 4;
        #[inline(always)]
        unsafe fn zero() -> Self {
            f32x4_splat(0.0)
        }
        #[inline(always)]
        unsafe fn splat(x: f32) -> Self {
            f32x4_splat(x)
        }
        #[inline(always)]
        unsafe fn load(p: *const f32) -> Self {
            // SAFETY: the caller vouches for 4 readable values.
            unsafe { v128_load(p.cast()) }
        }
        #[inline(always)]
        unsafe fn store(self, p: *mut f32) {
            // SAFETY: the caller vouches for 4 writable values.
            unsafe { v128_store(p.cast(), self) }
        }
        #[inline(always)]
        unsafe fn load_first(p: *const f32, n: usize) -> Self {
            let mut out = [0f32; 4];
            for (i, o) in out.iter_mut().enumerate().take(n) {
                // SAFETY: the caller vouches for `n` readable values.
                *o = unsafe { p.add(i).read() };
            }
            f32x4(out[0], out[1], out[2], out[3])
        }
        #[inline(always)]
        unsafe fn store_first(self, p: *mut f32, n: usize) {
            let mut values = [0f32; 4];
            // SAFETY: there are 4 of them.
            unsafe { self.store(values.as_mut_ptr()) };
            for (i, v) in values.into_iter().enumerate().take(n) {
                // SAFETY: the caller vouches for `n` writable values.
                unsafe { p.add(i).write(v) };
            }
        }
        methods! {
            add(self, o) = f32x4_add(self, o);
            sub(self, o) = f32x4_sub(self, o);
            mul(self, o) = f32x4_mul(self, o);
            div(self, o) = f32x4_div(self, o);
            // In this order NaN gives the second operand, as everywhere.
            max(self, o) = f32x4_pmax(o, self);
            min(self, o) = f32x4_pmin(o, self);
            fma(self, a, b) = f32x4_add(f32x4_mul(self, a), b);
            scale_by_power(self, n) = f32x4_mul(
                self,
                i32x4_shl(i32x4_add(i32x4_trunc_sat_f32x4(n), i32x4_splat(127)), 23),
            );
            round(self) = f32x4_nearest(self);
            select_gt(self, bound, yes, no) = v128_bitselect(yes, no, f32x4_gt(self, bound));
        }
    }
}

/// Runs `$body` (generic over the register type bound to `$V`) with the current instruction set.
///
/// `$body` must be a call of an `#[inline(always)]` unsafe function.
macro_rules! dispatch {
    (($($arg:ident: $t:ty),* $(,)?) $(-> $out:ty)?, $V:ident => $body:expr) => {{
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx512f,avx2,fma")]
        unsafe fn avx512($($arg: $t),*) $(-> $out)? {
            type $V = std::arch::x86_64::__m512;
            // SAFETY: the features are enabled here; the rest is the caller's promise.
            unsafe { $body }
        }
        #[cfg(target_arch = "x86_64")]
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2($($arg: $t),*) $(-> $out)? {
            type $V = std::arch::x86_64::__m256;
            // SAFETY: as above.
            unsafe { $body }
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        unsafe fn simd128($($arg: $t),*) $(-> $out)? {
            type $V = std::arch::wasm32::v128;
            // SAFETY: as above.
            unsafe { $body }
        }
        #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
        unsafe fn portable($($arg: $t),*) $(-> $out)? {
            type $V = $crate::simd::Plain;
            // SAFETY: as above.
            unsafe { $body }
        }
        match $crate::simd::Isa::current() {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the feature was detected.
            isa if isa >= $crate::simd::Isa::Avx512 => unsafe { avx512($($arg),*) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the feature was detected.
            $crate::simd::Isa::Avx2 => unsafe { avx2($($arg),*) },
            #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
            // SAFETY: plain Rust.
            _ => unsafe { portable($($arg),*) },
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            // SAFETY: the program was compiled for it, and would not have started without.
            _ => unsafe { simd128($($arg),*) },
        }
    }};
}
pub(crate) use dispatch;

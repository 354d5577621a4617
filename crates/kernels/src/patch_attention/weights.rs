//! How attention's factors are held in memory: as f32, or rounded to bf16.

use super::softmax::SoftmaxVector;
use crate::gemm::bf16;
use crate::gemm::micro::{Products, Singles};

/// Products whose operands attention can make from f32.
///
/// # Safety
/// As [`Products`].
pub(super) trait Weights: Products<Sum: SoftmaxVector, Element: Default> {
    /// Terms of the sum in an element: 1 or 2.
    const TERMS: usize;

    /// Elements of a row whose terms follow each other: half as many, rounded up, with two terms
    /// an element.
    unsafe fn pack_along(row: &[f32], to: &mut [Self::Element]);

    /// Elements of one row, or of two beside each other: with two terms an element, one from each.
    unsafe fn pack_across(first: &[f32], second: Option<&[f32]>, to: &mut [Self::Element]);

    /// Stores the elements of each lane's one or two terms.
    unsafe fn store(first: Self::Sum, second: Self::Sum, to: *mut Self::Element);
}

impl<V: SoftmaxVector> Weights for Singles<V> {
    const TERMS: usize = 1;

    #[inline(always)]
    unsafe fn pack_along(row: &[f32], to: &mut [f32]) {
        to.copy_from_slice(row);
    }

    #[inline(always)]
    unsafe fn pack_across(first: &[f32], _: Option<&[f32]>, to: &mut [f32]) {
        to.copy_from_slice(first);
    }

    #[inline(always)]
    unsafe fn store(first: V, _: V, to: *mut f32) {
        // SAFETY: the trait's contract.
        unsafe { first.store(to) }
    }
}

/// f32 arithmetic on operands rounded to bf16, for CPUs that cannot multiply bf16.
pub(super) type Rounded<V> = Singles<V, ToBf16>;

/// The kind of operands that were rounded to bf16.
pub(super) struct ToBf16;

impl<V: SoftmaxVector> Weights for Rounded<V> {
    const TERMS: usize = 1;

    #[inline(always)]
    unsafe fn pack_along(row: &[f32], to: &mut [f32]) {
        for (to, from) in to.iter_mut().zip(row) {
            *to = bf16::widen(bf16::round(*from));
        }
    }

    #[inline(always)]
    unsafe fn pack_across(first: &[f32], _: Option<&[f32]>, to: &mut [f32]) {
        // SAFETY: the trait's contract.
        unsafe { Self::pack_along(first, to) };
    }

    #[inline(always)]
    unsafe fn store(first: V, _: V, to: *mut f32) {
        // SAFETY: the trait's contract.
        unsafe {
            // Veltkamp's splitting: what 2¹⁶ + 1 times the value leaves are its 8 leading bits.
            let large = first.mul(V::splat(65_537.0));
            large.sub(large.sub(first)).store(to);
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Weights;
    use crate::gemm::bf16;
    use crate::gemm::micro::Bf16Pairs;
    use std::arch::x86_64::*;

    /// Words `i` and `16 + i` beside each other, for `i` in `0..16`.
    const INTERLEAVE: [u16; 32] = {
        let mut index = [0; 32];
        let mut i = 0;
        while i < 16 {
            index[2 * i] = i as u16;
            index[2 * i + 1] = 16 + i as u16;
            i += 1;
        }
        index
    };

    impl Weights for Bf16Pairs {
        const TERMS: usize = 2;

        #[inline(always)]
        unsafe fn pack_along(row: &[f32], to: &mut [u32]) {
            let (rows, rest) = row.as_chunks::<16>();
            for (i, from) in rows.iter().enumerate() {
                // SAFETY: eight pairs fit into `to`; [`super::pairs::attend_pairs`] enables what is needed.
                unsafe {
                    let pairs = _mm512_cvtneps_pbh(_mm512_loadu_ps(from.as_ptr()));
                    let pairs: __m256i = std::mem::transmute(pairs);
                    let to = &mut to[8 * i..8 * i + 8];
                    _mm256_storeu_si256(to.as_mut_ptr().cast(), pairs);
                }
            }
            for (to, pair) in to[8 * rows.len()..].iter_mut().zip(rest.chunks(2)) {
                *to = bf16::round(pair[0]) | pair.get(1).map_or(0, |&x| bf16::round(x) << 16);
            }
        }

        #[inline(always)]
        unsafe fn pack_across(first: &[f32], second: Option<&[f32]>, to: &mut [u32]) {
            let zero = [0f32; 16];
            let whole = to.len() / 16 * 16;
            for i in (0..whole).step_by(16) {
                let second = second.map_or(&zero[..], |s| &s[i..i + 16]);
                // SAFETY: 16 values each; [`super::pairs::attend_pairs`] enables what is needed.
                unsafe {
                    let [first, second] =
                        [&first[i..i + 16], second].map(|row| _mm512_loadu_ps(row.as_ptr()));
                    Self::store(first, second, to[i..i + 16].as_mut_ptr());
                }
            }
            for i in whole..to.len() {
                to[i] = bf16::round(first[i]) | second.map_or(0, |s| bf16::round(s[i]) << 16);
            }
        }

        #[inline(always)]
        unsafe fn store(first: __m512, second: __m512, to: *mut u32) {
            // SAFETY: the trait's contract; [`super::pairs::attend_pairs`] enables AVX512BW too.
            unsafe {
                let both: __m512i = std::mem::transmute(_mm512_cvtne2ps_pbh(second, first));
                let index = _mm512_loadu_si512(INTERLEAVE.as_ptr().cast());
                _mm512_storeu_si512(to.cast(), _mm512_permutexvar_epi16(index, both));
            }
        }
    }
}

//! Attention on pairs of bf16, where the CPU multiplies them.

use super::forward::{Scratch, attend};
use super::task::Task;
use crate::gemm::SharedMut;
use crate::gemm::micro::Bf16Pairs;
use crate::simd::Isa;

/// [`attend`] with AVX512-BF16.
///
/// # Safety
/// As [`attend`]; see [`has_pairs`].
#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512bf16,avx2,fma")]
pub(super) unsafe fn attend_pairs(task: &Task<'_>, s: &mut Scratch<u32>, out: SharedMut) {
    // SAFETY: the features are enabled; the rest is the caller's promise.
    unsafe { attend::<Bf16Pairs, 6, 4>(task, s, out) }
}

/// Whether [`attend_pairs`] may run.
pub(super) fn has_pairs() -> bool {
    Isa::current() >= Isa::Avx512Bf16
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw")
}

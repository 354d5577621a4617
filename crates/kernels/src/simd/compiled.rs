//! Plain Rust compiled for several instruction sets.

use super::Isa;

/// Runs `work` in the version that was compiled for `isa`, or for the best set below it.
///
/// There are versions for [`Isa::Avx512`], [`Isa::Avx2`] (with FMA) and [`Isa::Portable`]. `work` gets the
/// one it runs in: a constant, so that what is decided by it costs nothing. Nothing is fused or
/// reordered that is not written so, hence results have the same bits in all versions unless `work`
/// itself makes a difference. What the CPU lacks, or `SCENESPLAT_ISA` excludes, is never used.
///
/// Mark what the closure calls `#[inline(always)]`, and the closure too unless it is short: what is not
/// inlined into a version is not compiled for it.
///
/// # Examples
/// ```
/// use scenesplat_kernels::simd::{Isa, compiled_for};
///
/// #[inline(always)]
/// fn largest(values: &[f32]) -> f32 {
///     values.iter().fold(f32::MIN, |most, v| if *v > most { *v } else { most })
/// }
///
/// let values = [1.0, 3.0, 2.0];
/// let found = compiled_for(Isa::Avx2, |_| largest(&values));
/// assert_eq!(found, 3.0);
/// ```
#[inline(always)]
pub fn compiled_for<R>(isa: Isa, work: impl FnOnce(Isa) -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx2,fma")]
        fn avx512<R>(work: impl FnOnce(Isa) -> R) -> R {
            work(Isa::Avx512)
        }
        #[target_feature(enable = "avx2,fma")]
        fn avx2<R>(work: impl FnOnce(Isa) -> R) -> R {
            work(Isa::Avx2)
        }
        let isa = isa.min(Isa::current());
        if isa >= Isa::Avx512 {
            // SAFETY: the current set is one that the CPU has, and each includes the ones before.
            return unsafe { avx512(work) };
        }
        if isa >= Isa::Avx2 {
            // SAFETY: as above.
            return unsafe { avx2(work) };
        }
    }
    let _ = isa;
    work(Isa::Portable)
}

/// [`compiled_for`] the [current](Isa::current) instruction set.
#[inline(always)]
pub fn compiled<R>(work: impl FnOnce() -> R) -> R {
    compiled_for(
        Isa::current(),
        #[inline(always)]
        |_| work(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    fn polynomial(x: &[f64]) -> Vec<u64> {
        x.iter().map(|x| (x * x * 0.3 + x * 0.7 - 0.1 / (x + 2.0)).to_bits()).collect()
    }

    #[test]
    fn versions_agree_bit_for_bit_and_know_which_they_are() {
        let x: Vec<f64> = (0..1000).map(|i| f64::from(i).sin()).collect();
        let plain = polynomial(&x);
        for isa in Isa::ALL {
            let (got, ran) = compiled_for(
                isa,
                #[inline(always)]
                |ran| (polynomial(&x), ran),
            );
            assert_eq!(got, plain, "{isa:?}");
            assert!(ran <= isa && ran <= Isa::current() && ran <= Isa::Avx512, "{isa:?}: {ran:?}");
        }
        assert_eq!(compiled(|| polynomial(&x)), plain);
        let best = compiled_for(Isa::Amx, |ran| ran);
        assert_eq!(best, Isa::current().min(Isa::Avx512));
    }
}

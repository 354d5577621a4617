//! Exponential, normal distribution and the exact GELU (`x·Φ(x)`), vectorised.
//!
//! The constants are our own minimax fits: `exp` to 3e-9 and the tail of Φ to 6e-8 relative, before
//! rounding.

use crate::simd::{Vector, dispatch};
use rayon::prelude::*;

const LOG2_E: f32 = std::f32::consts::LOG2_E;
/// ln 2 split so that `n · LN2_HIGH` is exact for |n| < 2¹⁰.
const LN2_HIGH: f32 = 0.693_359_4;
const LN2_LOW: f32 = -2.121_944_4e-4;
/// `(eʳ − 1 − r) / r²` for |r| ≤ ln 2 / 2, lowest power first.
const EXP_POLY: [f32; 5] =
    [0.499_999_94, 0.166_665_21, 0.041_668_39, 0.008_368_717, 0.001_381_459_9];
/// Scale of the variable `t = 1 / (1 + 0.33·|x|)` in which the tail of the normal law is fitted.
const TAIL_SCALE: f32 = 0.33;
/// `Φ(−|x|) · e^(x²/2)` in powers t¹..t⁹, |x| ≤ 14.5, lowest first.
const TAIL_POLY: [f32; 9] = [
    0.131_624,
    0.132_269_23,
    0.111_319_44,
    0.120_776_58,
    -0.053_968_84,
    0.220_783_38,
    -0.263_709_6,
    0.121_348_195,
    -0.020_442_365,
];
/// Elements that one task works on.
const BLOCK: usize = 1 << 15;

#[inline(always)]
unsafe fn horner<V: Vector, const N: usize>(c: &[f32; N], x: V) -> V {
    // SAFETY: the caller's instruction set.
    unsafe {
        let mut r = V::splat(c[N - 1]);
        for i in (0..N - 1).rev() {
            r = r.fma(x, V::splat(c[i]));
        }
        r
    }
}

/// `eˣ`; 0 below -87.3 (no denormals), +∞ above 88.7, NaN for NaN.
#[inline(always)]
pub(crate) unsafe fn exp<V: Vector>(x: V) -> V {
    // SAFETY: the caller's instruction set.
    unsafe {
        let zero = V::zero();
        // Order matters for NaN: `min`/`max` return the second operand then.
        let clamped = V::splat(88.8).min(V::splat(-87.4).max(x));
        let n = clamped.mul(V::splat(LOG2_E)).round();
        let r = n.fma(V::splat(-LN2_HIGH), clamped);
        let r = n.fma(V::splat(-LN2_LOW), r);
        let poly = horner(&EXP_POLY, r);
        let value = r.mul(r).fma(poly, r).add(V::splat(1.0));
        // 2ⁿ in two steps, since n can be 128 or -126.
        let half = n.mul(V::splat(0.5)).round();
        let value = value.scale_by_power(half).scale_by_power(n.sub(half));
        let value = x.select_gt(V::splat(88.72), V::splat(f32::INFINITY), value);
        zero.sub(x).select_gt(V::splat(87.3), zero, value)
    }
}

/// Standard normal density (without its constant) and distribution: `e^(−x²/2)` and `Φ(x)`.
///
/// The tail is computed as such, so `Φ` keeps its relative accuracy far below zero.
#[inline(always)]
unsafe fn normal<V: Vector>(x: V) -> (V, V) {
    // SAFETY: the caller's instruction set.
    unsafe {
        let one = V::splat(1.0);
        let bell = exp(x.mul(x).mul(V::splat(-0.5)));
        // Bounded, so that the density at ±∞ is 0 · finite.
        let size = V::splat(1e4).min(V::zero().sub(x).max(x));
        let t = one.div(size.fma(V::splat(TAIL_SCALE), one));
        let tail = horner(&TAIL_POLY, t).mul(t).mul(bell);
        (bell, x.select_gt(V::zero(), one.sub(tail), tail))
    }
}

#[inline(always)]
unsafe fn gelu<V: Vector>(x: V) -> V {
    // SAFETY: the caller's instruction set.
    unsafe { normal(x).1.mul(x) }
}

#[inline(always)]
unsafe fn normal_cdf<V: Vector>(x: V) -> V {
    // SAFETY: the caller's instruction set.
    unsafe { normal(x).1 }
}

/// `d gelu / dx = Φ(x) + x·φ(x)`.
#[inline(always)]
unsafe fn gelu_slope<V: Vector>(x: V) -> V {
    // SAFETY: the caller's instruction set.
    unsafe {
        let (bell, cdf) = normal(x);
        // Bounded, since ∞ · 0 would be NaN.
        let bounded = V::splat(1e4).min(V::splat(-1e4).max(x));
        // 1/√(2π)
        bounded.mul(V::splat(0.398_942_3)).fma(bell, cdf)
    }
}

/// Applies `f` to every element of `values`, writing through; the rest of a register is padding.
macro_rules! map_slice {
    ($name:ident, $f:ident) => {
        #[inline(always)]
        unsafe fn $name<V: Vector>(values: &mut [f32]) {
            let whole = values.len() / V::LANES * V::LANES;
            // SAFETY: in bounds; the caller's instruction set.
            unsafe {
                let mut i = 0;
                while i < whole {
                    let p = values.as_mut_ptr().add(i);
                    $f(V::load(p)).store(p);
                    i += V::LANES;
                }
                if whole < values.len() {
                    let mut buffer = [0f32; 16];
                    let rest = values.len() - whole;
                    buffer[..rest].copy_from_slice(&values[whole..]);
                    $f(V::load(buffer.as_ptr())).store(buffer.as_mut_ptr());
                    values[whole..].copy_from_slice(&buffer[..rest]);
                }
            }
        }
    };
}
map_slice!(gelu_slice, gelu);
map_slice!(gelu_slope_slice, gelu_slope);
map_slice!(exp_slice, exp);
map_slice!(normal_cdf_slice, normal_cdf);

/// `x ← x · Φ(x)` with the exact error function, on the calling thread.
///
/// +∞ gives +∞, −∞ gives NaN (as `0 · −∞`), NaN gives NaN; −1000 gives −0.
pub fn gelu_in_place(values: &mut [f32]) {
    dispatch!((values: &mut [f32]), V => gelu_slice::<V>(values));
}

/// `x ← eˣ`, on the calling thread: 0 below −87.3, +∞ above 88.7.
pub fn exp_in_place(values: &mut [f32]) {
    dispatch!((values: &mut [f32]), V => exp_slice::<V>(values));
}

/// `x ← Φ(x)`, the standard normal distribution function, on the calling thread.
pub fn normal_cdf_in_place(values: &mut [f32]) {
    dispatch!((values: &mut [f32]), V => normal_cdf_slice::<V>(values));
}

/// Exact GELU of every element. `out` and `x` have the same length.
///
/// # Panics
/// If they have not (a bug of the caller).
pub fn gelu_forward(x: &[f32], out: &mut [f32]) {
    assert_eq!(x.len(), out.len(), "gelu: output length");
    out.par_chunks_mut(BLOCK).zip(x.par_chunks(BLOCK)).for_each(|(out, x)| {
        out.copy_from_slice(x);
        gelu_in_place(out);
    });
}

/// Gradient of the GELU: `out = grad · (Φ(x) + x·φ(x))`. All have the same length.
///
/// # Panics
/// If they have not (a bug of the caller).
pub fn gelu_backward(x: &[f32], grad: &[f32], out: &mut [f32]) {
    assert_eq!([x.len(), grad.len()], [out.len(); 2], "gelu: gradient lengths");
    out.par_chunks_mut(BLOCK).zip(x.par_chunks(BLOCK)).zip(grad.par_chunks(BLOCK)).for_each(
        |((out, x), grad)| {
            out.copy_from_slice(x);
            dispatch!((out: &mut [f32]), V => gelu_slope_slice::<V>(out));
            for (o, g) in out.iter_mut().zip(grad) {
                *o *= g;
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_test_support::reference;

    fn grid(low: f64, high: f64) -> Vec<f32> {
        (0..100_003).map(|i| (low + (high - low) * f64::from(i) / 100_002.0) as f32).collect()
    }

    #[test]
    fn exp_is_accurate_and_total() {
        let x = grid(-87.0, 88.5);
        let mut y = x.clone();
        exp_in_place(&mut y);
        for (x, y) in x.iter().zip(&y) {
            let want = f64::from(*x).exp();
            assert!((f64::from(*y) - want).abs() < 2e-7 * want, "exp({x}) = {y}, want {want}");
        }
        let mut special = [f32::NEG_INFINITY, -1e30, -88.0, 0.0, 89.0, f32::INFINITY, f32::NAN];
        exp_in_place(&mut special);
        assert_eq!(special[..6], [0.0, 0.0, 0.0, 1.0, f32::INFINITY, f32::INFINITY]);
        assert!(special[6].is_nan());
    }

    #[test]
    fn normal_distribution_is_accurate_and_total() {
        let x = grid(-13.0, 13.0);
        let mut y = x.clone();
        normal_cdf_in_place(&mut y);
        for (x, y) in x.iter().zip(&y) {
            let want = reference::normal_cdf(f64::from(*x));
            let error = (f64::from(*y) - want).abs();
            // Rounding of x² costs relative accuracy in the far tail: |x|²/2 units of 6e-8.
            let bound = 2e-7f64.min(want * (5e-7 + f64::from(x * x) * 8e-8));
            assert!(error < bound || error < 1e-7, "Φ({x}) = {y}, want {want}");
        }
        let mut special = [f32::NEG_INFINITY, f32::INFINITY, -20.0, 20.0, f32::NAN, 0.0];
        normal_cdf_in_place(&mut special);
        assert_eq!(special[..4], [0.0, 1.0, 0.0, 1.0]);
        assert!(special[4].is_nan());
        assert!((special[5] - 0.5).abs() < 1.5e-7);
    }

    #[test]
    fn gelu_and_slope_agree_with_f64() {
        let x = grid(-12.0, 12.0);
        let mut y = vec![0.0; x.len()];
        gelu_forward(&x, &mut y);
        let mut slope = vec![0.0; x.len()];
        gelu_backward(&x, &vec![1.0; x.len()], &mut slope);
        for i in 0..x.len() {
            let v = f64::from(x[i]);
            assert!((f64::from(y[i]) - reference::gelu(v)).abs() < 3e-7 * v.abs().max(1.0));
            let h = 1e-5;
            let want = (reference::gelu(v + h) - reference::gelu(v - h)) / (2.0 * h);
            assert!((f64::from(slope[i]) - want).abs() < 1e-6, "slope({v}): {} {want}", slope[i]);
        }
        let mut huge = [1e30f32, -1e30, f32::INFINITY];
        gelu_in_place(&mut huge);
        assert_eq!(huge, [1e30, 0.0, f32::INFINITY]);
        let mut out = [0.0; 2];
        gelu_backward(&[1e30, -1e30], &[2.0, 2.0], &mut out);
        assert_eq!(out, [2.0, 0.0]);
    }
}

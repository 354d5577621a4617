//! Inner loops over the channels of a row: sums in f64, in an order that no vector width changes;
//! callers have them [compiled](scenesplat_kernels::simd::compiled) for the CPU.

use crate::values::Real;

/// Partial sums of a row: two of the widest f64 registers that are asked for.
const LANES: usize = 8;

/// `Σ p·p`, `Σ t·t`, `Σ p·t`
#[inline(always)]
pub(crate) fn dots<T: Real>(p: &[T], t: &[T]) -> [f64; 3] {
    let mut sums = [[0f64; LANES]; 3];
    let mut add = |p: &[T], t: &[T]| {
        for l in 0..p.len() {
            let (p, t) = (p[l].wide(), t[l].wide());
            sums[0][l] += p * p;
            sums[1][l] += t * t;
            sums[2][l] += p * t;
        }
    };
    let (p8, p_rest) = p.as_chunks::<LANES>();
    let (t8, t_rest) = t.as_chunks::<LANES>();
    for (p, t) in p8.iter().zip(t8) {
        add(p, t);
    }
    add(p_rest, t_rest);
    sums.map(|s| s.iter().sum())
}

/// `Σ a·b`
#[inline(always)]
pub(crate) fn dot<T: Real>(a: &[T], b: &[T]) -> f64 {
    let mut sums = [0f64; LANES];
    let (a8, a_rest) = a.as_chunks::<LANES>();
    let (b8, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a8.iter().zip(b8) {
        for l in 0..LANES {
            sums[l] += a[l].wide() * b[l].wide();
        }
    }
    for (l, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        sums[l] += a.wide() * b.wide();
    }
    sums.iter().sum()
}

/// `Σ h(p − t)`
#[inline(always)]
pub(crate) fn sum_of_differences<T: Real>(p: &[T], t: &[T], h: impl Fn(f64) -> f64) -> f64 {
    let mut sums = [0f64; LANES];
    let (p8, p_rest) = p.as_chunks::<LANES>();
    let (t8, t_rest) = t.as_chunks::<LANES>();
    for (p, t) in p8.iter().zip(t8) {
        for l in 0..LANES {
            sums[l] += h(p[l].wide() - t[l].wide());
        }
    }
    for (l, (p, t)) in p_rest.iter().zip(t_rest).enumerate() {
        sums[l] += h(p.wide() - t.wide());
    }
    sums.iter().sum()
}

/// Sum of f64 values.
#[inline(always)]
pub(crate) fn sum(values: &[f64]) -> f64 {
    let mut sums = [0f64; LANES];
    let (eights, rest) = values.as_chunks::<LANES>();
    for v in eights {
        for l in 0..LANES {
            sums[l] += v[l];
        }
    }
    for (l, v) in rest.iter().enumerate() {
        sums[l] += v;
    }
    sums.iter().sum()
}

/// Euclidean norm of finite values; nothing over- or underflows on the way.
pub(crate) fn norm<T: Real>(values: &[T]) -> f64 {
    let square = dot(values, values);
    if square.is_finite() && square > f64::MIN_POSITIVE {
        return square.sqrt();
    }
    let largest = values.iter().map(|v| v.wide().abs()).fold(0.0, f64::max);
    if largest == 0.0 || !largest.is_finite() {
        return largest;
    }
    let square: f64 = values.iter().map(|v| (v.wide() / largest).powi(2)).sum();
    largest * square.sqrt()
}

/// `out = exp(x − shift)` for `x ≤ shift`, to about 2⁻⁵² of each value; differences below −708 count
/// as −708 (3·10⁻³⁰⁸). NaN stays NaN.
///
/// The library's function takes one value at a time; this loop is one that the compiler turns into
/// vector instructions, and exponentials are most of the time of a softmax.
#[inline(always)]
pub(crate) fn exp_shifted<T: Real>(x: &[T], shift: f64, out: &mut [f64]) {
    for (out, x) in out.iter_mut().zip(x) {
        *out = exp(x.wide() - shift);
    }
}

/// `eˣ = 2ᵏ · eʳ` with `|r| ≤ ln 2 / 2`, where the series of `eʳ` ends with r¹³/13!.
#[inline(always)]
fn exp(x: f64) -> f64 {
    /// Added to a small number, it moves the integer nearest to that into the lowest bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    /// ln 2 to 33 bits, so that multiples of it are exact, and the rest of it.
    const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
    const LN_2_LOW: f64 = f64::from_bits(0x3dea_39ef_3579_3c76);
    let x = if x < -708.0 { -708.0 } else { x };
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (x - k * LN_2_HIGH) - k * LN_2_LOW;
    let mut series = 1.0 / 6_227_020_800.0;
    for factorial in [
        479_001_600.0,
        39_916_800.0,
        3_628_800.0,
        362_880.0,
        40_320.0,
        5040.0,
        720.0,
        120.0,
        24.0,
        6.0,
        2.0,
        1.0,
        1.0,
    ] {
        series = series * r + 1.0 / factorial;
    }
    series * f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::simd::compiled;

    #[test]
    fn exponentials() {
        let mut worst = 0f64;
        for i in 0..200_000 {
            let x = -708.0 * (f64::from(i) / 200_000.0).powi(3);
            let (got, want) = (exp(x), x.exp());
            worst = worst.max((got - want).abs() / want);
        }
        assert!(worst < 1e-15, "{worst:e}");
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-0.0), 1.0);
        assert!(exp(-1e300) < 1e-307 && exp(f64::NEG_INFINITY) < 1e-307);
        assert!(exp(f64::NAN).is_nan());
    }

    #[test]
    fn sums_of_any_length() {
        for n in 0..40 {
            let a: Vec<f64> = (0..n).map(|i| f64::from(i) + 0.5).collect();
            let b: Vec<f64> = (0..n).map(|i| 3.0 - f64::from(i)).collect();
            let pairs = || a.iter().zip(&b);
            let want = [
                a.iter().map(|a| a * a).sum::<f64>(),
                b.iter().map(|b| b * b).sum::<f64>(),
                pairs().map(|(a, b)| a * b).sum::<f64>(),
            ];
            assert_eq!(compiled(|| dots(&a, &b)), want, "small integers and halves are exact");
            assert_eq!(dot(&a, &b), want[2]);
            assert_eq!(
                sum_of_differences(&a, &b, |d| d * d),
                pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>()
            );
            assert_eq!(sum(&a), a.iter().sum::<f64>());
        }
    }

    #[test]
    fn norms_of_any_size() {
        for factor in [1e-300, 1e-160, 1.0, 1e160, 1e300] {
            let got = norm(&[3.0 * factor, -4.0 * factor]);
            assert!((got / (5.0 * factor) - 1.0).abs() < 1e-15, "{factor:e}: {got:e}");
        }
        assert_eq!(norm::<f32>(&[]), 0.0);
        assert_eq!(norm(&[0f32; 3]), 0.0);
        assert_eq!(norm(&[f32::MAX; 4]), 2.0 * f64::from(f32::MAX));
    }
}

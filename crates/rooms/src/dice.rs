//! Choices, from exactly rounded operations only.

use rand_chacha::rand_core::RngCore;
use scenesplat_kernels::random::{SampleRng, below, unit};

/// A number in `low..high`.
pub(crate) fn between(rng: &mut SampleRng, low: f64, high: f64) -> f64 {
    low + (high - low) * unit(rng)
}

/// Whether something of the given probability happens.
pub(crate) fn chance(rng: &mut SampleRng, probability: f64) -> bool {
    unit(rng) < probability
}

/// A whole number in `low..=high`.
pub(crate) fn whole(rng: &mut SampleRng, low: u32, high: u32) -> u32 {
    low + below(rng, high.saturating_sub(low) + 1)
}

/// One of several; the first if there is only one.
pub(crate) fn pick<T: Copy>(rng: &mut SampleRng, from: &[T]) -> T {
    from[below(rng, from.len() as u32) as usize]
}

/// Index by weight; the last if all weights are 0.
pub(crate) fn weighted(rng: &mut SampleRng, weights: &[f64]) -> usize {
    let mut rest = unit(rng) * weights.iter().sum::<f64>();
    for (i, weight) in weights.iter().enumerate() {
        if rest < *weight {
            return i;
        }
        rest -= weight;
    }
    weights.len().saturating_sub(1)
}

/// Nearly standard normal (twelve uniform numbers), from operations that are exact on any machine.
pub(crate) fn normal(rng: &mut SampleRng) -> f64 {
    (0..12).map(|_| unit(rng)).sum::<f64>() - 6.0
}

/// Nearly standard normal, within ±3.5: four uniform numbers from one draw, for noise that is
/// drawn several times per Gaussian.
pub(crate) fn noise(rng: &mut SampleRng) -> f64 {
    let bits = rng.next_u64();
    let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xffff).sum();
    // Four uniform numbers have the variance 1/3.
    (sum as f64 / 65536.0 - 2.0) * 1.732_050_807_568_877_2
}

/// Cosine and sine of a turn by a small angle: the sine is uniform in ± `size`.
pub(crate) fn small_turn(rng: &mut SampleRng, size: f64) -> [f64; 2] {
    let sin = between(rng, -size, size);
    [(1.0 - sin * sin).sqrt(), sin]
}

/// A fixed pseudo-random number in 0..1 for three whole numbers.
pub(crate) fn scramble(x: i64, y: i64, salt: u32) -> f64 {
    let bits = x.cast_unsigned().wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ y.cast_unsigned().wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ u64::from(salt).wrapping_mul(0x1656_67b1_9e37_79f9);
    (finished(bits) >> 40) as f64 / f64::from(1_u32 << 24)
}

/// The finisher of splitmix64: results of neighboring inputs share nothing.
pub(crate) fn finished(mut bits: u64) -> u64 {
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Smooth noise in 0..1 over the plane: random numbers at whole places, joined without kinks.
pub(crate) fn smooth_noise(x: f64, y: f64, salt: u32) -> f64 {
    let (cx, cy) = (x.floor(), y.floor());
    let ease = |v: f64| v * v * (3.0 - 2.0 * v);
    let (fx, fy) = (ease(x - cx), ease(y - cy));
    let (ix, iy) = (cx as i64, cy as i64);
    let row = |iy| {
        let (a, b) = (scramble(ix, iy, salt), scramble(ix.wrapping_add(1), iy, salt));
        a + (b - a) * fx
    };
    let (a, b) = (row(iy), row(iy.wrapping_add(1)));
    a + (b - a) * fy
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_kernels::random::sample_rng;

    #[test]
    fn noise_is_standard() {
        let mut rng = sample_rng(5, 0, 0);
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..40_000 {
            let v = noise(&mut rng);
            assert!(v.abs() < 3.5);
            sum += v;
            squares += v * v;
        }
        assert!((sum / 4e4).abs() < 0.02 && (squares / 4e4 - 1.0).abs() < 0.03);
    }

    #[test]
    fn sums_of_twelve_are_standard() {
        let mut rng = sample_rng(0, 0, 0);
        let values: Vec<f64> = (0..40_000).map(|_| normal(&mut rng)).collect();
        let mean = |f: fn(f64) -> f64| values.iter().map(|&v| f(v)).sum::<f64>() / 4e4;
        assert!(mean(|v| v).abs() < 0.02 && (mean(|v| v * v) - 1.0).abs() < 0.03);
    }

    #[test]
    fn choices_stay_in_range() {
        let mut rng = sample_rng(6, 0, 0);
        let mut seen = [0; 3];
        for _ in 0..3000 {
            seen[weighted(&mut rng, &[1.0, 0.0, 2.0])] += 1;
            assert!((3..=5).contains(&whole(&mut rng, 3, 5)));
            assert!((0.0..=1.0).contains(&smooth_noise(
                between(&mut rng, -9.0, 9.0),
                between(&mut rng, -9.0, 9.0),
                4
            )));
        }
        assert_eq!(seen[1], 0);
        assert!((800..1200).contains(&seen[0]), "{seen:?}");
        assert_eq!(weighted(&mut rng, &[0.0, 0.0]), 1);
    }

    #[test]
    fn smooth_noise_has_no_jumps() {
        for i in -50..50 {
            let x = f64::from(i) * 0.2;
            let (a, b) = (smooth_noise(x - 1e-9, 0.3, 7), smooth_noise(x + 1e-9, 0.3, 7));
            assert!((a - b).abs() < 1e-6);
        }
    }
}

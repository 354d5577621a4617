//! Random numbers that depend on what they are for, not on who draws first.

use rand_chacha::rand_core::RngCore;
use scenesplat_kernels::random;
pub use scenesplat_kernels::random::{SampleRng, sample_rng};
pub(crate) use scenesplat_kernels::random::{below, unit};

/// What random numbers outside of samples are for; each has its own, independent of the samples'.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// The order of the scenes of an epoch.
    Order = 1,
    /// Which scenes of a batch are mixed, and how.
    Mixing = 2,
    /// Which Gaussians of a cell a chunk keeps.
    Chunking = 3,
    /// Which scenes of a batch are masked.
    MaskedScenes = 4,
    /// What is masked of a scene.
    Masking = 5,
}

/// As [`sample_rng`], for something other than a sample.
pub(crate) fn purpose_rng(purpose: Purpose, seed: u64, epoch: u64, index: u64) -> SampleRng {
    random::purpose_rng(purpose as u8, seed, epoch, index)
}

/// A number from a name (FNV-1a).
pub(crate) fn name_number(name: &str) -> u64 {
    name.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3))
}

/// Puts the numbers `0..len` into a random order (Fisher and Yates).
pub(crate) fn permutation(rng: &mut SampleRng, len: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..len).collect();
    for i in (1..len).rev() {
        // 128 bits: exact for any length, and the bias is below 2⁻³².
        let j = ((u128::from(rng.next_u64()) * (i as u128 + 1)) >> 64) as usize;
        order.swap(i, j);
    }
    order
}

/// A number in `low..high`.
pub(crate) fn between(rng: &mut SampleRng, [low, high]: [f64; 2]) -> f64 {
    low + unit(rng) * (high - low)
}

/// Whether something of that probability happens; always for 1, never for 0.
pub(crate) fn happens(rng: &mut SampleRng, probability: f64) -> bool {
    unit(rng) < probability
}

/// Two independent standard normal numbers (Marsaglia's polar method).
pub(crate) fn normal_pair(rng: &mut SampleRng) -> [f64; 2] {
    loop {
        let v = [2.0 * unit(rng) - 1.0, 2.0 * unit(rng) - 1.0];
        let square = v[0] * v[0] + v[1] * v[1];
        if square > 0.0 && square < 1.0 {
            let factor = (-2.0 * square.ln() / square).sqrt();
            return v.map(|x| x * factor);
        }
    }
}

/// Hands `count` independent standard normal numbers to `take`, in order.
pub(crate) fn normals(rng: &mut SampleRng, count: usize, mut take: impl FnMut(usize, f64)) {
    for first in (0..count).step_by(2) {
        let [a, b] = normal_pair(rng);
        take(first, a);
        if first + 1 < count {
            take(first + 1, b);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn purposes_have_numbers_of_their_own() {
        let first = |mut rng: SampleRng| rng.next_u64();
        let order = first(purpose_rng(Purpose::Order, 1, 2, 3));
        assert_ne!(order, first(sample_rng(1, 2, 3)));
        assert_ne!(order, first(purpose_rng(Purpose::Mixing, 1, 2, 3)));
        assert_ne!(order, first(purpose_rng(Purpose::Order, 1, 3, 3)));
    }

    #[test]
    fn permutations_hold_every_number_and_every_order() {
        let mut rng = sample_rng(1, 0, 0);
        let mut seen = std::collections::BTreeMap::new();
        for _ in 0..6000 {
            *seen.entry(permutation(&mut rng, 3)).or_insert(0) += 1;
        }
        assert_eq!(seen.len(), 6);
        // Expected 1000 each; five standard deviations of a binomial are 145.
        assert!(seen.values().all(|&n| (855..1145).contains(&n)), "{seen:?}");
        assert!(permutation(&mut rng, 0).is_empty());
        assert_eq!(permutation(&mut rng, 1), [0]);
    }

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal_distribution() {
        let (n, mut sums) = (200_001, [0.0; 4]);
        normals(&mut sample_rng(3, 0, 0), n, |_, x| {
            (0..4).for_each(|k| sums[k] += x.powi(k as i32 + 1));
        });
        let mean = sums.map(|s| s / n as f64);
        // Five standard errors of each moment: sqrt(var(xᵏ)/n) · 5.
        for (k, (expected, var)) in
            [(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0)].iter().enumerate()
        {
            let error: f64 = mean[k] - expected;
            assert!(error.abs() < 5.0 * (var / n as f64).sqrt(), "moment {}: {}", k + 1, mean[k]);
        }
    }

    #[test]
    fn certain_and_impossible_things() {
        let mut rng = sample_rng(0, 0, 0);
        assert!((0..1000).all(|_| happens(&mut rng, 1.0)));
        assert!((0..1000).all(|_| !happens(&mut rng, 0.0)));
        assert!((0..1000).all(|_| (-1.0..3.0).contains(&between(&mut rng, [-1.0, 3.0]))));
    }
}

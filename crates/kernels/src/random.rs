//! Random numbers that depend on what they are for, not on who draws first, from operations that
//! IEEE 754 rounds exactly: the same on any machine.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};

/// Random numbers of one sample, object, room.
pub type SampleRng = ChaCha8Rng;

/// The random numbers of sample `index` in `epoch`.
///
/// Every (seed, epoch, index) has a stream of its own, so a sample is the same for any number of
/// workers and after a resume.
pub fn sample_rng(seed: u64, epoch: u64, index: u64) -> SampleRng {
    purpose_rng(0, seed, epoch, index)
}

/// As [`sample_rng`], for something other than a sample; `purpose` 0 is that of samples.
pub fn purpose_rng(purpose: u8, seed: u64, epoch: u64, index: u64) -> SampleRng {
    let mut key = [0; 32];
    key[..8].copy_from_slice(&seed.to_le_bytes());
    key[8..16].copy_from_slice(&epoch.to_le_bytes());
    key[16] = purpose;
    let mut rng = ChaCha8Rng::from_seed(key);
    rng.set_stream(index);
    rng
}

/// A number in `0..1`, a multiple of 2⁻²⁴.
///
/// Written here because the distributions of `rand` may change their values between versions.
pub fn unit(rng: &mut SampleRng) -> f64 {
    f64::from(rng.next_u32() >> 8) / f64::from(1_u32 << 24)
}

/// A number in `0..bound`; 0 when `bound` is 0.
pub fn below(rng: &mut SampleRng, bound: u32) -> u32 {
    ((u64::from(rng.next_u32()) * u64::from(bound)) >> 32) as u32
}

/// A direction, uniform on the sphere: a point of the ball, by rejection, normalized.
pub fn direction(rng: &mut SampleRng) -> [f64; 3] {
    loop {
        let v: [f64; 3] = std::array::from_fn(|_| 2.0 * unit(rng) - 1.0);
        let square = v.iter().map(|x| x * x).sum::<f64>();
        if square > 1e-4 && square <= 1.0 {
            let norm = square.sqrt();
            return v.map(|x| x / norm);
        }
    }
}

/// Cosine and sine of a uniform angle, without trigonometry.
pub fn cos_sin(rng: &mut SampleRng) -> [f64; 2] {
    loop {
        let v = [2.0 * unit(rng) - 1.0, 2.0 * unit(rng) - 1.0];
        let square = v[0] * v[0] + v[1] * v[1];
        if square > 1e-4 && square <= 1.0 {
            return v.map(|x| x / square.sqrt());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_argument_selects_other_numbers() {
        let first = |seed, epoch, index| sample_rng(seed, epoch, index).next_u64();
        let base = first(1, 2, 3);
        assert_eq!(base, first(1, 2, 3));
        for other in [first(0, 2, 3), first(1, 0, 3), first(1, 2, 0), first(2, 1, 3)] {
            assert_ne!(base, other);
        }
        assert_ne!(base, purpose_rng(1, 1, 2, 3).next_u64());
    }

    #[test]
    fn numbers_stay_in_range() {
        let mut rng = sample_rng(0, 0, 0);
        for _ in 0..10_000 {
            assert!((0.0..1.0).contains(&unit(&mut rng)));
            assert!(below(&mut rng, 7) < 7);
            let norm = direction(&mut rng).iter().map(|x| x * x).sum::<f64>();
            assert!((norm - 1.0).abs() < 1e-12);
            let [c, s] = cos_sin(&mut rng);
            assert!((c * c + s * s - 1.0).abs() < 1e-12);
        }
        assert_eq!(below(&mut rng, 0), 0);
    }
}

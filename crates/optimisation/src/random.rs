//! Random numbers of a counter: what a Gaussian draws depends on the seed, the step and its row alone,
//! so neither threads nor a resume change it.

/// What numbers are for: other purposes have other numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Purpose {
    Noise = 1,
    Relocate = 2,
    Add = 3,
    Split = 4,
    Start = 5,
    Background = 6,
    Order = 7,
}

/// Philox 4×32 with ten rounds (Salmon, Moraes, Dror, Shaw 2011).
pub(crate) fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for round in 0..10 {
        if round > 0 {
            key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
        }
        let a = u64::from(counter[0]) * 0xD251_1F53;
        let b = u64::from(counter[2]) * 0xCD9E_8D57;
        counter = [
            (b >> 32) as u32 ^ counter[1] ^ key[0],
            b as u32,
            (a >> 32) as u32 ^ counter[3] ^ key[1],
            a as u32,
        ];
    }
    counter
}

/// The numbers of one seed, purpose and step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counter {
    key: [u32; 2],
    step: [u32; 2],
    purpose: u32,
}

impl Counter {
    pub(crate) fn new(seed: u64, purpose: Purpose, step: u64) -> Self {
        let halves = |v: u64| [v as u32, (v >> 32) as u32];
        Self { key: halves(seed), step: halves(step), purpose: purpose as u32 }
    }

    /// Four words of row `i`.
    #[inline]
    pub(crate) fn words(&self, i: usize) -> [u32; 4] {
        // Rows are below 2³², steps below 2⁵⁶: purpose and upper half of the step share a word.
        philox([i as u32, self.step[0], self.step[1] ^ self.purpose << 24, 0], self.key)
    }

    /// Four numbers in `0..1` of row `i`.
    pub(crate) fn units(&self, i: usize) -> [f64; 4] {
        self.words(i).map(|w| f64::from(w) / 4_294_967_296.0)
    }

    /// Three normal numbers of row `i`, by Box and Muller.
    #[inline]
    pub(crate) fn normals(&self, i: usize) -> [f32; 3] {
        // Above 0, so that the logarithm is finite; the largest number is 6.66.
        let [a, b, c, d] = self.words(i).map(|w| (f64::from(w) + 0.5) / 4_294_967_296.0);
        let turn = std::f64::consts::TAU;
        let (r, s) = ((-2.0 * a.ln()).sqrt(), (-2.0 * c.ln()).sqrt());
        let (sin, cos) = (turn * b).sin_cos();
        [(r * cos) as f32, (r * sin) as f32, (s * (turn * d).cos()) as f32]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The vectors that come with the authors' Random123.
    #[test]
    fn known_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            philox([u32::MAX; 4], [u32::MAX; 2]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
    }

    #[test]
    fn normals_have_mean_zero_and_variance_one() {
        let counter = Counter::new(3, Purpose::Noise, 7);
        let n = 20_000;
        let (mut sum, mut square, mut product) = (0.0, 0.0, 0.0);
        // Of independent numbers the mean product of squares is 1, whatever pair.
        let mut squares = [0.0; 3];
        for i in 0..n {
            let v = counter.normals(i).map(f64::from);
            sum += v.iter().sum::<f64>();
            square += v.iter().map(|v| v * v).sum::<f64>();
            product += v[0] * v[1] + v[1] * v[2] + v[2] * v[0];
            for (k, sum) in squares.iter_mut().enumerate() {
                *sum += (v[k] * v[(k + 1) % 3]).powi(2) / n as f64;
            }
        }
        // Five standard deviations: that of a product of two squares is √8.
        assert!(squares.iter().all(|m| (m - 1.0).abs() < 0.1), "{squares:?}");
        let n = 3.0 * n as f64;
        // Four standard deviations of each.
        assert!((sum / n).abs() < 4.0 / n.sqrt());
        assert!((square / n - 1.0).abs() < 4.0 * (2.0 / n).sqrt());
        assert!((product / n).abs() < 4.0 / n.sqrt());
        assert_ne!(counter.words(1), Counter::new(3, Purpose::Add, 7).words(1));
    }

    #[test]
    fn a_row_draws_by_seed_step_purpose_and_row_each_in_its_place() {
        // The third vector of Random123: digits of pi.
        let (counter, key) =
            ([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]);
        assert_eq!(philox(counter, key), [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]);
        use Purpose::{Add, Background, Noise, Order, Relocate, Split, Start};
        let numbers = [Noise, Relocate, Add, Split, Start, Background, Order].map(|p| p as u32);
        assert_eq!(numbers, [1, 2, 3, 4, 5, 6, 7]);
        let counter = Counter::new(0x0000_0005_0000_0007, Split, 0x0000_0003_0000_0002);
        let words = philox([9, 2, 3 ^ (4 << 24), 0], [7, 5]);
        assert_eq!(counter.words(9), words);
        assert_eq!(counter.units(9), words.map(|w| f64::from(w) / 2f64.powi(32)));
        // Box and Muller: the middle of each of 2³² parts of 0 to 1.
        let [a, b, c, d] = words.map(|w| (f64::from(w) + 0.5) / 2f64.powi(32));
        let (r, s, tau) = ((-2.0 * a.ln()).sqrt(), (-2.0 * c.ln()).sqrt(), std::f64::consts::TAU);
        let want = [r * (tau * b).cos(), r * (tau * b).sin(), s * (tau * d).cos()];
        for (got, want) in counter.normals(9).into_iter().zip(want) {
            assert!((f64::from(got) - want).abs() < 1e-6, "{got} {want}");
        }
    }
}

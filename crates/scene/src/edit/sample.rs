//! Keeping some of the Gaussians.

use rand::seq::index::sample;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::str::FromStr;

/// How many Gaussians to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SampleSize {
    /// At most this many.
    Count(usize),
    /// This part of them, 0 to 1.
    Fraction(f64),
}

impl SampleSize {
    /// Some of the rows, at least one, in their order; all alike to be chosen.
    pub(super) fn choose(self, rows: &[usize], seed: u64) -> Vec<usize> {
        let count = match self {
            Self::Count(count) => count.min(rows.len()),
            Self::Fraction(part) => {
                ((rows.len() as f64 * part).round() as usize).clamp(1, rows.len().max(1))
            }
        };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut chosen = sample(&mut rng, rows.len(), count.min(rows.len())).into_vec();
        chosen.sort_unstable();
        chosen.into_iter().map(|i| rows[i]).collect()
    }
}

impl FromStr for SampleSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("{text:?}: write a number of Gaussians (100000) or a part (10%)");
        if let Some(percent) = text.strip_suffix('%') {
            let percent: f64 = percent.trim().parse().map_err(|_| bad())?;
            return if percent > 0.0 && percent <= 100.0 {
                Ok(Self::Fraction(percent / 100.0))
            } else {
                Err(bad())
            };
        }
        match text.parse() {
            Ok(count) if count > 0 => Ok(Self::Count(count)),
            _ => Err(bad()),
        }
    }
}

//! Numbers beside what they should be.

use crate::doctor::case::Finding;
use crate::doctor::measures::{Measures, SignBias, last_place};
use crate::doctor::trial::{Failure, ensure};

/// The error budget of a single chain of operations in f32, relative to f64.
pub(super) const F32: f64 = 1e-5;

/// A value in f64, and what an error is measured against: the value itself, or, where terms cancel,
/// the sum of their magnitudes; an infinite scale allows any number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wide {
    pub(super) value: f64,
    pub(super) scale: f64,
}

impl Wide {
    /// Measured against itself.
    pub(super) fn own(value: f64) -> Self {
        Self { value, scale: value.abs() }
    }

    pub(super) fn of(value: f64, scale: f64) -> Self {
        Self { value, scale: scale.abs() }
    }

    /// Adds a term to a sum.
    pub(super) fn add(&mut self, term: f64) {
        *self = Self::of(self.value + term, self.scale + term.abs());
    }

    /// How far a number is off; where it should be infinite or NaN it has to be.
    pub(super) fn error(self, got: f32) -> f64 {
        let got = f64::from(got);
        if self.value.is_nan() || got.is_nan() {
            return if self.value.is_nan() && got.is_nan() { 0.0 } else { f64::NAN };
        }
        if got == self.value || self.scale.is_infinite() && self.value.is_finite() {
            return 0.0;
        }
        // Below the least normal f32 there are fewer bits.
        (got - self.value).abs() / self.scale.max(f64::from(f32::MIN_POSITIVE))
    }

    /// The same in units in the last place of the scale.
    fn ulp(self, got: f32) -> f64 {
        match self.error(got) {
            0.0 => 0.0,
            error if error.is_finite() => {
                (f64::from(got) - self.value).abs() / last_place(self.scale)
            }
            error => error,
        }
    }
}

/// The largest error, also in units in the last place, and whether errors lean to one side; `what`
/// names a place.
pub(super) fn compare(
    got: &[f32],
    want: &[Wide],
    what: impl Fn(usize) -> String,
) -> Result<Finding, Failure> {
    ensure!(got.len() == want.len(), "{} values, {} expected", got.len(), want.len());
    let mut found = Finding::right();
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        found.add(want.error(*got), || format!("{}: {got:e}, f64 {:e}", what(i), want.value));
        found.measures.join(Measures { ulp: Some(want.ulp(*got)), ..Measures::default() });
    }
    let pairs = got.iter().zip(want).filter(|(_, want)| want.scale.is_finite());
    let triples = pairs.map(|(got, want)| (f64::from(*got), want.value, want.scale));
    found.measures.sign_bias = SignBias::of(triples);
    Ok(found)
}

/// Relative distance of two gradients, ‖a − b‖ / ‖b‖; beside it one less their cosine, and whether errors
/// lean to one side.
pub(super) fn gradient(got: &[f64], want: &[f64]) -> Result<Finding, Failure> {
    ensure!(got.len() == want.len(), "{} values, {} expected", got.len(), want.len());
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).sum::<f64>().sqrt();
    let apart = norm(&mut got.iter().zip(want).map(|(g, w)| g - w));
    let size = norm(&mut want.iter().copied()).max(1e-30);
    let far = |i: &usize| (got[*i] - want[*i]).abs();
    let worst = (0..got.len()).max_by(|a, b| far(a).total_cmp(&far(b)));
    let worst =
        worst.map_or(String::new(), |i| format!("gradient {i}: {:e}, f64 {:e}", got[i], want[i]));
    let length = norm(&mut got.iter().copied()).max(1e-30);
    let root_mean_square = size / (want.len().max(1) as f64).sqrt();
    // Of unit vectors, |a − b|² is twice what their cosine lacks: nothing cancels.
    let between = got.iter().zip(want).map(|(g, w)| (g / length - w / size).powi(2)).sum::<f64>();
    let measures = Measures {
        // Without a gradient there is no direction.
        cosine_distance: (size > 1e-30).then_some(between / 2.0),
        // What is small beside the rest is the rounding of the rest.
        sign_bias: SignBias::of(
            got.iter().zip(want).map(|(g, w)| (*g, *w, w.abs().max(root_mean_square))),
        ),
        ..Measures::default()
    };
    Ok(Finding { error: apart / size, worst, measures })
}

/// Sums of products of `[m, k]` and `[n, k]`, `[m, n]`, measured against the sums of magnitudes.
pub(super) fn products(a: &[f32], b: &[f32], k: usize) -> Vec<Wide> {
    let sum = |a: &[f32], b: &[f32]| {
        let mut sum = Wide::of(0.0, 0.0);
        a.iter().zip(b).for_each(|(a, b)| sum.add(f64::from(*a) * f64::from(*b)));
        sum
    };
    a.chunks_exact(k).flat_map(|a| b.chunks_exact(k).map(move |b| sum(a, b))).collect()
}

/// Compares parts of a gradient that lie one after the other, each by itself.
pub(super) fn gradients(got: &[f32], parts: &[Vec<f64>]) -> Result<Finding, Failure> {
    let (mut found, mut from) = (Finding::right(), 0);
    for want in parts {
        found.join(gradient(&wide(&got[from..from + want.len()]), want)?);
        from += want.len();
    }
    Ok(found)
}

/// As f64.
pub(super) fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::measures::Bounds;

    /// What the verdict hangs on: a wrong operator is seen, whichever way it is wrong.
    #[test]
    fn wrong_numbers_are_seen() {
        let want =
            [Wide::own(1.0), Wide::of(0.0, 2.0), Wide::own(f64::INFINITY), Wide::own(f64::NAN)];
        let right = [1.0, 0.0, f32::INFINITY, f32::NAN];
        let error = |got: &[f32; 4]| compare(got, &want, |i| i.to_string()).unwrap().error;
        assert_eq!(error(&right), 0.0);
        for (i, bad) in [(0, 1.1), (1, 1e-3), (2, f32::MAX), (2, f32::NEG_INFINITY), (3, 0.0)] {
            let mut wrong = right;
            wrong[i] = bad;
            let found = error(&wrong);
            assert!(found.is_nan() || found > 4e-4, "{i}: {bad} gives {found}");
        }
        for i in 0..3 {
            let mut wrong = right;
            wrong[i] = f32::NAN;
            assert!(error(&wrong).is_nan(), "{i}");
        }
        assert!(compare(&right[..3], &want, |i| i.to_string()).is_err());
        assert!(gradient(&[1.0, 2.0], &[1.0, 2.2]).unwrap().error > 0.05);
        assert!(gradient(&[1.0, f64::NAN], &[1.0, 2.0]).unwrap().error.is_nan());
    }

    /// A systematic error far below the tolerance: the relative norm lets it pass, its signs do not.
    #[test]
    fn a_small_systematic_error_is_seen() {
        let want: Vec<f64> = (0..300).map(|i| (f64::from(i) * 0.37).sin()).collect();
        let bounds = Bounds::of(F32);
        let found = |error: &dyn Fn(usize) -> f64| {
            let got: Vec<f64> = want.iter().enumerate().map(|(i, w)| w + error(i)).collect();
            let found = gradient(&got, &want).unwrap();
            assert!(found.error < F32, "{}", found.error);
            bounds.broken(&found.measures)
        };
        let sign = |i: usize| if (i * i + i / 7).is_multiple_of(2) { 1.0 } else { -1.0 };
        assert_eq!(found(&|i| 2e-6 * sign(i)), None);
        assert!(found(&|i| -3e-6 * want[i]).unwrap().contains("lean to one side"), "too short");
        assert!(found(&|_| 1e-6).unwrap().contains("lean to one side"), "shifted");
        assert!(found(&|i| 6e-6 * sign(i)).unwrap().contains("cosine"), "turned");
        // Forwards, beside a number of nearly 2, where a unit in the last place is smallest.
        let late = compare(&[1.99 * 1.000_009], &[Wide::own(1.99)], |i| i.to_string()).unwrap();
        assert!(late.error < F32 && bounds.broken(&late.measures).unwrap().contains("last place"));
        let rounded: Vec<Wide> = want.iter().map(|w| Wide::own(*w)).collect();
        let short: Vec<f32> = want.iter().map(|w| (w * (1.0 - 2e-6)) as f32).collect();
        let short = compare(&short, &rounded, |i| i.to_string()).unwrap();
        assert!(short.error < F32);
        assert!(bounds.broken(&short.measures).unwrap().contains("lean to one side"));
    }
}

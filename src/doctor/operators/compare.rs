//! Numbers beside what they should be.

use crate::doctor::case::{Case, Finding, Level};
use crate::doctor::trial::{Failure, Trial, ensure};

/// Errors of a single f32 operation chain (demands 2a, check 3).
pub(super) const F32: f64 = 1e-5;
/// Of long sums and attention.
pub(super) const LONG: f64 = 1e-4;
/// Of operands rounded to bf16.
pub(super) const BF16: f64 = 2e-2;

/// Why [`F32`] is allowed.
pub(super) const F32_REASON: &str = "error budget of f32: 1e-5 relative to f64";
/// Why [`LONG`] is.
pub(super) const LONG_REASON: &str =
    "error budget of attention and long sums in f32: 1e-4 relative to f64";
/// Why 0 is.
pub(super) const EXACT_REASON: &str = "whole numbers and decisions: right or wrong";

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
}

/// The largest error; `what` names a place.
pub(super) fn compare(
    got: &[f32],
    want: &[Wide],
    what: impl Fn(usize) -> String,
) -> Result<Finding, Failure> {
    ensure!(got.len() == want.len(), "{} values, {} expected", got.len(), want.len());
    let mut found = Finding::right();
    for (i, (got, want)) in got.iter().zip(want).enumerate() {
        found.add(want.error(*got), || format!("{}: {got:e}, f64 {:e}", what(i), want.value));
    }
    Ok(found)
}

/// Relative distance of two gradients, ‖a − b‖ / ‖b‖.
pub(super) fn gradient(got: &[f64], want: &[f64]) -> Result<Finding, Failure> {
    ensure!(got.len() == want.len(), "{} values, {} expected", got.len(), want.len());
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|v| v * v).sum::<f64>().sqrt();
    let apart = norm(&mut got.iter().zip(want).map(|(g, w)| g - w));
    let size = norm(&mut want.iter().copied()).max(1e-30);
    let far = |i: &usize| (got[*i] - want[*i]).abs();
    let worst = (0..got.len()).max_by(|a, b| far(a).total_cmp(&far(b)));
    let worst =
        worst.map_or(String::new(), |i| format!("gradient {i}: {:e}, f64 {:e}", got[i], want[i]));
    Ok(Finding { error: apart / size, worst })
}

/// A case of an operator.
pub(super) fn operator(
    name: impl Into<String>,
    area: &'static str,
    check: impl Fn(&Trial<'_>) -> Result<Finding, Failure> + Send + Sync + 'static,
) -> Case {
    Case { area, tolerance: F32, reason: F32_REASON, ..Case::new(name, Level::Operators, check) }
}

/// A case of an operator whose result is right or wrong.
pub(super) fn decision(
    name: impl Into<String>,
    area: &'static str,
    check: impl Fn(&Trial<'_>) -> Result<Finding, Failure> + Send + Sync + 'static,
) -> Case {
    Case { tolerance: 0.0, reason: EXACT_REASON, ..operator(name, area, check) }
}

/// As f64.
pub(super) fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

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
}

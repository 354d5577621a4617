//! What is measured of an operator beside its error, and what it may come to.

use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::fmt;

/// Bits behind the leading one of an f32.
const BITS: i32 = 23;
/// Deviations from an even share of signs that chance does not give: once in two million cases.
const SIGN_Z: f64 = 5.0;
/// The larger share of signs that is always allowed: errors of one row have a factor in common, so
/// that they are fewer than they seem.
const SIGN_SHARE: f64 = 0.65;
/// Errors below so many units in the last place are too small to have a direction.
const SIGN_FLOOR: f64 = 2.0;
/// One in so many numbers has to have such an error, or it is the rounding of what a few have in common.
const SIGN_COMMON: usize = 10;

/// Measured beside the error, where it has a meaning.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Largest forward error in units in the last place of f32, at the magnitude that the relative
    /// error is measured against.
    pub ulp: Option<f64>,
    /// Of a gradient: one less the cosine with the gradient in f64.
    pub cosine_distance: Option<f64>,
    /// Whether the errors lean to one side.
    pub sign_bias: Option<SignBias>,
}

impl Measures {
    /// The larger of each.
    pub(super) fn join(&mut self, other: Self) {
        let larger = |a: Option<f64>, b: Option<f64>| match (a, b) {
            // NaN is larger than anything.
            (Some(a), Some(b)) => Some(if a >= b || a.is_nan() { a } else { b }),
            (a, b) => a.or(b),
        };
        self.ulp = larger(self.ulp, other.ulp);
        self.cosine_distance = larger(self.cosine_distance, other.cosine_distance);
        self.sign_bias = match (self.sign_bias, other.sign_bias) {
            (Some(a), Some(b)) => Some(if a.excess() >= b.excess() { a } else { b }),
            (a, b) => a.or(b),
        };
    }
}

impl fmt::Display for Measures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        parts.extend(self.ulp.map(|ulp| format!("{ulp:.1} ULP")));
        parts.extend(self.cosine_distance.map(|far| format!("cosine 1 − {far:.0e}")));
        if let Some(SignBias { errors, share, z, .. }) = self.sign_bias {
            parts.push(format!("signs {:.0} % of {errors}, z {z:.1}", 100.0 * share));
        }
        f.write_str(&parts.join(", "))
    }
}

/// How many errors have the sign that most of them have.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SignBias {
    /// Different numbers.
    pub numbers: usize,
    /// Errors that count: those of two units in the last place and more.
    pub errors: usize,
    /// Share of them with the sign of most, 0.5..=1.
    pub share: f64,
    /// How far that is from one half, in standard deviations of a fair coin.
    pub z: f64,
}

impl SignBias {
    /// Of numbers beside the right ones.
    ///
    /// Errors may lean up or down, or away from zero or toward it (a gradient that is too long or too
    /// short everywhere): the stronger of the two counts.
    /// Each with the magnitude at which a unit in the last place is taken. A number that comes several
    /// times is rounded alike each time: it counts once.
    pub(super) fn of(triples: impl Iterator<Item = (f64, f64, f64)>) -> Option<Self> {
        let (mut all, mut up, mut away) = (0usize, 0usize, 0usize);
        let mut before = HashSet::new();
        for (got, want, magnitude) in triples {
            let error = got - want;
            let new = error.is_finite() && before.insert(got.abs().to_bits());
            if !new || error.abs() < SIGN_FLOOR * last_place(magnitude) {
                continue;
            }
            all += 1;
            up += usize::from(error > 0.0);
            away += usize::from(error * want.signum() > 0.0);
        }
        if all == 0 {
            return None;
        }
        let n = f64::from(u32::try_from(all).unwrap_or(u32::MAX));
        let share = |count: usize| {
            let share = f64::from(u32::try_from(count).unwrap_or(u32::MAX)) / n;
            share.max(1.0 - share)
        };
        let share = share(up).max(share(away));
        Some(Self { numbers: before.len(), errors: all, share, z: (2.0 * share - 1.0) * n.sqrt() })
    }

    /// How far beyond what is allowed; up to 0 is allowed.
    fn excess(&self) -> f64 {
        if self.errors * SIGN_COMMON < self.numbers {
            return f64::NEG_INFINITY;
        }
        ((self.z - SIGN_Z) / SIGN_Z).min((self.share - SIGN_SHARE) / SIGN_SHARE)
    }
}

/// What the measures may come to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Of [`Measures::ulp`]: the tolerance at √2, in the middle between two powers of 2; the relative error
    /// alone lets through up to 1.4 times as many just below a power of 2.
    pub ulp: f64,
    /// Of [`Measures::cosine_distance`]: the direction takes at most half of the tolerance.
    pub cosine_distance: f64,
    /// Of [`SignBias::share`], …
    pub sign_share: f64,
    /// … unless [`SignBias::z`] is at most this.
    pub sign_z: f64,
}

impl Bounds {
    /// Those that go with a tolerance of the relative error.
    pub fn of(tolerance: f64) -> Self {
        Self {
            ulp: tolerance * (f64::from(BITS) + 0.5).exp2(),
            cosine_distance: (tolerance / 2.0).powi(2) / 2.0,
            sign_share: SIGN_SHARE,
            sign_z: SIGN_Z,
        }
    }

    /// What is beyond them, in words.
    pub(super) fn broken(&self, found: &Measures) -> Option<String> {
        // NaN is within nothing.
        if let Some(ulp) = found.ulp.filter(|ulp| ulp.is_nan() || *ulp > self.ulp) {
            return Some(format!("{ulp:.1} units in the last place, {:.1} are allowed", self.ulp));
        }
        let bound = self.cosine_distance;
        if let Some(far) = found.cosine_distance.filter(|far| far.is_nan() || *far > bound) {
            return Some(format!(
                "the gradient's cosine with that of f64 is 1 − {far:.1e}, {bound:.1e} is allowed"
            ));
        }
        let bias = found.sign_bias.filter(|bias| bias.excess() > 0.0)?;
        Some(format!(
            "{:.1} % of {} errors lean to one side (z {:.1}): the result is biased",
            100.0 * bias.share,
            bias.errors,
            bias.z
        ))
    }
}

/// The unit in the last place of f32 at a magnitude; that of the least normal number below it.
pub(super) fn last_place(magnitude: f64) -> f64 {
    let magnitude = magnitude.max(f64::from(f32::MIN_POSITIVE));
    // The exponent of an f64: a normal f32 is a normal f64, too.
    let exponent = ((magnitude.to_bits() >> 52) & 0x7ff) as i32 - 1023;
    f64::from(exponent - BITS).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_in_the_last_place_is_the_step_to_the_next_f32() {
        for v in [1.0f32, 1.999, 2.0, 3.7e-5, 6.1e30, f32::MIN_POSITIVE, 1e-41, 0.0] {
            let step = f64::from(f32::from_bits(v.max(f32::MIN_POSITIVE).to_bits() + 1))
                - f64::from(v.max(f32::MIN_POSITIVE));
            assert_eq!(last_place(f64::from(v)), step, "{v:e}");
        }
    }

    /// Errors that a relative norm lets through, as long as they are small; each bound sees its own.
    #[test]
    fn each_bound_can_be_broken_alone() {
        let bounds = Bounds::of(1e-5);
        assert_eq!(bounds.broken(&Measures::default()), None);
        let ulp = |ulp: f64| Measures { ulp: Some(ulp), ..Measures::default() };
        assert_eq!(bounds.broken(&ulp(118.0)), None);
        assert!(bounds.broken(&ulp(119.0)).unwrap().contains("last place"));
        assert!(bounds.broken(&ulp(f64::NAN)).is_some());
        let far = |d: f64| Measures { cosine_distance: Some(d), ..Measures::default() };
        assert_eq!(bounds.broken(&far(1e-11)), None);
        assert!(bounds.broken(&far(1.3e-11)).unwrap().contains("cosine"));
        assert!(bounds.broken(&far(f64::NAN)).is_some());
        let want: Vec<f64> = (0..400).map(|i| (f64::from(i) * 0.7).sin()).collect();
        let bias = |error: &dyn Fn(usize, f64) -> f64| Measures {
            sign_bias: SignBias::of(
                want.iter().enumerate().map(|(i, w)| (w + error(i, *w), *w, w.abs())),
            ),
            ..Measures::default()
        };
        // As a coin falls.
        let coin = |i: usize| if (i * i + i / 7).is_multiple_of(2) { 1e-6 } else { -1e-6 };
        assert_eq!(bounds.broken(&bias(&|i, _| coin(i))), None);
        for error in [|_, _| 1e-6, |_, w: f64| -3e-6 * w] as [fn(usize, f64) -> f64; 2] {
            assert!(bounds.broken(&bias(&error)).unwrap().contains("100.0 % of"));
        }
        // The last bit alone has no direction.
        assert_eq!(bias(&|_, w| 1e-8 * w).sign_bias, None);
        // One row of ten is off by a factor of its own.
        let row = bias(&|i, w| if (40..75).contains(&i) { 1e-6 * w } else { 0.0 });
        assert!(row.sign_bias.unwrap().share == 1.0 && bounds.broken(&row).is_none());
        // Few errors prove nothing.
        let few = SignBias::of((1..20).map(f64::from).map(|i| (i * 1.01, i, i)));
        assert_eq!(few.map(|few| few.share), Some(1.0));
        // One number a hundred times is one rounding.
        let same =
            SignBias::of((0..100).map(|i| (if i % 3 == 0 { -1.01 } else { 1.01 }, 1.0, 1.0)));
        assert_eq!(same.map(|same| same.errors), Some(1));
        assert_eq!(bounds.broken(&Measures { sign_bias: few, ..Measures::default() }), None);
    }

    #[test]
    fn parts_join_to_the_worse() {
        let bias = |share: f64, z: f64| Some(SignBias { numbers: 9, errors: 9, share, z });
        let mut all = Measures { ulp: Some(1.0), cosine_distance: None, sign_bias: bias(0.9, 2.0) };
        all.join(Measures {
            ulp: Some(f64::NAN),
            cosine_distance: Some(1e-9),
            sign_bias: bias(0.8, 9.0),
        });
        all.join(Measures { ulp: Some(3.0), cosine_distance: Some(1e-12), sign_bias: None });
        assert!(all.ulp.unwrap().is_nan() && all.cosine_distance == Some(1e-9));
        assert_eq!(all.sign_bias, bias(0.8, 9.0));
    }
}

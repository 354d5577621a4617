//! What becomes of a Gaussian that is split into copies of itself, such that together they look as it did.

/// Least and largest opacity after a split: below it is dead again, above the logit is infinite.
const OPACITY: [f64; 2] = [0.005, 1.0 - f32::EPSILON as f64];
/// Most copies of one Gaussian: gsplat's table of binomials ends there.
pub const MOST_COPIES: u32 = 51;

/// Which order of clamping: the two differ where the new opacity is below 0.005.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Relocation {
    /// Scales from the unclamped opacity: gsplat up to 1.5.3, the authors of MCMC, the data set's trainer.
    #[default]
    #[serde(rename = "gsplat-1.5")]
    Gsplat15,
    /// Scales from the clamped opacity: gsplat 1.6.
    #[serde(rename = "gsplat-1.6")]
    Gsplat16,
}

/// Opacity and scales of each of `copies` Gaussians that take the place of one.
///
/// `o' = 1 − (1 − o)^(1/K)`, `s' = s · o / Σ_{j=1..K} (−1)^{j−1} C(K, j) o'^j / √j`, in f64.
///
/// - `opacity`: in 0..=1 · `scale`: standard deviations · `copies`: `K`, 1 to 51, else the nearest of them
///
/// # Source
/// Equation 9 of 3DGS as Markov Chain Monte Carlo (Kheradmand 2024). Differs: the double sum is one sum,
/// by the hockey-stick identity.
pub fn relocated(
    opacity: f32,
    scale: [f32; 3],
    copies: u32,
    version: Relocation,
) -> (f32, [f32; 3]) {
    let copies = copies.clamp(1, MOST_COPIES);
    // At 1 the alternating sum would lose all digits.
    let opacity = f64::from(opacity).clamp(0.0, OPACITY[1]);
    let split = 1.0 - (1.0 - opacity).powf(1.0 / f64::from(copies));
    let clamped = split.clamp(OPACITY[0], OPACITY[1]);
    let drawn = match version {
        Relocation::Gsplat15 => split,
        Relocation::Gsplat16 => clamped,
    };
    let factor = opacity / thickness(drawn, copies);
    // Opacity 0 has no shape to keep.
    let factor = if factor.is_finite() { factor } else { 1.0 };
    // Above 0, so that its logarithm is a number.
    let new_scale = |s: f32| ((f64::from(s) * factor) as f32).max(f32::MIN_POSITIVE);
    (clamped as f32, scale.map(new_scale))
}

/// `Σ_{j=1..K} (−1)^{j−1} C(K, j) oʲ / √j`.
fn thickness(opacity: f64, copies: u32) -> f64 {
    let (mut sum, mut term) = (0.0, -1.0);
    for j in 1..=copies {
        // C(K, j) from C(K, j − 1); the sign turns with each.
        term *= -opacity * f64::from(copies - j + 1) / f64::from(j);
        sum += term / f64::from(j).sqrt();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sum as the paper prints it.
    fn double_sum(o: f64, copies: u32) -> f64 {
        let binomial =
            |n: u32, k: u32| (0..k).fold(1.0, |c, i| c * f64::from(n - i) / f64::from(i + 1));
        let mut sum = 0.0;
        for i in 1..=copies {
            for k in 0..i {
                let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                sum += binomial(i - 1, k) * sign * o.powi(k as i32 + 1) / f64::from(k + 1).sqrt();
            }
        }
        sum
    }

    #[test]
    fn one_sum_is_the_double_sum() {
        for copies in 1..=MOST_COPIES {
            for o in [0.005, 0.1, 0.5, 0.9, 0.999] {
                let split = 1.0 - (1.0f64 - o).powf(1.0 / f64::from(copies));
                let (got, want) = (thickness(split, copies), double_sum(split, copies));
                assert!((got - want).abs() < 1e-9 * want.abs(), "{copies} {o}: {got} {want}");
            }
        }
    }

    #[test]
    fn edges() {
        for version in [Relocation::Gsplat15, Relocation::Gsplat16] {
            let (o, s) = relocated(0.3, [1.0, 2.0, 3.0], 1, version);
            assert!((o - 0.3).abs() < 1e-7 && s == [1.0, 2.0, 3.0]);
            for opacity in [0.0, 1.0, f32::MIN_POSITIVE] {
                let (o, s) = relocated(opacity, [1.0; 3], 1000, version);
                assert!(
                    (0.005..1.0).contains(&o) && s[0].is_finite() && s[0] > 0.0,
                    "{opacity} {s:?}"
                );
            }
        }
    }

    #[test]
    fn versions_differ_where_the_new_opacity_is_dead() {
        // By hand: of two that are 0.004 together each has 1 − √0.996 = 0.002002, which is clamped to 0.005.
        // thickness(o, 2) = 2 o − o²/√2.
        let split = 1.0 - 0.996f64.sqrt();
        let of = |o: f64| 0.004 / (2.0 * o - o * o / 2.0f64.sqrt());
        for (version, due) in [(Relocation::Gsplat15, of(split)), (Relocation::Gsplat16, of(0.005))]
        {
            let (opacity, scale) = relocated(0.004, [1.0, 2.0, 3.0], 2, version);
            assert!((opacity - 0.005).abs() < 1e-9, "{version:?}: {opacity}");
            for (found, k) in scale.into_iter().zip([1.0, 2.0, 3.0]) {
                let wanted = due * k;
                assert!((f64::from(found) - wanted).abs() < 1e-5, "{version:?}: {found}, {wanted}");
            }
        }
    }

    #[test]
    fn shapes_of_copies_by_hand() {
        // Three of 0.8: o' = 1 − 0.2^(1/3), D = 3 o' − 3 o'²/√2 + o'³/√3.
        let o = 1.0 - 0.2f64.cbrt();
        let factor = 0.8 / (3.0 * o - 3.0 * o * o / 2f64.sqrt() + o.powi(3) / 3f64.sqrt());
        let (opacity, scale) = relocated(0.8, [0.5, 1.0, 4.0], 3, Relocation::default());
        assert!((f64::from(opacity) - o).abs() < 1e-7);
        for (found, k) in scale.into_iter().zip([0.5, 1.0, 4.0]) {
            assert!((f64::from(found) / (factor * k) - 1.0).abs() < 1e-6, "{found}");
        }
        assert_eq!((Relocation::default(), MOST_COPIES), (Relocation::Gsplat15, 51));
        for version in [Relocation::Gsplat15, Relocation::Gsplat16] {
            let of = |opacity: f32, copies| relocated(opacity, [1.0; 3], copies, version);
            assert_eq!((of(0.9, 52), of(0.9, 0)), (of(0.9, 51), of(0.9, 1)));
            assert_ne!(of(0.9, 51), of(0.9, 50));
            // The largest has a finite logit.
            assert_eq!(of(1.0, 1).0, 1.0 - f32::EPSILON);
        }
        // Nothing of an opacity of 0 is to be kept; with the clamped one it gets as small as can be.
        assert_eq!(relocated(0.0, [2.0; 3], 2, Relocation::Gsplat15), (0.005, [2.0; 3]));
        let least = [f32::MIN_POSITIVE; 3];
        assert_eq!(relocated(0.0, [2.0; 3], 2, Relocation::Gsplat16), (0.005, least));
        let names = [Relocation::Gsplat15, Relocation::Gsplat16]
            .map(|v| serde_json::to_string(&v).unwrap());
        assert_eq!(names, ["\"gsplat-1.5\"", "\"gsplat-1.6\""]);
    }
}

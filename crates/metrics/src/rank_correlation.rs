//! Spearman's rank correlation.

/// Spearman's rank correlation of two lists of equal length, −1 to 1; equal values share the mean of their
/// ranks. `None` if one of both is constant, or there is nothing.
///
/// Values that are NaN have no rank, and give `None`.
///
/// # Panics
/// If the lists differ in length (a bug of the caller).
pub fn rank_correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    assert_eq!(a.len(), b.len(), "pairs");
    if a.iter().chain(b).any(|v| v.is_nan()) {
        return None;
    }
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() as f64 - 1.0) / 2.0;
    let product =
        |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    let norm = (product(&a, &a) * product(&b, &b)).sqrt();
    (norm > 0.0).then(|| product(&a, &b) / norm)
}

/// Ranks from 0; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let rank = |v: &f64| {
        let below = values.iter().filter(|other| *other < v).count() as f64;
        let equal = values.iter().filter(|other| *other == v).count() as f64;
        below + (equal - 1.0) / 2.0
    };
    values.iter().map(rank).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let near = |got: Option<f64>, want: f64| {
            assert!((got.unwrap() - want).abs() < 1e-12, "{got:?} {want}");
        };
        near(rank_correlation(&[1.0, 2.0, 30.0], &[-5.0, 0.0, 1e9]), 1.0);
        near(rank_correlation(&[1.0, 2.0, 30.0], &[3.0, 2.0, 1.0]), -1.0);
        // Ranks 0 1 2 3 and 1 0 3 2: 1 − 6 · 4 / (4 · 15).
        near(rank_correlation(&[1.0, 2.0, 3.0, 4.0], &[2.0, 1.0, 4.0, 3.0]), 0.6);
        // Ranks ½ ½ 2 and 0 1 2: 1.5 / √(1.5 · 2).
        near(rank_correlation(&[7.0, 7.0, 9.0], &[1.0, 2.0, 3.0]), 0.75f64.sqrt());
    }

    #[test]
    fn what_has_no_correlation() {
        assert_eq!(rank_correlation(&[], &[]), None);
        assert_eq!(rank_correlation(&[1.0], &[2.0]), None);
        assert_eq!(rank_correlation(&[1.0, 1.0], &[1.0, 2.0]), None);
        assert_eq!(rank_correlation(&[1.0, f64::NAN], &[1.0, 2.0]), None);
        assert!(rank_correlation(&[f64::INFINITY, 0.0], &[1.0, -1.0]).is_some());
    }
}

//! Quantiles by nearest rank: each is a value that occurs.

/// Index of a quantile among `len` sorted values: the nearest rank. `share` in 0..=1.
pub fn rank(len: usize, share: f64) -> usize {
    (len.saturating_sub(1) as f64 * share).round() as usize
}

/// Quantile of unsorted values, which are rearranged; `None` without any. Numbers compare as in
/// IEEE's total order, so that NaN has its place too.
pub fn quantile(values: &mut [f32], share: f64) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let at = rank(values.len(), share);
    Some(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occur() {
        let mut values: Vec<f32> = (0..=100).rev().map(|i| i as f32).collect();
        assert_eq!(quantile(&mut values, 0.05), Some(5.0));
        assert_eq!(quantile(&mut [3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(&mut [], 0.5), None);
        assert_eq!((rank(0, 1.0), rank(1, 0.9), rank(101, 0.99)), (0, 0, 99));
    }
}

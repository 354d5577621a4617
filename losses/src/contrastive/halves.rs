//! Random halves of the rows of each class.

use super::NAME;
use crate::IGNORE;
use crate::error::{LossError, check_len};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use std::collections::BTreeMap;

/// The rows of a class, cut in two.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassHalves {
    /// The class.
    pub label: i32,
    /// ⌊n/2⌋ rows.
    pub first: Vec<u32>,
    /// ⌈n/2⌉ rows, the others.
    pub second: Vec<u32>,
}

/// Cuts the rows of each class in two at random; classes ascend, rows ascend in each half.
///
/// Rows that are ignored or not valid are left out, then classes with fewer than `min_points` rows.
/// A class draws from a stream of its own, so its halves depend on the seed, its label and its rows,
/// not on the other classes.
///
/// # Errors
/// If the lengths differ, a label is below -1, or `min_points` below 2 (a half would be empty).
pub fn split_classes(
    labels: &[i32],
    valid: Option<&[bool]>,
    min_points: usize,
    seed: u64,
) -> Result<Vec<ClassHalves>, LossError> {
    if min_points < 2 {
        let value = min_points.to_string();
        let expected = "at least 2";
        return Err(LossError::Setting { loss: NAME, setting: "min_points", value, expected });
    }
    if let Some(valid) = valid {
        check_len(NAME, "valid", labels.len(), valid.len())?;
    }
    let mut classes = BTreeMap::<i32, Vec<u32>>::new();
    for (row, &label) in labels.iter().enumerate() {
        if label < IGNORE {
            let classes = i32::MAX as usize;
            return Err(LossError::Label { loss: NAME, row, value: label, classes });
        }
        if label != IGNORE && valid.is_none_or(|v| v[row]) {
            classes.entry(label).or_default().push(row as u32);
        }
    }
    let large = classes.into_iter().filter(|(_, rows)| rows.len() >= min_points);
    Ok(large.map(|(label, rows)| split(label, rows, seed)).collect())
}

fn split(label: i32, mut rows: Vec<u32>, seed: u64) -> ClassHalves {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(u64::from(label.unsigned_abs()));
    let half = rows.len() / 2;
    for i in 0..half {
        // A number below n: the bias is at most n / 2⁶⁴.
        let below = (u128::from(rng.next_u64()) * (rows.len() - i) as u128) >> 64;
        rows.swap(i, i + below as usize);
    }
    let mut second = rows.split_off(half);
    // In memory order.
    rows.sort_unstable();
    second.sort_unstable();
    ClassHalves { label, first: rows, second }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail loudly")]
mod tests {
    use super::*;

    #[test]
    fn exact_halves_of_what_counts() {
        let labels: Vec<i32> = (0..1000).map(|i| [-1, 3, 7, 7, 3, 3, 9][i % 7]).collect();
        let valid: Vec<bool> = (0..1000).map(|i| i % 11 != 0).collect();
        let halves = split_classes(&labels, Some(&valid), 140, 5).unwrap();
        assert_eq!(halves.iter().map(|h| h.label).collect::<Vec<_>>(), [3, 7]);
        for half in &halves {
            let mut all = [half.first.clone(), half.second.clone()].concat();
            assert_eq!(half.first.len(), all.len() / 2);
            assert!(half.first.is_sorted() && half.second.is_sorted());
            all.sort_unstable();
            let want = (0..1000).filter(|&i| labels[i] == half.label && valid[i]);
            assert_eq!(all, want.map(|i| i as u32).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_class_draws_for_itself() {
        let labels: Vec<i32> = (0..600).map(|i| i % 3).collect();
        let all = split_classes(&labels, None, 2, 1).unwrap();
        let two: Vec<i32> = labels.iter().map(|&l| if l == 1 { IGNORE } else { l }).collect();
        let two = split_classes(&two, None, 2, 1).unwrap();
        assert_eq!((&all[0], &all[2]), (&two[0], &two[1]));
        assert_ne!(all, split_classes(&labels, None, 2, 2).unwrap());
        // Classes of the same rows would otherwise be cut alike.
        let places = |h: &ClassHalves| h.first.iter().map(|r| r / 3).collect::<Vec<_>>();
        assert_ne!(places(&all[0]), places(&all[1]));
    }

    #[test]
    fn every_row_is_in_the_first_half_as_often() {
        let mut counts = [0; 7];
        for seed in 0..7000 {
            for row in &split_classes(&[4; 7], None, 2, seed).unwrap()[0].first {
                counts[*row as usize] += 1;
            }
        }
        // 3000 each; the standard deviation is 41.
        assert!(counts.iter().all(|c| (2800..3200).contains(c)), "{counts:?}");
    }

    #[test]
    fn refusals() {
        let label = split_classes(&[0, -2], None, 2, 0).unwrap_err().to_string();
        assert!(label.contains("label[1] is -2"), "{label}");
        assert!(split_classes(&[0, 1], Some(&[true]), 2, 0).is_err());
        assert!(split_classes(&[0, 1], None, 1, 0).unwrap_err().to_string().contains("at least 2"));
    }
}

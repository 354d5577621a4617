//! Quantiles and histograms that do not depend on the number of threads.

use rayon::prelude::*;
use scenesplat_scene::quantile::rank;
use serde::Serialize;

/// Rows of one task.
const ROWS_PER_TASK: usize = 1 << 14;

/// Values at fixed shares of the sorted rows. Nearest rank, so each is a value that occurs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Smallest.
    pub min: f64,
    /// 1 % are below or equal.
    pub p1: f64,
    /// 5 %.
    pub p5: f64,
    /// A quarter.
    pub p25: f64,
    /// The median.
    pub p50: f64,
    /// Three quarters.
    pub p75: f64,
    /// 95 %.
    pub p95: f64,
    /// 99 %.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Counts in bins of equal width. NaN values are not counted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Histogram {
    /// What the values are, with their unit.
    pub of: &'static str,
    /// Borders of the bins, one more than there are bins; numbers with at most three decimals in
    /// JSON.
    #[serde(serialize_with = "as_numbers")]
    pub borders: Vec<Border>,
    /// Rows in each bin; the upper border belongs to the next bin, that of the last to the last.
    pub counts: Vec<u64>,
    /// Rows below the first border, `-inf` included.
    pub below: u64,
    /// Rows above the last border, `inf` included.
    pub above: u64,
}

/// A border of a histogram in units of 1/1000: exact, so that histograms can be compared.
pub type Border = i32;

fn as_numbers<S: serde::Serializer>(borders: &[Border], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(borders.iter().map(|&b| f64::from(b) / 1000.0))
}

impl Histogram {
    /// Counts `values` into `bins` bins from `low` to `high`, in units of 1/1000.
    pub(super) fn count(
        of: &'static str,
        values: &[f32],
        [low, high]: [Border; 2],
        bins: u16,
    ) -> Self {
        let (first, last) = (f64::from(low) / 1000.0, f64::from(high) / 1000.0);
        let per_unit = f64::from(bins) / (last - first);
        let bins_usize = usize::from(bins);
        // Slot 0 is below, slot bins + 1 above.
        let slots = values
            .par_chunks(ROWS_PER_TASK)
            .map(|values| {
                let mut slots = vec![0u64; bins_usize + 2];
                for &value in values {
                    let value = f64::from(value);
                    if value < first {
                        slots[0] += 1;
                    } else if value > last {
                        slots[bins_usize + 1] += 1;
                    } else if !value.is_nan() {
                        let bin = ((value - first) * per_unit) as usize;
                        slots[1 + bin.min(bins_usize - 1)] += 1;
                    }
                }
                slots
            })
            .reduce(
                || vec![0; bins_usize + 2],
                |mut a, b| {
                    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                    a
                },
            );
        let width = (high - low) / i32::from(bins);
        Self {
            of,
            borders: (0..=i32::from(bins)).map(|i| low + i * width).collect(),
            counts: slots[1..=bins_usize].to_vec(),
            below: slots[0],
            above: slots[bins_usize + 1],
        }
    }
}

/// Sorts in parallel; numbers compare as in IEEE's total order, so that NaN has its place too.
pub(super) fn sort(values: &mut [f32]) {
    values.par_sort_unstable_by(f32::total_cmp);
}

impl Quantiles {
    /// Of what sorted values stand for, in the same order; `None` without any.
    pub(super) fn of_sorted(sorted: &[f32], value: impl Fn(f64) -> f64) -> Option<Self> {
        if sorted.is_empty() {
            return None;
        }
        let at = |share| value(f64::from(sorted[rank(sorted.len(), share)]));
        Some(Self {
            min: at(0.0),
            p1: at(0.01),
            p5: at(0.05),
            p25: at(0.25),
            p50: at(0.5),
            p75: at(0.75),
            p95: at(0.95),
            p99: at(0.99),
            max: at(1.0),
        })
    }
}

/// Counts the rows that `holds` is true of, with the first of them.
pub(super) fn count_rows(rows: usize, holds: impl Fn(usize) -> bool + Sync) -> Counted {
    (0..rows)
        .into_par_iter()
        .with_min_len(ROWS_PER_TASK)
        .filter(|&row| holds(row))
        .fold(Counted::default, |sum, row| sum.and(Counted { count: 1, first: Some(row) }))
        .reduce(Counted::default, Counted::and)
}

/// A number of rows and the first of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Counted {
    pub(super) count: usize,
    pub(super) first: Option<usize>,
}

impl Counted {
    /// So many rows, of which none is named.
    pub(super) fn of(count: usize) -> Self {
        Self { count, first: None }
    }

    fn and(self, other: Self) -> Self {
        let first = match (self.first, other.first) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        Self { count: self.count + other.count, first }
    }
}

/// The row with the largest value, the first of equals; rows of value `None` do not compete.
pub(super) fn largest(
    rows: usize,
    value: impl Fn(usize) -> Option<f64> + Sync,
) -> Option<(usize, f64)> {
    (0..rows)
        .into_par_iter()
        .with_min_len(ROWS_PER_TASK)
        .filter_map(|row| value(row).map(|v| (row, v)))
        .reduce_with(|a, b| {
            // Tasks may meet in any order; rows settle ties.
            if (b.1, a.0) > (a.1, b.0) { b } else { a }
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occur() {
        let sorted: Vec<f32> = (0..=100).map(|i| i as f32).collect();
        let q = Quantiles::of_sorted(&sorted, |v| v).unwrap();
        assert_eq!((q.min, q.p5, q.p50, q.p99, q.max), (0.0, 5.0, 50.0, 99.0, 100.0));
        assert_eq!(Quantiles::of_sorted(&[], |v| v), None);
        let one = Quantiles::of_sorted(&[7.0], |v| v).unwrap();
        assert_eq!((one.min, one.p50, one.max), (7.0, 7.0, 7.0));
    }

    #[test]
    fn every_number_is_in_one_bin() {
        let inf = f32::INFINITY;
        let values = [-inf, -0.1, 0.0, 0.24, 0.25, 0.99, 1.0, 1.1, inf, f32::NAN];
        let h = Histogram::count("test", &values, [0, 1000], 4);
        assert_eq!(h.borders, [0, 250, 500, 750, 1000]);
        assert_eq!(h.counts, [2, 1, 0, 2]);
        assert_eq!((h.below, h.above), (2, 2));
    }

    #[test]
    fn first_and_largest_rows_are_the_same_for_any_order() {
        let n = 100_000;
        let found = count_rows(n, |row| row % 1000 == 999);
        assert_eq!(found, Counted { count: 100, first: Some(999) });
        assert_eq!(largest(n, |row| Some((row % 777) as f64)), Some((776, 776.0)));
        assert_eq!(largest(n, |_| None), None);
    }
}

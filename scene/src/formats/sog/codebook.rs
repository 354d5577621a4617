//! The 256 values that stand for all values of a kind.

use rayon::prelude::*;

/// Most values a byte can tell apart.
const ENTRIES: usize = 256;
/// Rounds of moving entries to the mean of what they stand for. Later ones change the error by
/// less than a thousandth.
const ROUNDS: usize = 40;
/// Cells of the histogram that the first entries are placed by.
const CELLS: usize = 4096;

/// Ascending, distinct values; at least one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Codebook {
    values: Vec<f32>,
}

impl Codebook {
    /// The values that stand for the given ones with a small squared error; the given ones
    /// themselves if there are no more than 256. Each value stands for at least one.
    ///
    /// Starting places depend on how values are spread, not on chance. Values must be finite.
    pub(super) fn fit(mut values: Vec<f32>) -> Self {
        // The sum turns −0 into 0.
        values.par_iter_mut().for_each(|v| *v += 0.0);
        values.par_sort_unstable_by(f32::total_cmp);
        if let Some(few) = distinct(&values) {
            return Self { values: few };
        }
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(values.iter().scan(0.0, |sum, &v| {
                *sum += f64::from(v);
                Some(*sum)
            }))
            .collect();
        let mut entries = first_entries(&values);
        for _ in 0..ROUNDS {
            let moved = means(&values, &sums, &entries);
            if moved == entries {
                break;
            }
            entries = moved;
        }
        // Entries that stand for nothing would be lost when the file is read and written again.
        let book = Self { values: entries };
        let ends = book.ends(&values);
        let starts = std::iter::once(0).chain(ends.iter().copied());
        let used = book.values.iter().zip(starts.zip(&ends)).filter(|(_, (a, b))| a < b);
        Self { values: used.map(|(&v, _)| v).collect() }
    }

    /// The number of the nearest value; of two equally near ones the lower.
    pub(super) fn code(&self, value: f32) -> u8 {
        let last = self.values.len() - 1;
        let above = self.values.partition_point(|&v| v < value).min(last);
        let is_lower = above > 0 && !is_beyond(value, self.values[above - 1], self.values[above]);
        // At most 256 values.
        (above - usize::from(is_lower)) as u8
    }

    /// The values, repeated at the end up to 256: readers expect as many.
    pub(super) fn padded(&self) -> [f32; ENTRIES] {
        let last = self.values.last().copied().unwrap_or(0.0);
        std::array::from_fn(|i| self.values.get(i).copied().unwrap_or(last))
    }

    /// Where in sorted values the share of each entry ends.
    fn ends(&self, sorted: &[f32]) -> Vec<usize> {
        let limits = self
            .values
            .windows(2)
            .map(|pair| sorted.partition_point(|&v| !is_beyond(v, pair[0], pair[1])));
        limits.chain([sorted.len()]).collect()
    }
}

/// Whether a value is nearer to the upper of two entries.
fn is_beyond(value: f32, lower: f32, upper: f32) -> bool {
    f64::from(value) > (f64::from(lower) + f64::from(upper)) / 2.0
}

/// The distinct values, if they are no more than fit.
fn distinct(sorted: &[f32]) -> Option<Vec<f32>> {
    let mut out: Vec<f32> = Vec::new();
    let mut rest = sorted;
    while let Some(&value) = rest.first() {
        if out.len() == ENTRIES {
            return None;
        }
        out.push(value);
        rest = &rest[rest.partition_point(|&v| v <= value)..];
    }
    Some(out)
}

/// Half of the entries so that each stands for as many values, which no outlier can spoil; half by
/// the cube root of density, which is best for the squared error of a smooth distribution.
fn first_entries(sorted: &[f32]) -> Vec<f32> {
    let mut out: Vec<f32> =
        (0..ENTRIES / 2).map(|i| sorted[(2 * i + 1) * sorted.len() / ENTRIES]).collect();
    let (min, max) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
    let edge = |cell: usize| min + (max - min) * cell as f64 / CELLS as f64;
    let mut weights = Vec::with_capacity(CELLS);
    let mut start = 0;
    for cell in 0..CELLS {
        let end = if cell + 1 == CELLS {
            sorted.len()
        } else {
            let limit = edge(cell + 1);
            sorted.partition_point(|&v| f64::from(v) < limit)
        };
        weights.push(((end - start) as f64).cbrt());
        start = end;
    }
    let total: f64 = weights.iter().sum();
    let places = ENTRIES / 2;
    let (mut cell, mut before) = (0, 0.0);
    for i in 0..places {
        let due = total * (i as f64 + 0.5) / places as f64;
        while cell + 1 < CELLS && before + weights[cell] < due {
            before += weights[cell];
            cell += 1;
        }
        let within = if weights[cell] > 0.0 { (due - before) / weights[cell] } else { 0.5 };
        out.push((edge(cell) + (edge(cell + 1) - edge(cell)) * within.clamp(0.0, 1.0)) as f32);
    }
    out.sort_unstable_by(f32::total_cmp);
    out.dedup();
    out
}

/// The mean of what each entry stands for; entries that stand for nothing go.
fn means(sorted: &[f32], sums: &[f64], entries: &[f32]) -> Vec<f32> {
    let ends = Codebook { values: entries.to_vec() }.ends(sorted);
    let mut out = Vec::with_capacity(entries.len());
    let mut start = 0;
    for end in ends {
        if end > start {
            // Rounding of the sums may lead out of the share; a value beyond it would swap order.
            let mean = (sums[end] - sums[start]) / (end - start) as f64;
            out.push((mean as f32).clamp(sorted[start], sorted[end - 1]));
        }
        start = end.max(start);
    }
    // Rounded to f32, neighbours may have become one.
    out.dedup();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hard_values(n: usize) -> Vec<f32> {
        (0..n as u64)
            .map(|i| {
                let x = (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / 16_777_216.0;
                (x - 0.5).powi(3) * 20.0
            })
            .collect()
    }

    #[test]
    fn few_values_are_kept_exactly() {
        for n in [1, 2, 255, 256] {
            let values: Vec<f32> = hard_values(n);
            let book = Codebook::fit(values.iter().chain(&values).copied().collect());
            for &v in &values {
                assert_eq!(book.values[usize::from(book.code(v))], v);
            }
            assert_eq!(book.padded().len(), 256);
        }
        assert_eq!(Codebook::fit(vec![-0.0, 0.0]).values, [0.0]);
    }

    #[test]
    fn many_values_get_near_ones_and_settle() {
        for outlier in [0.0, 1e6, f32::MAX] {
            let mut values = hard_values(20_000);
            values.push(outlier);
            let book = Codebook::fit(values.clone());
            assert!(book.values.is_sorted_by(|a, b| a < b) && book.values.len() > 200);
            let read: Vec<f32> =
                values.iter().map(|&v| book.values[usize::from(book.code(v))]).collect();
            let nearest = |v: f32| {
                book.values
                    .iter()
                    .map(|e| (f64::from(*e) - f64::from(v)).abs())
                    .fold(1e300, f64::min)
            };
            for (&v, &r) in values.iter().zip(&read).step_by(37) {
                assert_eq!((f64::from(v) - f64::from(r)).abs(), nearest(v));
            }
            let squared: f64 = values[..20_000]
                .iter()
                .zip(&read)
                .map(|(&v, &r)| (f64::from(v) - f64::from(r)).powi(2))
                .sum();
            // Equal steps over the range would give 5/255/√12 = 0.0057.
            assert!((squared / 20_000.0).sqrt() < 0.0035, "{}", (squared / 20_000.0).sqrt());
            assert_eq!(Codebook::fit(read), book, "all entries are used");
        }
    }
}

//! The 256 values that stand for all values of a kind.

use rayon::prelude::*;

/// Most values a byte can tell apart.
const ENTRIES: usize = 256;
/// Rounds of moving entries to the mean of what they stand for, which only smooths the edges of
/// the groups that entries were placed by.
const ROUNDS: usize = 6;
/// Groups of values of each kind, see [`first_entries`].
const GROUPS: usize = 1024;

/// Ascending, distinct values; at least one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Codebook {
    values: Vec<f32>,
}

impl Codebook {
    /// The values that stand for the given ones with a small squared error; the given ones
    /// themselves if there are no more than 256. Each value stands for at least one.
    ///
    /// Nothing is left to chance. Values must be finite, and at least one.
    pub(super) fn fit(mut values: Vec<f32>) -> Self {
        // The sum turns −0 into 0.
        values.par_iter_mut().for_each(|v| *v += 0.0);
        values.par_sort_unstable_by(f32::total_cmp);
        if let Some(few) = distinct(&values) {
            return Self { values: few };
        }
        let mut entries = first_entries(&values);
        for _ in 0..ROUNDS {
            let moved = means(&values, &entries);
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

/// Sums over sorted values, from any place to any other.
///
/// They start at the median, so that a huge value spoils only the sums it is part of.
struct Sums {
    /// Number, sum and sum of squares of the values before each place, negative before the median.
    /// Places are ends of groups of equal or near values.
    places: Vec<usize>,
    sum: Vec<f64>,
    squares: Vec<f64>,
}

impl Sums {
    fn new(sorted: &[f32], places: Vec<usize>) -> Self {
        let median = f64::from(sorted[sorted.len() / 2]);
        let middle = places.partition_point(|&place| place < sorted.len() / 2);
        let group = |i: usize| {
            let values = &sorted[places[i]..places[i + 1]];
            values.iter().fold((0.0, 0.0), |(sum, squares), &v| {
                let v = f64::from(v) - median;
                (sum + v, squares + v * v)
            })
        };
        let groups: Vec<(f64, f64)> = (0..places.len() - 1).into_par_iter().map(group).collect();
        let (mut sum, mut squares) = (vec![0.0; places.len()], vec![0.0; places.len()]);
        for i in middle..groups.len() {
            (sum[i + 1], squares[i + 1]) = (sum[i] + groups[i].0, squares[i] + groups[i].1);
        }
        for i in (0..middle.min(groups.len())).rev() {
            (sum[i], squares[i]) = (sum[i + 1] - groups[i].0, squares[i + 1] - groups[i].1);
        }
        Self { places, sum, squares }
    }

    /// Number of groups.
    fn len(&self) -> usize {
        self.places.len() - 1
    }

    /// Squared error of one entry, at their mean, for the groups from `a` to before `b`.
    fn error(&self, a: usize, b: usize) -> f64 {
        let sum = self.sum[b] - self.sum[a];
        let count = (self.places[b] - self.places[a]) as f64;
        (self.squares[b] - self.squares[a] - sum * sum / count).max(0.0)
    }
}

/// The entries with the least squared error when values stay together by groups: as many groups of
/// equal numbers of values as of equal width, which together are fine where many values are and
/// where errors are large.
fn first_entries(sorted: &[f32]) -> Vec<f32> {
    let (min, max) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
    let mut places: Vec<usize> = (0..=GROUPS).map(|i| sorted.len() * i / GROUPS).collect();
    places.extend((1..GROUPS).map(|i| {
        let limit = min + (max - min) * i as f64 / GROUPS as f64;
        sorted.partition_point(|&v| f64::from(v) < limit)
    }));
    places.sort_unstable();
    places.dedup();
    let sums = Sums::new(sorted, places);
    let ends = best_partition(&sums);
    let starts = std::iter::once(0).chain(ends.iter().copied());
    let median = f64::from(sorted[sorted.len() / 2]);
    let mut out: Vec<f32> = starts
        .zip(&ends)
        .map(|(a, &b)| {
            let count = (sums.places[b] - sums.places[a]) as f64;
            (median + (sums.sum[b] - sums.sum[a]) / count) as f32
        })
        .collect();
    out.sort_unstable_by(f32::total_cmp);
    out.dedup();
    out
}

/// Where the shares of 256 entries end, in groups: dynamic programming over the number of entries.
///
/// The best last share of longer sequences starts no earlier, so that halving the range of places
/// halves the range of starts, too.
fn best_partition(sums: &Sums) -> Vec<usize> {
    let groups = sums.len();
    let entries = ENTRIES.min(groups);
    let mut least: Vec<f64> =
        (0..=groups).map(|b| if b == 0 { f64::INFINITY } else { sums.error(0, b) }).collect();
    let mut starts = vec![0u16; entries * (groups + 1)];
    for entry in 1..entries {
        let mut next = vec![f64::INFINITY; groups + 1];
        let starts = &mut starts[entry * (groups + 1)..(entry + 1) * (groups + 1)];
        // Ranges of ends with the range of starts that can be best for them.
        let mut open = vec![(entry + 1, groups, entry, groups - 1)];
        while let Some((first, last, from, to)) = open.pop() {
            if first > last {
                continue;
            }
            let end = usize::midpoint(first, last);
            let mut best = (f64::INFINITY, from);
            for start in from..=to.min(end - 1) {
                let error = least[start] + sums.error(start, end);
                if error < best.0 {
                    best = (error, start);
                }
            }
            (next[end], starts[end]) = (best.0, best.1 as u16);
            open.push((first, end - 1, from, best.1));
            open.push((end + 1, last, best.1, to));
        }
        least = next;
    }
    let mut ends = vec![groups];
    for entry in (1..entries).rev() {
        let end = ends[ends.len() - 1];
        ends.push(usize::from(starts[entry * (groups + 1) + end]));
    }
    ends.reverse();
    ends
}

/// The mean of what each entry stands for; entries that stand for nothing go.
fn means(sorted: &[f32], entries: &[f32]) -> Vec<f32> {
    let ends = Codebook { values: entries.to_vec() }.ends(sorted);
    let shares: Vec<(usize, usize)> = std::iter::once(0)
        .chain(ends.iter().copied())
        .zip(ends.iter().copied())
        .filter(|(start, end)| start < end)
        .collect();
    let mean = |&(start, end): &(usize, usize)| {
        let sum: f64 = sorted[start..end].iter().map(|&v| f64::from(v)).sum();
        // Rounding may lead out of the share; a value beyond it would swap order.
        ((sum / (end - start) as f64) as f32).clamp(sorted[start], sorted[end - 1])
    };
    let mut out: Vec<f32> = shares.par_iter().map(mean).collect();
    // Rounded to f32, neighbors may have become one.
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
            // The least possible for this density is 0.00474; equal steps would give 0.0057.
            let error = (squared / 20_000.0).sqrt();
            assert!(error < 0.0049, "{error} with {outlier}");
            assert_eq!(Codebook::fit(read), book, "all entries are used");
        }
    }
}

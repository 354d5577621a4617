//! Stable sorting of 64-bit codes.

use rayon::prelude::*;

/// Widest digit: its counters, and one cache line for each of its buckets, fit into a core's cache.
const DIGIT_BITS: u32 = 11;
/// Below this a comparison sort is faster than counting.
const SMALL: usize = 2048;
/// Rows that are worth a thread of their own.
const ROWS_PER_PART: usize = 1 << 15;

/// Rows in ascending order of their code; equal codes keep their order. `[N]`
pub fn argsort(codes: &[u64]) -> Vec<u32> {
    let mut order = vec![0; codes.len()];
    argsort_into(codes, &mut order);
    order
}

/// Writes the sorting permutation into `order` (same length, at most 2³² − 1 rows).
///
/// Radix sort over the bits in which the codes differ, lowest digit first, so narrow codes take few
/// passes. Code and row share one 64-bit entry; of codes too wide for that the highest bits are
/// sorted by, and the few rows that those leave in the wrong order are put right afterwards.
pub fn argsort_into(codes: &[u64], order: &mut [u32]) {
    assert!(codes.len() == order.len(), "argsort: row count");
    let sorted = Sorted::of(codes);
    let mask = sorted.row_mask;
    order.par_iter_mut().zip(&sorted.entries).for_each(|(o, e)| *o = (e & mask) as u32);
    sorted.mend(codes, order);
}

/// Codes in ascending order and the row of each; equal codes keep their order.
pub(crate) fn sort_with_rows(codes: &[u64]) -> (Vec<u64>, Vec<u32>) {
    let sorted = Sorted::of(codes);
    let (mask, bits, low) = (sorted.row_mask, sorted.row_bits, sorted.low);
    if sorted.dropped_bits == 0 {
        let apart = |e: &u64| ((e >> bits) + low, (e & mask) as u32);
        return sorted.entries.par_iter().map(apart).unzip();
    }
    let mut rows: Vec<u32> = sorted.entries.par_iter().map(|e| (e & mask) as u32).collect();
    sorted.mend(codes, &mut rows);
    (rows.par_iter().map(|&row| codes[row as usize]).collect(), rows)
}

/// Rows in ascending order of the highest bits of their codes.
struct Sorted {
    /// Code, less the smallest, without its lowest bits, above the row.
    entries: Vec<u64>,
    row_bits: u32,
    row_mask: u64,
    /// The smallest code.
    low: u64,
    /// Bits of the codes that did not fit.
    dropped_bits: u32,
}

impl Sorted {
    fn of(codes: &[u64]) -> Self {
        let n = codes.len();
        assert!(u32::try_from(n).is_ok(), "more rows than 32 bits can number");
        let range = codes
            .par_iter()
            .with_min_len(ROWS_PER_PART)
            .map(|&c| (c, c))
            .reduce(|| (u64::MAX, 0), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let low = if n == 0 { 0 } else { range.0 };
        let code_bits = 64 - range.1.saturating_sub(low).leading_zeros();
        let row_bits = usize::BITS - n.saturating_sub(1).leading_zeros();
        let dropped_bits = (code_bits + row_bits).saturating_sub(64);
        let entries = codes
            .par_iter()
            .with_min_len(ROWS_PER_PART)
            .enumerate()
            .map(|(i, &c)| ((c - low) >> dropped_bits) << row_bits | i as u64)
            .collect();
        let entries = sort_entries(entries, row_bits, code_bits - dropped_bits);
        Self { entries, row_bits, row_mask: (1 << row_bits) - 1, low, dropped_bits }
    }

    /// Puts rows in order whose codes differ in the dropped bits only.
    fn mend(&self, codes: &[u64], rows: &mut [u32]) {
        if self.dropped_bits == 0 {
            return;
        }
        let code = |row: u32| codes[row as usize];
        let falls = |pair: &[u32]| code(pair[0]) > code(pair[1]);
        if !rows.par_windows(2).with_min_len(ROWS_PER_PART).any(falls) {
            return;
        }
        let high = |row: u32| (code(row) - self.low) >> self.dropped_bits;
        for run in rows.chunk_by_mut(|&a, &b| high(a) == high(b)) {
            if run.windows(2).any(falls) {
                // Stable: rows of equal codes are ascending already.
                run.sort_by_key(|&row| code(row));
            }
        }
    }
}

/// Sorts by the `width` bits from `first` on; entries begin in the order of their lower bits.
fn sort_entries(mut from: Vec<u64>, first: u32, width: u32) -> Vec<u64> {
    if from.len() < SMALL {
        from.sort_unstable();
        return from;
    }
    if width == 0 {
        return from;
    }
    let passes = width.div_ceil(DIGIT_BITS);
    let digit_bits = width.div_ceil(passes);
    let mut to = vec![0; from.len()];
    for pass in 0..passes {
        if scatter(&from, &mut to, first + pass * digit_bits, digit_bits) {
            std::mem::swap(&mut from, &mut to);
        }
    }
    from
}

/// Entries that several threads write, no two of them the same one.
struct Target(*mut u64);
// SAFETY: threads write disjoint entries, see `scatter`.
unsafe impl Sync for Target {}

/// One counting pass into `to`; `false` if all entries have the same digit and nothing was done.
///
/// Each part of the entries is counted and moved by one thread. Parts of a bucket follow each other
/// in the order of the entries, so the result does not depend on the number of parts.
fn scatter(from: &[u64], to: &mut [u64], shift: u32, digit_bits: u32) -> bool {
    let buckets = 1usize << digit_bits;
    let digit = |e: u64| (e >> shift) as usize & (buckets - 1);
    let parts = rayon::current_num_threads().min(from.len() / ROWS_PER_PART).max(1);
    let part_rows = from.len().div_ceil(parts);
    let mut starts: Vec<Vec<u32>> = from
        .par_chunks(part_rows)
        .map(|part| {
            let mut counts = vec![0u32; buckets];
            part.iter().for_each(|&e| counts[digit(e)] += 1);
            counts
        })
        .collect();
    let mut sum = 0u32;
    for bucket in 0..buckets {
        let before = sum;
        for counts in &mut starts {
            sum += std::mem::replace(&mut counts[bucket], sum);
        }
        if (sum - before) as usize == from.len() {
            return false;
        }
    }
    debug_assert_eq!(from.len(), to.len());
    let target = Target(to.as_mut_ptr());
    let target = &target;
    from.par_chunks(part_rows).zip(&mut starts).for_each(|(part, next)| {
        for &entry in part {
            let at = &mut next[digit(entry)];
            // SAFETY: `starts` gives every entry of `from` a place of its own below `from.len()`,
            // which is the length of `to`: places were counted from the same digits.
            unsafe { target.0.add(*at as usize).write(entry) };
            *at += 1;
        }
    });
    true
}

/// The inverse of a permutation: `inverse[order[i]] = i`.
///
/// # Panics
/// If a row is out of range.
pub fn invert(order: &[u32]) -> Vec<u32> {
    let mut inverse = vec![0; order.len()];
    for (i, &o) in order.iter().enumerate() {
        inverse[o as usize] = i as u32;
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn sorts_stably_at_all_sizes_and_widths() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        for n in [0, 1, 2, 100, SMALL - 1, SMALL, 3 * ROWS_PER_PART + 1] {
            for bits in [0, 1, 9, 11, 12, 33, 64] {
                let codes: Vec<u64> = (0..n)
                    .map(|_| if bits == 0 { 7 } else { rng.random::<u64>() >> (64 - bits) })
                    .collect();
                let mut want: Vec<u32> = (0..n as u32).collect();
                want.sort_by_key(|&i| codes[i as usize]);
                let order = argsort(&codes);
                assert_eq!(order, want);
                let (sorted, rows) = sort_with_rows(&codes);
                assert_eq!(rows, want);
                assert!(sorted.iter().zip(&rows).all(|(c, &r)| *c == codes[r as usize]));
                let inverse = invert(&order);
                assert!(order.iter().enumerate().all(|(i, &o)| inverse[o as usize] == i as u32));
            }
        }
    }

    #[test]
    fn codes_that_differ_in_dropped_bits_only_are_in_order_too() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let n = 2 * SMALL;
        // Both ends of the range occur, so twelve bits do not fit beside the row; among the codes of a
        // group only the lowest three differ.
        let mut codes: Vec<u64> =
            (0..n).map(|_| rng.random_range(0..50u64) << 50 | rng.random_range(0..8u64)).collect();
        (codes[7], codes[9]) = (0, u64::MAX);
        let mut want: Vec<u32> = (0..n as u32).collect();
        want.sort_by_key(|&i| codes[i as usize]);
        assert_eq!(argsort(&codes), want);
        let (sorted, rows) = sort_with_rows(&codes);
        assert!(rows == want && sorted.is_sorted());
    }

    #[test]
    fn any_number_of_threads_gives_the_same_order() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        // Few distinct codes, so stability shows.
        let codes: Vec<u64> =
            (0..6 * ROWS_PER_PART).map(|_| rng.random_range(0..5000u64) << 40).collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| argsort(&codes))
        };
        let one = run(1);
        assert!([2, 3, 5].into_iter().all(|threads| run(threads) == one));
    }
}

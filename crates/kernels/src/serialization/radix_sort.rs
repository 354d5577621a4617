//! Stable sorting of 64-bit codes.
//!
//! Code and row share one 64-bit entry. One pass over memory splits the entries by their highest
//! digit; the buckets are then small enough to be sorted inside a core's cache, each by itself.

use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Widest digit: its counters, and one cache line for each of its buckets, fit into a core's cache.
const DIGIT_BITS: u32 = 11;
/// Entries of a bucket that the first split aims at: counting is cheap beside moving them, and they
/// stay in the first-level cache.
const BUCKET_BITS: u32 = 9;
/// Below this a comparison sort is faster than counting.
const SMALL: usize = 128;
/// Buckets above this are split again, by all threads; below, entries and their copy fit into the
/// second-level cache.
const LARGE: usize = 1 << 15;
/// Rows that are worth a thread of their own.
const ROWS_PER_PART: usize = 1 << 14;

/// Rows in ascending order of their code; equal codes keep their order. `[N]`
pub fn argsort(codes: &[u64]) -> Vec<u32> {
    let sorted = Sorted::of(codes);
    let mask = sorted.row_mask;
    sorted.entries.par_iter().with_min_len(ROWS_PER_PART).map(|e| (e & mask) as u32).collect()
}

/// Writes the sorting permutation into `order` (same length, at most 2³² − 1 rows).
///
/// Entries hold the bits in which the codes differ, so narrow codes are quick to sort; of codes too
/// wide to stand beside a row the highest bits are sorted by, and the few rows that those leave in
/// the wrong order are put right afterwards.
pub fn argsort_into(codes: &[u64], order: &mut [u32]) {
    assert!(codes.len() == order.len(), "argsort: row count");
    let sorted = Sorted::of(codes);
    let mask = sorted.row_mask;
    order
        .par_iter_mut()
        .with_min_len(ROWS_PER_PART)
        .zip(&sorted.entries)
        .for_each(|(o, e)| *o = (e & mask) as u32);
}

/// The sorting permutation and its inverse, both counted from `first` on. `spare` is memory to work
/// in: touching fresh memory takes as long as a pass of the sort.
pub(crate) fn order_and_inverse(
    codes: &[u64],
    first: u32,
    order: &mut [u32],
    inverse: &mut [u32],
    spare: &mut Vec<u64>,
) {
    let sorted = Sorted::within(codes, std::mem::take(spare));
    let mask = sorted.row_mask;
    let inverse = shared(inverse);
    let entries = sorted.entries.par_chunks(ROWS_PER_PART);
    order.par_chunks_mut(ROWS_PER_PART).zip(entries).enumerate().for_each(
        |(part, (order, entries))| {
            for (i, (o, entry)) in order.iter_mut().zip(entries).enumerate() {
                let row = (entry & mask) as u32;
                *o = first + row;
                let position = (part * ROWS_PER_PART + i) as u32;
                inverse[row as usize].store(first + position, Ordering::Relaxed);
            }
        },
    );
    *spare = sorted.entries;
}

/// Rows in ascending order of their codes.
pub(crate) struct Sorted {
    /// Code, less the smallest, above the row. Of codes too wide, the highest bits only; the order
    /// is that of the whole codes nevertheless.
    pub(crate) entries: Vec<u64>,
    /// Bits of an entry that hold the row.
    pub(crate) row_bits: u32,
    pub(crate) row_mask: u64,
    /// The smallest code.
    low: u64,
    /// Bits of the codes that did not fit.
    dropped_bits: u32,
}

impl Sorted {
    pub(crate) fn of(codes: &[u64]) -> Self {
        Self::within(codes, Vec::new())
    }

    /// As [`Sorted::of`], with the entries in memory given.
    fn within(codes: &[u64], mut entries: Vec<u64>) -> Self {
        let n = codes.len();
        assert!(u32::try_from(n).is_ok(), "more rows than 32 bits can number");
        let (low, high, is_sorted) = codes
            .par_chunks(ROWS_PER_PART)
            .enumerate()
            .map(|(part, codes_of)| {
                let (low, high) =
                    codes_of.iter().fold((u64::MAX, 0), |r, &c| (r.0.min(c), r.1.max(c)));
                let before = part * ROWS_PER_PART;
                let joins = before == 0 || codes[before - 1] <= codes_of[0];
                (low, high, joins && codes_of.is_sorted())
            })
            .reduce(|| (u64::MAX, 0, true), |a, b| (a.0.min(b.0), a.1.max(b.1), a.2 && b.2));
        let low = if n == 0 { 0 } else { low };
        let code_bits = 64 - high.saturating_sub(low).leading_zeros();
        let row_bits = usize::BITS - n.saturating_sub(1).leading_zeros();
        let dropped_bits = (code_bits + row_bits).saturating_sub(64);
        let entry = |row: usize, code: u64| ((code - low) >> dropped_bits) << row_bits | row as u64;
        if is_sorted {
            // As after sampling along a curve, and after pooling along the first order.
            let rows = codes.par_iter().with_min_len(ROWS_PER_PART).enumerate();
            rows.map(|(row, &code)| entry(row, code)).collect_into_vec(&mut entries);
        } else {
            sort_entries(codes, entry, row_bits, code_bits - dropped_bits, &mut entries);
        }
        let mut sorted =
            Self { entries, row_bits, row_mask: (1 << row_bits) - 1, low, dropped_bits };
        sorted.order_dropped_bits(codes);
        sorted
    }

    /// Code of an entry.
    #[inline(always)]
    pub(crate) fn code(&self, codes: &[u64], entry: u64) -> u64 {
        if self.dropped_bits == 0 {
            (entry >> self.row_bits) + self.low
        } else {
            codes[(entry & self.row_mask) as usize]
        }
    }

    /// Whether two entries have different codes.
    #[inline(always)]
    pub(crate) fn differ(&self, codes: &[u64], a: u64, b: u64) -> bool {
        let rows = |e: u64| (e & self.row_mask) as usize;
        // The second question only matters, and is only expensive, where bits were dropped.
        (a ^ b) & !self.row_mask != 0 || self.dropped_bits != 0 && codes[rows(a)] != codes[rows(b)]
    }

    /// Puts rows in order whose codes differ in the dropped bits only.
    fn order_dropped_bits(&mut self, codes: &[u64]) {
        if self.dropped_bits == 0 {
            return;
        }
        let (mask, bits) = (self.row_mask, self.row_bits);
        let code = |entry: u64| codes[(entry & mask) as usize];
        let together = |a: u64, b: u64| (a ^ b) >> bits == 0;
        let falls = |w: &[u64]| together(w[0], w[1]) && code(w[0]) > code(w[1]);
        if !self.entries.par_windows(2).with_min_len(ROWS_PER_PART).any(falls) {
            return;
        }
        for run in self.entries.chunk_by_mut(|&a, &b| together(a, b)) {
            if run.windows(2).any(falls) {
                // Stable: rows of equal codes are ascending already.
                run.sort_by_key(|&entry| code(entry));
            }
        }
    }
}

/// Sorts `entry(row, code)` by the `width` bits from `row_bits` on; equal ones keep their order.
fn sort_entries(
    codes: &[u64],
    entry: impl Fn(usize, u64) -> u64 + Sync,
    row_bits: u32,
    width: u32,
    entries: &mut Vec<u64>,
) {
    // The bits below hold the row, so sorting whole entries is stable whatever the method.
    let aim = usize::BITS - (codes.len() >> BUCKET_BITS).leading_zeros();
    let digit_bits = aim.min(DIGIT_BITS).min(width);
    let starts = split(codes, &entry, entries, row_bits + width - digit_bits, digit_bits);
    sort_buckets(entries, &starts, row_bits);
}

/// Sorts each bucket by itself.
fn sort_buckets(entries: &mut [u64], starts: &[u32], row_bits: u32) {
    let mut buckets = Vec::with_capacity(starts.len());
    let mut rest = entries;
    for span in starts.windows(2) {
        let (bucket, after) = rest.split_at_mut((span[1] - span[0]) as usize);
        rest = after;
        if bucket.len() > 1 {
            buckets.push(bucket);
        }
    }
    buckets
        .into_par_iter()
        .for_each_init(Vec::new, |spare, bucket| sort_bucket(bucket, spare, row_bits));
}

/// Sorts one bucket; `spare` is memory to work in.
fn sort_bucket(bucket: &mut [u64], spare: &mut Vec<u64>, row_bits: u32) {
    let n = bucket.len();
    if n < SMALL {
        bucket.sort_unstable();
        return;
    }
    let (all, any) = bucket.iter().fold((u64::MAX, 0), |(all, any), &e| (all & e, any | e));
    // The bits in which codes differ; the others need no sorting by.
    let differing = (all ^ any) >> row_bits;
    if differing == 0 {
        return;
    }
    let width = 64 - differing.leading_zeros();
    if n > LARGE {
        let digit_bits = width.min(DIGIT_BITS);
        let mut moved = Vec::new();
        let shift = row_bits + width - digit_bits;
        let starts = split(bucket, &|_, e| e, &mut moved, shift, digit_bits);
        bucket.copy_from_slice(&moved);
        drop(moved);
        sort_buckets(bucket, &starts, row_bits);
        return;
    }
    let lowest = differing.trailing_zeros();
    sort_in_cache(bucket, spare, row_bits + lowest, width - lowest);
}

/// Counting sort by the `width` bits from `first` on, lowest digit first.
fn sort_in_cache(bucket: &mut [u64], spare: &mut Vec<u64>, first: u32, width: u32) {
    let n = bucket.len();
    // As many counters as half the entries at most: clearing and adding them up costs time too.
    let widest = (usize::BITS - n.leading_zeros() - 2).min(DIGIT_BITS);
    let passes = width.div_ceil(widest);
    let digit_bits = width.div_ceil(passes);
    let buckets = 1usize << digit_bits;
    if spare.len() < n {
        spare.resize(n, 0);
    }
    let mut counts = [0u32; 1 << DIGIT_BITS];
    let counts = &mut counts[..buckets];
    let (mut from, mut to) = (&mut *bucket, &mut spare[..n]);
    for pass in 0..passes {
        let shift = first + pass * digit_bits;
        let digit = |e: u64| (e >> shift) as usize & (buckets - 1);
        counts.fill(0);
        from.iter().for_each(|&e| counts[digit(e)] += 1);
        let mut sum = 0;
        for count in counts.iter_mut() {
            sum += std::mem::replace(count, sum);
        }
        for &entry in from.iter() {
            let at = &mut counts[digit(entry)];
            to[*at as usize] = entry;
            *at += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
    if passes % 2 == 1 {
        // The result lies in the spare memory.
        to.copy_from_slice(from);
    }
}

/// Entries that several threads write, no two of them the same one.
struct Target(*mut u64);
// SAFETY: threads write disjoint entries, see `split`.
unsafe impl Sync for Target {}

/// Moves `entry(i, from[i])` into the bucket of its digit and returns where the buckets start.
///
/// Each part of the entries is counted and moved by one thread. Parts of a bucket follow each other
/// in the order of the entries, so the result does not depend on the number of parts.
fn split(
    from: &[u64],
    entry: &(impl Fn(usize, u64) -> u64 + Sync),
    to: &mut Vec<u64>,
    shift: u32,
    digit_bits: u32,
) -> Vec<u32> {
    let n = from.len();
    let buckets = 1usize << digit_bits;
    // A digit of no bits may come with a shift by all 64.
    let shift = shift.min(63);
    let digit = |e: u64| (e >> shift) as usize & (buckets - 1);
    let parts = rayon::current_num_threads().min(n / ROWS_PER_PART).max(1);
    let part_rows = n.div_ceil(parts).max(1);
    let mut next: Vec<Vec<u32>> = from
        .par_chunks(part_rows)
        .enumerate()
        .map(|(part, codes)| {
            let mut counts = vec![0u32; buckets];
            for (i, &code) in codes.iter().enumerate() {
                counts[digit(entry(part * part_rows + i, code))] += 1;
            }
            counts
        })
        .collect();
    let mut starts = Vec::with_capacity(buckets + 1);
    let mut sum = 0u32;
    for bucket in 0..buckets {
        starts.push(sum);
        for counts in &mut next {
            sum += std::mem::replace(&mut counts[bucket], sum);
        }
    }
    starts.push(sum);
    to.clear();
    to.reserve_exact(n);
    let target = Target(to.as_mut_ptr());
    let target = &target;
    from.par_chunks(part_rows).zip(&mut next).enumerate().for_each(|(part, (codes, next))| {
        for (i, &code) in codes.iter().enumerate() {
            let entry = entry(part * part_rows + i, code);
            let at = &mut next[digit(entry)];
            // SAFETY: the counts give every entry a place of its own below `n`, for which there is
            // room: places were counted from the same digits.
            unsafe { target.0.add(*at as usize).write(entry) };
            *at += 1;
        }
    });
    // SAFETY: the loops above wrote all `n` places.
    unsafe { to.set_len(n) };
    starts
}

/// The inverse of a permutation: `inverse[order[i]] = i`. Anything else than a permutation gives
/// arbitrary values.
///
/// # Panics
/// If a row is out of range.
pub fn invert(order: &[u32]) -> Vec<u32> {
    let mut inverse = vec![0; order.len()];
    let shared = shared(&mut inverse);
    order.par_chunks(ROWS_PER_PART).enumerate().for_each(|(part, rows)| {
        for (i, &row) in rows.iter().enumerate() {
            let position = part * ROWS_PER_PART + i;
            shared[row as usize].store(position as u32, Ordering::Relaxed);
        }
    });
    inverse
}

/// The same numbers, to be written by several threads at once.
pub(crate) fn shared(values: &mut [u32]) -> &[AtomicU32] {
    // SAFETY: an atomic has the size, alignment and bit patterns of its number, and the exclusive
    // borrow lasts as long as the shared one.
    unsafe { &*(std::ptr::from_mut(values) as *const [AtomicU32]) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn sorts_stably_at_all_sizes_and_widths() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        for n in [0, 1, 2, 100, SMALL - 1, SMALL, 3000, 3 * LARGE + 1] {
            for bits in [0, 1, 9, 11, 12, 33, 64] {
                let codes: Vec<u64> = (0..n)
                    .map(|_| if bits == 0 { 7 } else { rng.random::<u64>() >> (64 - bits) })
                    .collect();
                let mut want: Vec<u32> = (0..n as u32).collect();
                want.sort_by_key(|&i| codes[i as usize]);
                let order = argsort(&codes);
                assert_eq!(order, want);
                let sorted = Sorted::of(&codes);
                for &e in &sorted.entries {
                    let row = (e & sorted.row_mask) as usize;
                    assert_eq!(sorted.code(&codes, e), codes[row]);
                }
                let inverse = invert(&order);
                assert!(order.iter().enumerate().all(|(i, &o)| inverse[o as usize] == i as u32));
            }
        }
    }

    #[test]
    fn codes_that_differ_in_dropped_bits_only_are_in_order_too() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let n = 4096;
        // Both ends of the range occur, so twelve bits do not fit beside the row; among the codes of a
        // group only the lowest three differ.
        let mut codes: Vec<u64> =
            (0..n).map(|_| rng.random_range(0..50u64) << 50 | rng.random_range(0..8u64)).collect();
        (codes[7], codes[9]) = (0, u64::MAX);
        let mut want: Vec<u32> = (0..n as u32).collect();
        want.sort_by_key(|&i| codes[i as usize]);
        assert_eq!(argsort(&codes), want);
    }

    /// One far outlier leaves all other codes in one bucket, which has to be split again and again.
    #[test]
    fn crowded_buckets_are_split_again() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let n = 3 * LARGE;
        for few in [3, 5, 30] {
            let mut codes: Vec<u64> = (0..n)
                .map(|i| 1 << 30 | rng.random::<u64>() >> (64 - few) << (i % 2 * 8))
                .collect();
            (codes[7], codes[9], codes[11]) = (1 << 62, 0, 1 << 45);
            let mut want: Vec<u32> = (0..n as u32).collect();
            want.sort_by_key(|&i| codes[i as usize]);
            assert_eq!(argsort(&codes), want);
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_order() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        // Few distinct codes, so stability shows.
        let codes: Vec<u64> =
            (0..6 * ROWS_PER_PART).map(|_| rng.random_range(0..5000u64) << 40).collect();
        let run = |threads| crate::tests::on_threads(threads, || argsort(&codes));
        let one = run(1);
        assert!([2, 3, 5].into_iter().all(|threads| run(threads) == one));
    }
}

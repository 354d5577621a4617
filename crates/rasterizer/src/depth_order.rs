//! Front-to-back order by a radix sort that keeps equal depths in place.

use rayon::prelude::*;

/// Most bits of a digit: its counters stay in the first-level cache.
const DIGIT_BITS: u32 = 11;
/// Fewest values per task.
const MIN_CHUNK: usize = 8192;
/// Most tasks: their counters are summed one after the other.
const MAX_CHUNKS: usize = 32;

/// Memory of [`depth_order`].
#[derive(Debug, Default)]
pub(crate) struct OrderMemory {
    keys: [Vec<u64>; 2],
    counts: Vec<Vec<u32>>,
    order: Vec<u32>,
}

/// Rows by ascending depth, equal ones by ascending row. Depths are positive and finite.
pub(crate) fn depth_order<'m>(depth: &[f32], memory: &'m mut OrderMemory) -> &'m [u32] {
    let OrderMemory { keys: [from, to], counts, order } = memory;
    // Positive floats sort as their bits do.
    let key = |(row, d): (usize, &f32)| u64::from(d.to_bits()) << 32 | row as u64;
    depth.par_iter().with_min_len(MIN_CHUNK).enumerate().map(key).collect_into_vec(from);
    // Where no bit differs from the first, none has to be sorted by.
    let Some(first) = depth.first().map(|d| d.to_bits()) else { return &[] };
    let differs = |d: &f32| d.to_bits() ^ first;
    let differing =
        depth.par_iter().with_min_len(MIN_CHUNK).map(differs).reduce(|| 0, |a, b| a | b);
    // Above the highest bit that differs all keys are the same.
    let used = 32 - differing.leading_zeros();
    let passes = used.div_ceil(DIGIT_BITS);
    to.resize(from.len(), 0);
    for pass in 0..passes {
        let (begin, end) = (used * pass / passes, used * (pass + 1) / passes);
        scatter(from, to, counts, 32 + begin, end - begin);
        std::mem::swap(from, to);
    }
    from.par_iter().with_min_len(MIN_CHUNK).map(|&key| key as u32).collect_into_vec(order);
    order
}

/// One stable pass by `bits` bits from bit `shift` on.
fn scatter(from: &[u64], to: &mut [u64], starts: &mut Vec<Vec<u32>>, shift: u32, bits: u32) {
    assert!(from.len() == to.len(), "places in `to` are counted in `from`");
    let chunk = from.len().div_ceil(MAX_CHUNKS).max(MIN_CHUNK);
    let digit = |key: u64| (key >> shift) as usize & ((1 << bits) - 1);
    starts.resize_with(from.len().div_ceil(chunk), Vec::new);
    from.par_chunks(chunk).zip(&mut *starts).for_each(|(keys, counts)| {
        counts.clear();
        counts.resize(1 << bits, 0);
        for &key in keys {
            counts[digit(key)] += 1;
        }
    });
    let mut next = 0;
    for d in 0..1 << bits {
        for counts in &mut *starts {
            next += std::mem::replace(&mut counts[d], next);
        }
    }
    let to = Shared(to.as_mut_ptr());
    from.par_chunks(chunk).zip(starts).for_each(|(keys, starts)| {
        let to = &to;
        for &key in keys {
            let at = &mut starts[digit(key)];
            // SAFETY: the counts of all chunks and digits add up to the length of `to`, and each
            // chunk has places of its own.
            unsafe { to.0.add(*at as usize).write(key) };
            *at += 1;
        }
    });
}

/// A pointer whose users keep apart.
pub(crate) struct Shared<T>(pub(crate) *mut T);

// SAFETY: every user writes places of its own, see there.
unsafe impl<T: Send> Sync for Shared<T> {}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(depth: &[f32], memory: &mut OrderMemory) {
        let mut expected: Vec<u32> = (0..depth.len() as u32).collect();
        expected.sort_by(|&a, &b| depth[a as usize].total_cmp(&depth[b as usize]));
        assert_eq!(depth_order(depth, memory), expected);
    }

    #[test]
    fn as_a_stable_comparison_sort() {
        // One memory for all: what an earlier, longer list left there does no harm.
        let memory = &mut OrderMemory::default();
        check(&[], memory);
        check(&[3.0], memory);
        check(&[2.0; 7], memory);
        check(&[3.0, 0.5, f32::MAX, 1e-30, 3.0, 0.5], memory);
        let mut state = 1u32;
        for n in [10, 100_000, 8193, 8192, 300_000, 5] {
            let mut next = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                // Few different values, so that many are equal.
                0.01 + (state >> 20) as f32
            };
            let depth: Vec<f32> = (0..n).map(|_| next()).collect();
            check(&depth, memory);
        }
    }
}

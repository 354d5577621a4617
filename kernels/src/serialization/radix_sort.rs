//! Stable sorting of 64-bit codes.

use rayon::prelude::*;

const DIGIT_BITS: u32 = 11;
const BUCKETS: usize = 1 << DIGIT_BITS;
/// Below this a comparison sort is faster than counting.
const SMALL: usize = 2048;

/// Rows in ascending order of their code; equal codes keep their order. `[N]`
pub fn argsort(codes: &[u64]) -> Vec<u32> {
    let mut order = vec![0; codes.len()];
    argsort_into(codes, &mut order);
    order
}

/// Writes the sorting permutation into `order` (same length, at most 2³² − 1 rows).
///
/// Least-significant-digit radix sort over the bits that occur, so narrow codes take few passes.
pub fn argsort_into(codes: &[u64], order: &mut [u32]) {
    let n = codes.len();
    assert!(n == order.len() && u32::try_from(n).is_ok(), "argsort: row count");
    if n < SMALL {
        for (i, o) in order.iter_mut().enumerate() {
            *o = i as u32;
        }
        order.sort_by_key(|&i| codes[i as usize]);
        return;
    }
    let bits = 64 - codes.par_iter().copied().reduce(|| 0, |a, b| a | b).leading_zeros();
    let mut from: Vec<(u64, u32)> =
        codes.par_iter().enumerate().map(|(i, &c)| (c, i as u32)).collect();
    let mut to = vec![(0u64, 0u32); n];
    let mut shift = 0;
    while shift < bits {
        pass(&from, &mut to, shift);
        std::mem::swap(&mut from, &mut to);
        shift += DIGIT_BITS;
    }
    order.par_iter_mut().zip(&from).for_each(|(o, &(_, i))| *o = i);
}

/// One counting pass; serial, since scattering is bound by memory and order must be stable.
fn pass(from: &[(u64, u32)], to: &mut [(u64, u32)], shift: u32) {
    let digit = |code: u64| (code >> shift) as usize & (BUCKETS - 1);
    let mut start = [0usize; BUCKETS];
    for &(code, _) in from {
        start[digit(code)] += 1;
    }
    if start.contains(&from.len()) {
        to.copy_from_slice(from);
        return;
    }
    let mut sum = 0;
    for s in &mut start {
        sum += std::mem::replace(s, sum);
    }
    for &pair in from {
        let at = &mut start[digit(pair.0)];
        to[*at] = pair;
        *at += 1;
    }
}

/// The inverse of a permutation: `inverse[order[i]] = i`.
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
        for n in [0, 1, 2, 100, SMALL - 1, SMALL, 50_000] {
            for bits in [0, 1, 9, 11, 12, 33, 64] {
                let codes: Vec<u64> = (0..n)
                    .map(|_| if bits == 0 { 7 } else { rng.random::<u64>() >> (64 - bits) })
                    .collect();
                let mut want: Vec<u32> = (0..n as u32).collect();
                want.sort_by_key(|&i| codes[i as usize]);
                let order = argsort(&codes);
                assert_eq!(order, want);
                let inverse = invert(&order);
                assert!(order.iter().enumerate().all(|(i, &o)| inverse[o as usize] == i as u32));
            }
        }
    }
}

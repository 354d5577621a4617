//! One head's weights of a block of queries, and what they add to the results.
//!
//! Queries lie in the lanes of registers, 64 of them at a time with AVX-512: scores are
//! `[keys, queries]`, so maximum, exponential and sum of a query never leave its lane, keys and
//! values are read as single values where they lie, and every length and width works without
//! padding. A block of keys makes scores, weights and a part of the result while all of them stay
//! in the first-level cache.
//!
//! The exponents are taken relative to a shift of each query: the largest score of the first block
//! of keys. A weight may thus exceed 1; only if the weights of a later block sum up to more than
//! [`LARGEST_SUM`] does the query get a new shift. It is taken off the finished score: as the starting
//! value of its sum it would leave, beside scores of 10¹⁰ and more, a rounding error that no exponent
//! holds. All this depends on the query and the keys of its patch in
//! their order, not on other queries nor on threads.

use super::softmax::SoftmaxVector;
use super::tile::{Lanes, Spread, tile, with_rows};
use super::weights::Weights;
use crate::simd::Vector;

/// Keys whose weights are held at a time; even. Times 64 queries they fill 12 KiB.
pub(super) const KEY_BLOCK: usize = 48;
/// Most lanes of a block of queries.
pub(super) const MOST_LANES: usize = 64;
/// Above this sum of weights of one block of keys, queries get a new shift. Small enough that
/// sums over weighted values of up to 10³² stay finite.
const LARGEST_SUM: f32 = 65_536.0;

/// A block of queries.
pub(super) struct Block<'a, E> {
    /// Elements of a query.
    pub steps: usize,
    /// `[len, steps]`
    pub keys: &'a [E],
    /// `[len or pairs of it, dim]`
    pub values: &'a [E],
    /// Scaled, so that weights are powers of two. `[steps, lanes]`
    pub queries: &'a [E],
    /// Scores, then weights. `[KEY_BLOCK, lanes]`
    pub weights: &'a mut [f32],
    /// `[dim, lanes]`
    pub out: &'a mut [f32],
    /// What is subtracted from the scores.
    pub shift: [f32; MOST_LANES],
    /// Sum of weights.
    pub sum: [f32; MOST_LANES],
}

/// Weights of a block of keys, and the sums with them.
#[inline(always)]
pub(super) unsafe fn weights<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Block<'_, P::Element>,
    start: usize,
    keys: usize,
) {
    // SAFETY: the caller's promise; a register of the block lies inside `shift` and `sum`.
    unsafe {
        if start == 0 {
            scores::<P, MR, NV>(s, 0, keys);
            let top = largest::<P, NV>(s, keys);
            for v in 0..NV {
                top[v].store(s.shift.as_mut_ptr().add(v * P::Sum::LANES));
            }
            let sums = exponentials::<P, NV>(s, keys, top);
            for v in 0..NV {
                sums[v].store(s.sum.as_mut_ptr().add(v * P::Sum::LANES));
            }
            return;
        }
        let mut shift = [P::Sum::zero(); NV];
        for v in 0..NV {
            shift[v] = P::Sum::load(s.shift.as_ptr().add(v * P::Sum::LANES));
        }
        scores::<P, MR, NV>(s, start, keys);
        let mut sums = exponentials::<P, NV>(s, keys, shift);
        let mut fits = true;
        for v in 0..NV {
            fits &= sums[v].all_at_most(LARGEST_SUM);
        }
        if !fits {
            raise_shift::<P, MR, NV>(s, start, keys, sums);
            for v in 0..NV {
                shift[v] = P::Sum::load(s.shift.as_ptr().add(v * P::Sum::LANES));
            }
            // The scores are there: raising the shift looked for the largest of them.
            sums = exponentials::<P, NV>(s, keys, shift);
        }
        for v in 0..NV {
            let to = s.sum.as_mut_ptr().add(v * P::Sum::LANES);
            P::Sum::load(to).add(sums[v]).store(to);
        }
    }
}

/// Gives the queries whose weights grew too large a new shift; the others keep theirs.
#[inline(always)]
unsafe fn raise_shift<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Block<'_, P::Element>,
    start: usize,
    keys: usize,
    sums: [P::Sum; NV],
) {
    // SAFETY: the caller's promise.
    unsafe {
        scores::<P, MR, NV>(s, start, keys);
        let top = largest::<P, NV>(s, keys);
        let lanes = NV * P::Sum::LANES;
        let rows = s.out.len() / lanes;
        for v in 0..NV {
            let at = v * P::Sum::LANES;
            let old = P::Sum::load(s.shift.as_ptr().add(at));
            let new = sums[v].select_gt(P::Sum::splat(LARGEST_SUM), top[v].max(old), old);
            new.store(s.shift.as_mut_ptr().add(at));
            // 1 where nothing changes.
            let factor = sums[v].select_gt(
                P::Sum::splat(LARGEST_SUM),
                old.sub(new).exp2(),
                P::Sum::splat(1.0),
            );
            let to = s.sum.as_mut_ptr().add(at);
            P::Sum::load(to).mul(factor).store(to);
            for d in 0..rows {
                let to = s.out.as_mut_ptr().add(d * lanes + at);
                P::Sum::load(to).mul(factor).store(to);
            }
        }
    }
}

/// `weights[j] = k_j · q` for a block of keys.
#[inline(always)]
unsafe fn scores<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Block<'_, P::Element>,
    start: usize,
    keys: usize,
) {
    let lanes = NV * P::Sum::LANES;
    let steps = s.steps;
    let b = Lanes { base: s.queries.as_ptr(), stride: lanes };
    let mut j = 0;
    while j < keys {
        let rows = MR.min(keys - j);
        // SAFETY: keys `start + j..start + j + rows` are inside the patch.
        unsafe {
            let a = Spread { base: s.keys.as_ptr().add((start + j) * steps), row: steps, step: 1 };
            let to = s.weights.as_mut_ptr().add(j * lanes);
            with_rows!(rows, M => {
                let sums = tile::<P, M, NV>([P::Sum::zero(); NV], &a, &b, steps);
                for i in 0..M {
                    for v in 0..NV {
                        sums[i][v].store(to.add(i * lanes + v * P::Sum::LANES));
                    }
                }
            });
        }
        j += rows;
    }
}

/// Largest score of each query, NaN left aside; at least the lowest finite number.
#[inline(always)]
unsafe fn largest<P: Weights, const NV: usize>(
    s: &Block<'_, P::Element>,
    keys: usize,
) -> [P::Sum; NV] {
    // SAFETY: the caller's instruction set; `keys` rows of scores.
    unsafe {
        let mut top = [P::Sum::splat(f32::MIN); NV];
        for j in 0..keys {
            for v in 0..NV {
                let at = s.weights.as_ptr().add((j * NV + v) * P::Sum::LANES);
                // `max` keeps its second operand when the first is NaN; the sum finds NaN later.
                top[v] = P::Sum::load(at).max(top[v]);
            }
        }
        top
    }
}

/// Turns scores into `2^(score − shift)`, in steps; returns their sums.
#[inline(always)]
unsafe fn exponentials<P: Weights, const NV: usize>(
    s: &mut Block<'_, P::Element>,
    keys: usize,
    shift: [P::Sum; NV],
) -> [P::Sum; NV] {
    // SAFETY: the caller's instruction set; `keys` rows of scores. Weights never overtake
    // the scores still to be read.
    unsafe {
        let mut sums = [P::Sum::zero(); NV];
        let mut j = 0;
        while j < keys {
            for v in 0..NV {
                let at = s.weights.as_mut_ptr().add((j * NV + v) * P::Sum::LANES);
                let first = P::Sum::load(at).sub(shift[v]).exp2();
                sums[v] = sums[v].add(first);
                let mut second = P::Sum::zero();
                if P::TERMS == 2 && j + 1 < keys {
                    second = P::Sum::load(at.add(NV * P::Sum::LANES)).sub(shift[v]).exp2();
                    sums[v] = sums[v].add(second);
                }
                let to = s.weights.as_mut_ptr().add((j / P::TERMS * NV + v) * P::Sum::LANES);
                P::store(first, second, to.cast());
            }
            j += P::TERMS;
        }
        sums
    }
}

/// Adds the weighted values of a block of keys to the results.
#[inline(always)]
pub(super) unsafe fn add_values<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Block<'_, P::Element>,
    dim: usize,
    start: usize,
    keys: usize,
) {
    let lanes = NV * P::Sum::LANES;
    let b = Lanes { base: s.weights.as_ptr().cast::<P::Element>(), stride: lanes };
    let steps = keys.div_ceil(P::TERMS);
    let mut d = 0;
    while d < dim {
        let rows = MR.min(dim - d);
        // SAFETY: `start` is a multiple of the even block; channels `d..d + rows` of the head.
        unsafe {
            let base = s.values.as_ptr().add(start / P::TERMS * dim + d);
            let a = Spread { base, row: 1, step: dim };
            let to = s.out.as_mut_ptr().add(d * lanes);
            with_rows!(rows, M => {
                let sums = tile::<P, M, NV>([P::Sum::zero(); NV], &a, &b, steps);
                for i in 0..M {
                    for v in 0..NV {
                        let to = to.add(i * lanes + v * P::Sum::LANES);
                        // A sum of block sums: more exact than one long chain.
                        let sum = if start == 0 {
                            sums[i][v]
                        } else {
                            P::Sum::load(to).add(sums[i][v])
                        };
                        sum.store(to);
                    }
                }
            });
        }
        d += rows;
    }
}

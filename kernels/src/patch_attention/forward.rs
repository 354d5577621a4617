//! Attention of the rows of one patch, one head.
//!
//! Queries lie in the lanes of registers, 64 of them at a time with AVX-512: scores are
//! `[keys, queries]`, so maximum, exponential and sum of a query never leave its lane, keys and
//! values are read as single values where they lie, and every length and width works without
//! padding. A block of keys makes scores, weights and a part of the result while all of them stay
//! in the first-level cache.
//!
//! The exponents are taken relative to a shift of each query: the largest score of the first block
//! of keys. A weight may thus exceed 1; only if the weights of a later block sum up to more than
//! [`LARGEST_SUM`] does the query get a new shift. The shift is the starting value of the score's
//! sum, so subtracting it costs nothing. All this depends on the query and the keys of its patch in
//! their order, not on other queries nor on threads.

use super::Heads;
use super::softmax::SoftmaxVector;
use super::tile::{Lanes, Spread, tile, with_rows};
use super::weights::Weights;
use crate::gemm::SharedMut;
use crate::patches::Patches;
use crate::simd::Vector;
use std::ops::Range;

/// Keys whose weights are held at a time; even. Times 64 queries they fill 12 KiB.
const KEY_BLOCK: usize = 48;
/// Most lanes of a block of queries.
const MOST_LANES: usize = 64;
/// Above this sum of weights of one block of keys, queries get a new shift. Small enough that
/// sums over weighted values of up to 10³² stay finite.
const LARGEST_SUM: f32 = 65_536.0;

/// One patch, one head.
#[derive(Clone, Copy)]
pub(super) struct Task<'a> {
    pub qkv: &'a [f32],
    pub heads: Heads,
    pub head: usize,
    /// Rows of the patch's slots.
    pub rows: &'a [u32],
    /// Leading slots whose outputs count.
    pub own: usize,
    /// Rows and head of the task that this thread will likely do next.
    pub next: (&'a [u32], usize),
}

impl<'a> Task<'a> {
    /// Task `t`: patches in order, the heads of a patch after each other.
    pub fn new(
        qkv: &'a [f32],
        heads: Heads,
        patches: &'a Patches,
        rows: &'a [u32],
        t: usize,
    ) -> Self {
        let patch_rows = |t: usize| {
            let patch = patches.patches.get(t / heads.count);
            patch.map_or(&[][..], |p| &rows[p.start..p.start + p.len])
        };
        Self {
            qkv,
            heads,
            head: t % heads.count,
            rows: patch_rows(t),
            own: patches.patches[t / heads.count].own,
            next: (patch_rows(t + 1), (t + 1) % heads.count),
        }
    }

    /// One part (0 q, 1 k, 2 v) of a row's head.
    pub fn part(&self, row: u32, part: usize) -> &[f32] {
        self.part_of(row, part, self.head)
    }

    fn part_of(&self, row: u32, part: usize, head: usize) -> &[f32] {
        let c = self.heads.channels();
        let at = row as usize * 3 * c + part * c + head * self.heads.dim;
        &self.qkv[at..at + self.heads.dim]
    }

    /// Asks for the memory that the slots of a block of queries will need: their results, and the
    /// queries of the next block. Rows lie anywhere; without this and the next function a sixth of
    /// the time of narrow heads is waiting for them.
    ///
    /// # Safety
    /// The slots' rows must be inside `out`, `[N, C]`.
    #[inline(always)]
    unsafe fn prefetch_queries(&self, slots: Range<usize>, lanes: usize, out: SharedMut) {
        for slot in slots {
            if slot < self.own {
                let at = self.rows[slot] as usize * self.heads.channels();
                // SAFETY: the caller's promise.
                prefetch(unsafe { out.at(at + self.head * self.heads.dim) }, self.heads.dim);
            }
            if slot + lanes < self.own {
                prefetch(self.part(self.rows[slot + lanes], 0).as_ptr(), self.heads.dim);
            }
        }
    }

    /// Asks for keys and values of the next task, and for its first queries.
    #[inline(always)]
    fn prefetch_next(&self, slots: Range<usize>, lanes: usize) {
        let (rows, head) = self.next;
        for slot in slots {
            if let Some(&row) = rows.get(slot) {
                for part in if slot < lanes { 0..3 } else { 1..3 } {
                    prefetch(self.part_of(row, part, head).as_ptr(), self.heads.dim);
                }
            }
        }
    }
}

/// Asks for `len` values to be brought to the second-level cache.
#[inline(always)]
fn prefetch(from: *const f32, len: usize) {
    #[cfg(target_arch = "x86_64")]
    for line in (0..len + 15).step_by(16) {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        let at = from.wrapping_add(line.min(len.saturating_sub(1)));
        // SAFETY: a hint; it may name any address.
        unsafe { _mm_prefetch::<_MM_HINT_T1>(at.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (from, len);
}

/// Buffers of one thread.
pub(super) struct Scratch<E> {
    /// `[len, dim]`, elements along `dim`.
    keys: Vec<E>,
    /// `[len, dim]`, elements along `len`.
    values: Vec<E>,
    /// `[dim, lanes]`, elements along `dim`; scaled, so that weights are powers of two.
    queries: Vec<E>,
    /// One query, scaled. `[dim]`
    row: Vec<f32>,
    /// The same as elements. `[dim]`
    elements: Vec<E>,
    /// Scores, then weights. `[KEY_BLOCK, lanes]`
    weights: Vec<f32>,
    /// `[dim, lanes]`
    out: Vec<f32>,
    /// What is subtracted from the scores.
    shift: [f32; MOST_LANES],
    /// Sum of weights.
    sum: [f32; MOST_LANES],
}

impl<E: Copy + Default> Scratch<E> {
    pub fn new(dim: usize, longest: usize) -> Self {
        Self {
            keys: vec![E::default(); longest * dim],
            values: vec![E::default(); longest.next_multiple_of(2) * dim],
            queries: vec![E::default(); MOST_LANES * dim],
            row: vec![0.0; dim],
            elements: vec![E::default(); dim],
            weights: vec![0.0; KEY_BLOCK * MOST_LANES],
            out: vec![0.0; MOST_LANES * dim],
            shift: [0.0; MOST_LANES],
            sum: [0.0; MOST_LANES],
        }
    }
}

/// Fills the outputs of the patch's own rows.
///
/// # Safety
/// The instruction set must be there, and no other thread may touch these rows' channels of this
/// head in `out`, `[N, C]`.
#[inline(always)]
pub(super) unsafe fn attend<P: Weights, const MR: usize, const NV: usize>(
    task: &Task<'_>,
    s: &mut Scratch<P::Element>,
    out: SharedMut,
) {
    // SAFETY: the caller's instruction set.
    unsafe { pack::<P>(task, s) };
    let mut done = 0;
    while done < task.own {
        let left = task.own - done;
        // SAFETY: passed on.
        unsafe {
            done += if NV >= 4 && left > 2 * P::Sum::LANES {
                block::<P, MR, 4>(task, s, done, out)
            } else if NV >= 2 && left > P::Sum::LANES {
                block::<P, MR, 2>(task, s, done, out)
            } else {
                block::<P, MR, 1>(task, s, done, out)
            };
        }
    }
}

/// Copies keys and values of the head side by side.
#[inline(always)]
unsafe fn pack<P: Weights>(task: &Task<'_>, s: &mut Scratch<P::Element>) {
    let dim = task.heads.dim;
    let steps = dim.div_ceil(P::TERMS);
    // SAFETY: the caller's instruction set.
    unsafe {
        for (to, &row) in s.keys.chunks_exact_mut(steps).zip(task.rows) {
            P::pack_along(task.part(row, 1), to);
        }
        for (to, rows) in s.values.chunks_exact_mut(dim).zip(task.rows.chunks(P::TERMS)) {
            P::pack_across(task.part(rows[0], 2), rows.get(1).map(|&r| task.part(r, 2)), to);
        }
    }
}

/// Attention of up to `NV` registers of queries from slot `first`; returns how many.
#[inline(always)]
unsafe fn block<P: Weights, const MR: usize, const NV: usize>(
    task: &Task<'_>,
    s: &mut Scratch<P::Element>,
    first: usize,
    out: SharedMut,
) -> usize {
    let lanes = NV * P::Sum::LANES;
    let (dim, len) = (task.heads.dim, task.rows.len());
    let steps = dim.div_ceil(P::TERMS);
    let queries = &task.rows[first..task.own.min(first + lanes)];
    s.queries[..steps * lanes].fill(P::Element::default());
    let scale = task.heads.exponent_scale();
    for (lane, &row) in queries.iter().enumerate() {
        for (to, q) in s.row.iter_mut().zip(task.part(row, 0)) {
            *to = q * scale;
        }
        let elements = &mut s.elements[..steps];
        // SAFETY: the caller's instruction set.
        unsafe { P::pack_along(&s.row, elements) };
        for (p, &element) in elements.iter().enumerate() {
            s.queries[p * lanes + lane] = element;
        }
    }
    let mut start = 0;
    while start < len {
        let keys = KEY_BLOCK.min(len - start);
        // SAFETY: buffers hold `KEY_BLOCK × lanes` weights, `dim × lanes` queries and results, and
        // all keys and values of the patch.
        unsafe {
            let slots = (start * lanes).div_ceil(len)..((start + keys) * lanes).div_ceil(len);
            let slots = first + slots.start..first + slots.end;
            task.prefetch_queries(slots.clone(), lanes, out);
            weights::<P, MR, NV>(s, steps, start, keys);
            task.prefetch_next(slots, lanes);
            add_values::<P, MR, NV>(s, dim, start, keys);
        }
        start += keys;
    }
    let c = task.heads.channels();
    for (lane, &row) in queries.iter().enumerate() {
        let at = row as usize * c + task.head * dim;
        // SAFETY: rows and channels of the head inside the result, which are ours.
        let to = unsafe { std::slice::from_raw_parts_mut(out.at(at), dim) };
        let inverse = 1.0 / s.sum[lane];
        for (d, value) in to.iter_mut().enumerate() {
            *value = s.out[d * lanes + lane] * inverse;
        }
    }
    queries.len()
}

/// Weights of a block of keys, and the sums with them.
#[inline(always)]
unsafe fn weights<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Scratch<P::Element>,
    steps: usize,
    start: usize,
    keys: usize,
) {
    // SAFETY: the caller's promise; a register of the block lies inside `shift` and `sum`.
    unsafe {
        if start == 0 {
            scores::<P, MR, NV>(s, steps, 0, keys, [P::Sum::zero(); NV]);
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
        let mut from = [P::Sum::zero(); NV];
        for v in 0..NV {
            from[v] = from[v].sub(P::Sum::load(s.shift.as_ptr().add(v * P::Sum::LANES)));
        }
        scores::<P, MR, NV>(s, steps, start, keys, from);
        let mut sums = exponentials::<P, NV>(s, keys, [P::Sum::zero(); NV]);
        let mut fits = true;
        for v in 0..NV {
            fits &= sums[v].all_at_most(LARGEST_SUM);
        }
        if !fits {
            raise_shift::<P, MR, NV>(s, steps, start, keys, sums);
            for v in 0..NV {
                from[v] = P::Sum::zero().sub(P::Sum::load(s.shift.as_ptr().add(v * P::Sum::LANES)));
            }
            scores::<P, MR, NV>(s, steps, start, keys, from);
            sums = exponentials::<P, NV>(s, keys, [P::Sum::zero(); NV]);
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
    s: &mut Scratch<P::Element>,
    steps: usize,
    start: usize,
    keys: usize,
    sums: [P::Sum; NV],
) {
    // SAFETY: the caller's promise.
    unsafe {
        scores::<P, MR, NV>(s, steps, start, keys, [P::Sum::zero(); NV]);
        let top = largest::<P, NV>(s, keys);
        let lanes = NV * P::Sum::LANES;
        let rows = s.out.len() / MOST_LANES;
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

/// `weights[j] = from + k_j · q` for a block of keys.
#[inline(always)]
unsafe fn scores<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Scratch<P::Element>,
    steps: usize,
    start: usize,
    keys: usize,
    from: [P::Sum; NV],
) {
    let lanes = NV * P::Sum::LANES;
    let b = Lanes { base: s.queries.as_ptr(), stride: lanes };
    let mut j = 0;
    while j < keys {
        let rows = MR.min(keys - j);
        // SAFETY: keys `start + j..start + j + rows` are inside the patch.
        unsafe {
            let a = Spread { base: s.keys.as_ptr().add((start + j) * steps), row: steps, step: 1 };
            let to = s.weights.as_mut_ptr().add(j * lanes);
            with_rows!(rows, M => {
                let sums = tile::<P, M, NV>(from, &a, &b, steps);
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
    s: &Scratch<P::Element>,
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
    s: &mut Scratch<P::Element>,
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
unsafe fn add_values<P: Weights, const MR: usize, const NV: usize>(
    s: &mut Scratch<P::Element>,
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

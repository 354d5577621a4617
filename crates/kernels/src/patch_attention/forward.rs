//! Attention of the rows of one patch, one head.

use super::block::{Block, KEY_BLOCK, MOST_LANES, add_values, weights};
use super::task::Task;
use super::weights::Weights;
use crate::gemm::SharedMut;
use crate::simd::Vector;

/// Buffers of one thread.
pub(super) struct Scratch<E> {
    /// `[len, dim]`, elements along `dim`.
    keys: Vec<E>,
    /// `[len, dim]`, elements along `len`.
    values: Vec<E>,
    /// `[dim, lanes]`, elements along `dim`.
    queries: Vec<E>,
    /// One query, scaled. `[dim]`
    row: Vec<f32>,
    /// The same as elements. `[dim]`
    elements: Vec<E>,
    /// `[KEY_BLOCK, lanes]`
    weights: Vec<f32>,
    /// `[dim, lanes]`
    out: Vec<f32>,
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

/// Copies a block of queries, queries in lanes.
#[inline(always)]
unsafe fn pack_queries<P: Weights>(
    task: &Task<'_>,
    s: &mut Scratch<P::Element>,
    queries: &[u32],
    lanes: usize,
) {
    let steps = task.heads.dim.div_ceil(P::TERMS);
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
    let queries = &task.rows[first..task.own.min(first + lanes)];
    // SAFETY: the caller's instruction set.
    unsafe { pack_queries::<P>(task, s, queries, lanes) };
    let mut b = Block {
        steps: dim.div_ceil(P::TERMS),
        keys: &s.keys,
        values: &s.values,
        queries: &s.queries,
        weights: &mut s.weights,
        out: &mut s.out[..dim * lanes],
        shift: [0.0; MOST_LANES],
        sum: [0.0; MOST_LANES],
    };
    let mut start = 0;
    while start < len {
        let keys = KEY_BLOCK.min(len - start);
        // Each block of keys asks for the memory of some of the queries' slots.
        let slot = |keys: usize| first + (keys * lanes).div_ceil(len);
        let slots = slot(start)..slot(start + keys);
        // SAFETY: the block's slices have the lengths that it names, and hold all of the patch.
        unsafe {
            task.prefetch_queries(slots.clone(), lanes, out);
            weights::<P, MR, NV>(&mut b, start, keys);
            task.prefetch_next(slots, lanes);
            add_values::<P, MR, NV>(&mut b, dim, start, keys);
        }
        start += keys;
    }
    let inverse = b.sum.map(|sum| 1.0 / sum);
    for (lane, &row) in queries.iter().enumerate() {
        // SAFETY: rows and channels of the head inside the result, which are ours.
        let to = unsafe { std::slice::from_raw_parts_mut(task.result(row, out), dim) };
        for (d, value) in to.iter_mut().enumerate() {
            *value = s.out[d * lanes + lane] * inverse[lane];
        }
    }
    queries.len()
}

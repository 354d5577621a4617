//! Gradient of the attention of the rows of one patch, one head; the weights are computed again.
//!
//! Keys lie in the lanes of registers here: four of the five products (scores, gradients of weights,
//! of values and of keys) then read one factor as single values and the other as registers, without
//! any turning. Scores and gradients of weights of a block of queries against all keys of the patch
//! stay in the second-level cache.

use super::softmax::{SoftmaxVector, dispatch_softmax};
use super::task::Task;
use super::tile::{Lanes, Spread, tile, with_rows};
use super::{Heads, slot_rows, tasks};
use crate::gemm::SharedMut;
use crate::gemm::micro::Singles;
use crate::patches::{Patch, Patches};
use crate::shape::elements;
use rayon::prelude::*;

/// Queries whose weights are held at a time; a multiple of the tile's rows.
const QUERY_BLOCK: usize = 24;
/// Lanes of the widest tile.
const MOST_LANES: usize = 64;

/// Gradient of [`super::forward`] with respect to `qkv`; the scores are computed again.
///
/// # Shapes
/// `qkv`, `dqkv`: `[N, 3·C]` · `grad`: `[N, C]`
///
/// # Panics
/// As [`super::forward`].
pub fn backward(
    qkv: &[f32],
    heads: Heads,
    patches: &Patches,
    order: &[u32],
    grad: &[f32],
    dqkv: &mut [f32],
) {
    let (c, dim) = (heads.channels(), heads.dim);
    assert_eq!(qkv.len(), elements([order.len(), 3, c]), "attention: qkv length");
    assert_eq!(grad.len(), elements([order.len(), c]), "attention: gradient length");
    assert_eq!(dqkv.len(), qkv.len(), "attention: result length");
    let rows = slot_rows(patches, order);
    if grad.is_empty() {
        return;
    }
    let out = SharedMut(dqkv.as_mut_ptr());
    // Own slots are written at once; borrowed ones are added afterwards, in a fixed order.
    let borrowed: Vec<(Patch, usize, Vec<f32>)> = tasks(patches, heads)
        .map_init(
            || Scratch::new(dim, patches.longest()),
            |s, t| {
                let task = &Task::new(qkv, heads, patches, &rows, t);
                let (patch, head) = (patches.patches()[t / heads.count], task.head);
                // Own rows and this head's channels are written by no one else.
                dispatch_softmax!(
                    (task: &Task<'_>, grad: &[f32], s: &mut Scratch, out: SharedMut),
                    V, MR, NV => gradients::<V, MR, NV>(task, grad, s, out)
                );
                for part in [1, 2] {
                    for (slot, &row) in task.rows[..task.own].iter().enumerate() {
                        let at = row as usize * 3 * c + part * c + head * dim;
                        // SAFETY: as above.
                        let to = unsafe { std::slice::from_raw_parts_mut(out.at(at), dim) };
                        s.take(part, slot, to);
                    }
                }
                let mut rest = vec![0.0; 2 * (patch.len - patch.own) * dim];
                let slots = (patch.own..patch.len).chain(patch.own..patch.len);
                for (i, (to, slot)) in rest.chunks_exact_mut(dim).zip(slots).enumerate() {
                    s.take(if i < patch.len - patch.own { 1 } else { 2 }, slot, to);
                }
                (patch, head, rest)
            },
        )
        .filter(|(_, _, rest)| !rest.is_empty())
        .collect();
    for (patch, head, rest) in borrowed {
        let slots = patch.start + patch.own..patch.start + patch.len;
        let mut from = rest.chunks_exact(dim);
        for part in [1, 2] {
            for (slot, from) in slots.clone().zip(&mut from) {
                let at = rows[slot] as usize * 3 * c + part * c + head * dim;
                for (d, v) in dqkv[at..at + dim].iter_mut().zip(from) {
                    *d += v;
                }
            }
        }
    }
}

/// Buffers of one thread. Rows of keys in lanes are `stride` long: a whole number of tiles and 16
/// more, so that rows do not all fall into the same sets of the cache.
struct Scratch {
    stride: usize,
    /// `[dim, stride]`
    keys: Vec<f32>,
    /// `[dim, stride]`
    values: Vec<f32>,
    /// `[len, padded dim]`
    key_rows: Vec<f32>,
    /// `[dim, stride]`
    key_grads: Vec<f32>,
    /// `[dim, stride]`
    value_grads: Vec<f32>,
    /// `[QUERY_BLOCK, dim]`
    queries: Vec<f32>,
    /// Gradients of the queries' outputs. `[QUERY_BLOCK, dim]`
    grads: Vec<f32>,
    /// Scores, then weights before they are divided by their sum. `[QUERY_BLOCK, stride]`
    weights: Vec<f32>,
    /// Gradients of the weights, then of the scores. `[QUERY_BLOCK, stride]`
    weight_grads: Vec<f32>,
    /// `[6, padded dim]`
    query_grads: Vec<f32>,
}

impl Scratch {
    fn new(dim: usize, longest: usize) -> Self {
        let stride = longest.next_multiple_of(MOST_LANES) + 16;
        let padded = dim.next_multiple_of(16);
        Self {
            stride,
            keys: vec![0.0; dim * stride],
            values: vec![0.0; dim * stride],
            key_rows: vec![0.0; longest * padded],
            key_grads: vec![0.0; dim * stride],
            value_grads: vec![0.0; dim * stride],
            queries: vec![0.0; QUERY_BLOCK * dim],
            grads: vec![0.0; QUERY_BLOCK * dim],
            weights: vec![0.0; QUERY_BLOCK * stride],
            weight_grads: vec![0.0; QUERY_BLOCK * stride],
            query_grads: vec![0.0; 6 * padded],
        }
    }

    /// Copies out the gradient of a slot's key (part 1) or value (part 2).
    fn take(&self, part: usize, slot: usize, to: &mut [f32]) {
        let from = if part == 1 { &self.key_grads } else { &self.value_grads };
        for (d, to) in to.iter_mut().enumerate() {
            *to = from[d * self.stride + slot];
        }
    }
}

/// Leaves the gradients of keys and values in the scratch, writes those of queries.
///
/// # Safety
/// The instruction set must be there, and no other thread may touch the own rows' query channels of
/// this head in `out`, `[N, 3·C]`.
#[inline(always)]
unsafe fn gradients<V: SoftmaxVector, const MR: usize, const NV: usize>(
    task: &Task<'_>,
    grad: &[f32],
    s: &mut Scratch,
    out: SharedMut,
) {
    let (dim, len) = (task.heads.dim, task.rows.len());
    pack_keys(task, s);
    let c = task.heads.channels();
    for first in (0..task.own).step_by(QUERY_BLOCK) {
        let rows = &task.rows[first..task.own.min(first + QUERY_BLOCK)];
        let scale = task.heads.exponent_scale();
        for (i, &row) in rows.iter().enumerate() {
            let to = &mut s.queries[i * dim..(i + 1) * dim];
            for (to, q) in to.iter_mut().zip(task.part(row, 0)) {
                *to = q * scale;
            }
            let at = row as usize * c + task.head * dim;
            s.grads[i * dim..(i + 1) * dim].copy_from_slice(&grad[at..at + dim]);
        }
        let mut inverse = [0f32; QUERY_BLOCK];
        // SAFETY: all buffers hold `QUERY_BLOCK` rows and whole tiles of keys.
        unsafe {
            for lane in (0..len).step_by(NV * V::LANES) {
                expand::<V, MR, NV>(s, Product::Scores, dim, rows.len(), lane);
                expand::<V, MR, NV>(s, Product::WeightGrads, dim, rows.len(), lane);
            }
            for i in 0..rows.len() {
                inverse[i] = softmax_row::<V>(s, i, len);
            }
        }
        for (i, &row) in rows.iter().enumerate() {
            let to = &mut s.queries[i * dim..(i + 1) * dim];
            let factor = task.heads.scale() * inverse[i];
            for (to, q) in to.iter_mut().zip(task.part(row, 0)) {
                *to = q * factor;
            }
            for g in &mut s.grads[i * dim..(i + 1) * dim] {
                *g *= inverse[i];
            }
        }
        // SAFETY: as above; the rows of `out` are ours.
        unsafe {
            for lane in (0..len).step_by(NV * V::LANES) {
                reduce::<V, MR, NV>(s, dim, rows.len(), lane, first == 0);
            }
            let factors = inverse.map(|i| i * task.heads.scale());
            query_gradients::<V, MR, NV>(task, s, rows, &factors, out);
        }
    }
}

/// Copies keys and values of the head, keys in lanes, and keys once more as rows.
fn pack_keys(task: &Task<'_>, s: &mut Scratch) {
    let (dim, len) = (task.heads.dim, task.rows.len());
    let padded = dim.next_multiple_of(16);
    for part in [1, 2] {
        let to = if part == 1 { &mut s.keys } else { &mut s.values };
        // Sixteen slots at a time: writes stay in one cache line per channel.
        for first in (0..len).step_by(16) {
            let rows = &task.rows[first..len.min(first + 16)];
            for (i, &row) in rows.iter().enumerate() {
                for (d, v) in task.part(row, part).iter().enumerate() {
                    to[d * s.stride + first + i] = *v;
                }
            }
        }
        // A shorter patch than the last one: its lanes of padding must be zero.
        for row in to.chunks_exact_mut(s.stride) {
            row[len..].fill(0.0);
        }
    }
    for (to, &row) in s.key_rows.chunks_exact_mut(padded).zip(task.rows) {
        to[..dim].copy_from_slice(task.part(row, 1));
    }
}

/// The two products of a block of queries with all keys.
#[derive(Clone, Copy)]
enum Product {
    /// Queries and keys.
    Scores,
    /// Gradients of outputs and values.
    WeightGrads,
}

/// One product for a tile's width of keys from `lane`.
#[inline(always)]
unsafe fn expand<V: SoftmaxVector, const MR: usize, const NV: usize>(
    s: &mut Scratch,
    product: Product,
    dim: usize,
    rows: usize,
    lane: usize,
) {
    let (a, b, to) = match product {
        Product::Scores => (&s.queries, &s.keys, &mut s.weights),
        Product::WeightGrads => (&s.grads, &s.values, &mut s.weight_grads),
    };
    let stride = s.stride;
    let mut i = 0;
    while i < rows {
        let height = MR.min(rows - i);
        // SAFETY: rows `i..i + height` of the block, lanes of one tile inside the stride.
        unsafe {
            let a = Spread { base: a.as_ptr().add(i * dim), row: dim, step: 1 };
            let b = Lanes { base: b.as_ptr().add(lane), stride };
            let to = to.as_mut_ptr().add(i * stride + lane);
            with_rows!(height, M => {
                let sums = tile::<Singles<V>, M, NV>([V::zero(); NV], &a, &b, dim);
                for i in 0..M {
                    for v in 0..NV {
                        sums[i][v].store(to.add(i * stride + v * V::LANES));
                    }
                }
            });
        }
        i += height;
    }
}

/// Scores of one query become weights, gradients of weights become those of scores; both are still
/// to be multiplied by the returned inverse of the sum of weights.
#[inline(always)]
unsafe fn softmax_row<V: SoftmaxVector>(s: &mut Scratch, i: usize, len: usize) -> f32 {
    let whole = len.next_multiple_of(2 * V::LANES);
    let weights = &mut s.weights[i * s.stride..i * s.stride + whole];
    weights[len..].fill(f32::NEG_INFINITY);
    let weights = weights.as_mut_ptr();
    let grads = s.weight_grads[i * s.stride..i * s.stride + whole].as_mut_ptr();
    // SAFETY: both rows have `whole` values, a multiple of two registers; the caller's instruction
    // set.
    unsafe {
        let mut top = [V::splat(f32::MIN); 2];
        for j in (0..whole).step_by(2 * V::LANES) {
            for v in 0..2 {
                // `max` keeps its second operand when the first is NaN; the sum finds NaN later.
                top[v] = V::load(weights.add(j + v * V::LANES)).max(top[v]);
            }
        }
        let mut lanes = [f32::MIN; 16];
        top[0].max(top[1]).store(lanes.as_mut_ptr());
        let top = V::splat(lanes.into_iter().fold(f32::MIN, f32::max));
        let (mut sum, mut dot) = ([V::zero(); 2], [V::zero(); 2]);
        for j in (0..whole).step_by(2 * V::LANES) {
            for v in 0..2 {
                let at = j + v * V::LANES;
                let weight = V::load(weights.add(at)).sub(top).exp2();
                weight.store(weights.add(at));
                sum[v] = sum[v].add(weight);
                dot[v] = weight.fma(V::load(grads.add(at)), dot[v]);
            }
        }
        let inverse = 1.0 / sum[0].add(sum[1]).total();
        let mean = V::splat(dot[0].add(dot[1]).total() * inverse);
        for j in (0..whole).step_by(V::LANES) {
            let grad = V::load(grads.add(j)).sub(mean);
            grad.mul(V::load(weights.add(j))).store(grads.add(j));
        }
        inverse
    }
}

/// Adds a block of queries to the gradients of keys and values, for a tile's width of keys.
#[inline(always)]
unsafe fn reduce<V: SoftmaxVector, const MR: usize, const NV: usize>(
    s: &mut Scratch,
    dim: usize,
    rows: usize,
    lane: usize,
    first: bool,
) {
    let stride = s.stride;
    for (a, b, to) in [
        (&s.grads, &s.weights, &mut s.value_grads),
        (&s.queries, &s.weight_grads, &mut s.key_grads),
    ] {
        let mut d = 0;
        while d < dim {
            let height = MR.min(dim - d);
            // SAFETY: channels `d..d + height` of the head, lanes of one tile inside the stride.
            unsafe {
                let a = Spread { base: a.as_ptr().add(d), row: 1, step: dim };
                let b = Lanes { base: b.as_ptr().add(lane), stride };
                let to = to.as_mut_ptr().add(d * stride + lane);
                with_rows!(height, M => {
                    let sums = tile::<Singles<V>, M, NV>([V::zero(); NV], &a, &b, rows);
                    for i in 0..M {
                        for v in 0..NV {
                            let to = to.add(i * stride + v * V::LANES);
                            let sum = sums[i][v];
                            (if first { sum } else { V::load(to).add(sum) }).store(to);
                        }
                    }
                });
            }
            d += height;
        }
    }
}

/// Writes the gradients of a block of queries: those of scores times the keys.
#[inline(always)]
unsafe fn query_gradients<V: SoftmaxVector, const MR: usize, const NV: usize>(
    task: &Task<'_>,
    s: &mut Scratch,
    rows: &[u32],
    factors: &[f32; QUERY_BLOCK],
    out: SharedMut,
) {
    let (dim, len) = (task.heads.dim, task.rows.len());
    let padded = dim.next_multiple_of(16);
    let mut i = 0;
    while i < rows.len() {
        let height = MR.min(rows.len() - i);
        let mut d = 0;
        while d < padded {
            let registers = NV.min((padded - d) / V::LANES);
            // SAFETY: rows `i..i + height` of the block, channels inside the padded width.
            unsafe {
                let grads = s.weight_grads.as_ptr().add(i * s.stride);
                let a = Spread { base: grads, row: s.stride, step: 1 };
                let b = Lanes { base: s.key_rows.as_ptr().add(d), stride: padded };
                let to = s.query_grads.as_mut_ptr().add(d);
                match registers {
                    4 if NV >= 4 => rows_of_tile::<V, 4>(height, &a, &b, len, to, padded),
                    3 if NV >= 3 => rows_of_tile::<V, 3>(height, &a, &b, len, to, padded),
                    2 if NV >= 2 => rows_of_tile::<V, 2>(height, &a, &b, len, to, padded),
                    _ => rows_of_tile::<V, 1>(height, &a, &b, len, to, padded),
                }
            }
            d += registers * V::LANES;
        }
        for (k, from) in s.query_grads.chunks_exact(padded).take(height).enumerate() {
            let at = rows[i + k] as usize * 3 * task.heads.channels() + task.head * dim;
            // SAFETY: the caller's promise.
            let to = unsafe { std::slice::from_raw_parts_mut(out.at(at), dim) };
            for (to, from) in to.iter_mut().zip(from) {
                *to = from * factors[i + k];
            }
        }
        i += height;
    }
}

#[inline(always)]
unsafe fn rows_of_tile<V: SoftmaxVector, const NV: usize>(
    height: usize,
    a: &Spread<f32>,
    b: &Lanes<f32>,
    k: usize,
    to: *mut f32,
    stride: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
        with_rows!(height, M => {
            let sums = tile::<Singles<V>, M, NV>([V::zero(); NV], a, b, k);
            for i in 0..M {
                for v in 0..NV {
                    sums[i][v].store(to.add(i * stride + v * V::LANES));
                }
            }
        });
    }
}

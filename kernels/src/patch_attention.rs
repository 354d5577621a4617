//! Softmax attention inside patches of the serialized order.
//!
//! One task works on one patch and head: keys and values are packed once, queries are read where
//! they lie, and scores exist for a block of queries at a time, so nothing of size N × K is
//! ever stored. Scores, softmax and sums are f32; the largest score is subtracted before the
//! exponential, so logits of any finite size are safe. A row with NaN or ±∞ gives NaN.

use crate::activation::exp;
use crate::gemm::{PackedMatrix, RowPointers, RowPointersMut, SharedMut, multiply_rows, repack};
use crate::patches::{Patch, Patches};
use crate::simd::{Vector, dispatch};
use rayon::prelude::*;

/// Queries whose scores are held at a time; a multiple of the tile height.
const QUERY_BLOCK: usize = 48;

/// Heads and their width.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heads {
    /// Number of heads.
    pub count: usize,
    /// Channels of one head.
    pub dim: usize,
}

impl Heads {
    /// Channels of all heads.
    pub fn channels(self) -> usize {
        self.count * self.dim
    }

    /// `1 / √dim`
    fn scale(self) -> f32 {
        (1.0 / (self.dim as f64).sqrt()) as f32
    }
}

/// Attention of every row to the rows of its patch.
///
/// `order[position]` is the row at that position of the serialized sequence.
///
/// # Shapes
/// `qkv`: `[N, 3·C]`, the channels of a row being q, k, v, each `[heads, dim]` ·
/// `order`: `[N]` · `out`: `[N, C]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn forward(qkv: &[f32], heads: Heads, patches: &Patches, order: &[u32], out: &mut [f32]) {
    let c = heads.channels();
    assert_eq!(qkv.len(), order.len() * 3 * c, "attention: qkv length");
    assert_eq!(out.len(), order.len() * c, "attention: output length");
    let rows = slot_rows(patches, order);
    let target = SharedMut(out.as_mut_ptr());
    tasks(patches, heads).for_each_init(
        || Scratch::new(heads.dim, patches.longest),
        |s, (patch, head)| {
            let rows = &rows[patch.start..patch.start + patch.len];
            s.pack_keys(qkv, heads, head, rows);
            for queries in rows[..patch.own].chunks(QUERY_BLOCK) {
                s.scores(qkv, heads, head, queries);
                let len = rows.len();
                let sums = softmax_rows(&mut s.scores[..queries.len() * len], len, heads.scale());
                // SAFETY: scores and the block of outputs are ours.
                unsafe {
                    multiply_rows(
                        queries.len(),
                        RowPointers::Contiguous { base: s.scores.as_ptr(), stride: len },
                        &s.values,
                        0..heads.dim.next_multiple_of(16),
                        RowPointersMut::Contiguous { base: s.out.as_mut_ptr(), stride: heads.dim },
                        false,
                    );
                }
                for (i, &row) in queries.iter().enumerate() {
                    // SAFETY: each row is owned by one patch and each head has its own channels.
                    let to = unsafe {
                        let at = row as usize * c + head * heads.dim;
                        std::slice::from_raw_parts_mut(target.at(at), heads.dim)
                    };
                    let from = &s.out[i * heads.dim..(i + 1) * heads.dim];
                    let inverse = 1.0 / sums[i];
                    for (t, f) in to.iter_mut().zip(from) {
                        *t = f * inverse;
                    }
                }
            }
        },
    );
}

/// Row of each slot. Checks that every row is the own row of one slot only, on which the parallel
/// writes rely.
fn slot_rows(patches: &Patches, order: &[u32]) -> Vec<u32> {
    let rows: Vec<u32> = patches.pad.iter().map(|&p| order[p as usize]).collect();
    let mut owned = vec![false; order.len()];
    for patch in &patches.patches {
        assert!(patch.own <= patch.len, "attention: patch {patch:?}");
        for &row in &rows[patch.start..patch.start + patch.own] {
            let first = !std::mem::replace(&mut owned[row as usize], true);
            assert!(first, "attention: row {row} occurs twice; the order is no permutation");
        }
    }
    rows
}

fn tasks(
    patches: &Patches,
    heads: Heads,
) -> impl IndexedParallelIterator<Item = (Patch, usize)> + '_ {
    (0..patches.patches.len() * heads.count)
        .into_par_iter()
        .map(move |t| (patches.patches[t / heads.count], t % heads.count))
}

/// Buffers of one task.
struct Scratch {
    keys: PackedMatrix,
    values: PackedMatrix,
    scores: Vec<f32>,
    out: Vec<f32>,
    gathered: Vec<f32>,
}

impl Scratch {
    fn new(dim: usize, longest: usize) -> Self {
        Self {
            keys: PackedMatrix::empty(),
            values: PackedMatrix::empty(),
            scores: vec![0.0; QUERY_BLOCK * longest],
            out: vec![0.0; QUERY_BLOCK * dim],
            gathered: vec![0.0; longest * dim],
        }
    }

    /// Copies one part (0 q, 1 k, 2 v) of the rows' head into `gathered`, `[len, dim]`.
    fn gather(&mut self, qkv: &[f32], heads: Heads, head: usize, rows: &[u32], part: usize) {
        let c = heads.channels();
        for (to, &row) in self.gathered.chunks_exact_mut(heads.dim).zip(rows) {
            let at = row as usize * 3 * c + part * c + head * heads.dim;
            to.copy_from_slice(&qkv[at..at + heads.dim]);
        }
    }

    /// Keys as columns of one product, values as rows of the other.
    fn pack_keys(&mut self, qkv: &[f32], heads: Heads, head: usize, rows: &[u32]) {
        let (len, dim) = (rows.len(), heads.dim);
        self.gather(qkv, heads, head, rows, 1);
        repack(&mut self.keys, &self.gathered[..len * dim], dim, len, 1, dim);
        self.gather(qkv, heads, head, rows, 2);
        repack(&mut self.values, &self.gathered[..len * dim], len, dim, dim, 1);
    }

    /// `scores = q · kᵀ` for some rows, not yet scaled. `[queries, len]`
    fn scores(&mut self, qkv: &[f32], heads: Heads, head: usize, queries: &[u32]) {
        let len = self.keys.n();
        // SAFETY: the head's channels of the row lie inside `qkv`; scores are ours.
        unsafe {
            multiply_rows(
                queries.len(),
                RowPointers::Gathered {
                    base: qkv.as_ptr().add(head * heads.dim),
                    stride: 3 * heads.channels(),
                    ids: queries,
                },
                &self.keys,
                0..len.next_multiple_of(16),
                RowPointersMut::Contiguous { base: self.scores.as_mut_ptr(), stride: len },
                false,
            );
        }
    }
}

/// Turns rows of scores into `e^(scale·(s − max))` and returns the row sums.
fn softmax_rows(scores: &mut [f32], len: usize, scale: f32) -> [f32; QUERY_BLOCK] {
    dispatch!((scores: &mut [f32], len: usize, scale: f32) -> [f32; QUERY_BLOCK],
        V => softmax_rows_with::<V>(scores, len, scale))
}

#[inline(always)]
unsafe fn softmax_rows_with<V: Vector>(
    scores: &mut [f32],
    len: usize,
    scale: f32,
) -> [f32; QUERY_BLOCK] {
    let mut sums = [0f32; QUERY_BLOCK];
    let whole = len / V::LANES * V::LANES;
    for (row, sum) in scores.chunks_exact_mut(len).zip(&mut sums) {
        // SAFETY: offsets stay below `len`; the caller's instruction set.
        unsafe {
            let mut lanes = [f32::NEG_INFINITY; 16];
            let mut top = V::splat(f32::NEG_INFINITY);
            let mut i = 0;
            while i < whole {
                // `max` keeps its second operand when the first is NaN; the sum finds NaN later.
                top = V::load(row.as_ptr().add(i)).max(top);
                i += V::LANES;
            }
            top.store(lanes.as_mut_ptr());
            let mut most = f32::NEG_INFINITY;
            for &v in lanes[..V::LANES].iter().chain(&row[whole..]) {
                if v > most {
                    most = v;
                }
            }
            let (top, scale) = (V::splat(most), V::splat(scale));
            let mut total = V::zero();
            let mut i = 0;
            while i < whole {
                let p = row.as_mut_ptr().add(i);
                let e = exp(V::load(p).sub(top).mul(scale));
                e.store(p);
                total = total.add(e);
                i += V::LANES;
            }
            let mut sum_lanes = [0f32; 16];
            total.store(sum_lanes.as_mut_ptr());
            if whole < len {
                let mut rest = [f32::NEG_INFINITY; 16];
                rest[..len - whole].copy_from_slice(&row[whole..]);
                exp(V::load(rest.as_ptr()).sub(top).mul(scale)).store(rest.as_mut_ptr());
                row[whole..].copy_from_slice(&rest[..len - whole]);
                for (s, v) in sum_lanes.iter_mut().zip(&rest[..len - whole]) {
                    *s += v;
                }
            }
            *sum = sum_lanes.iter().sum();
        }
    }
    sums
}

/// Gradient of [`forward`] with respect to `qkv`; the scores are computed again.
///
/// # Shapes
/// `qkv`, `dqkv`: `[N, 3·C]` · `grad`: `[N, C]`
pub fn backward(
    qkv: &[f32],
    heads: Heads,
    patches: &Patches,
    order: &[u32],
    grad: &[f32],
    dqkv: &mut [f32],
) {
    let (c, dim) = (heads.channels(), heads.dim);
    assert_eq!(grad.len(), order.len() * c, "attention: gradient length");
    assert_eq!(dqkv.len(), qkv.len(), "attention: result length");
    dqkv.fill(0.0);
    let rows = slot_rows(patches, order);
    let target = SharedMut(dqkv.as_mut_ptr());
    // Own slots are written at once; borrowed ones are added afterwards, in a fixed order.
    let borrowed: Vec<(Patch, usize, Vec<f32>)> = tasks(patches, heads)
        .map_init(
            || (Scratch::new(dim, patches.longest), BackwardScratch::default()),
            |(s, b), (patch, head)| {
                let rows = &rows[patch.start..patch.start + patch.len];
                b.run(s, qkv, heads, head, rows, patch.own, grad, target);
                let len = patch.len;
                for (slot, &row) in rows[..patch.own].iter().enumerate() {
                    for (part, from) in [(1, &b.dk), (2, &b.dv)] {
                        // SAFETY: own rows and this head's channels are written by no one else.
                        let to = unsafe {
                            let at = row as usize * 3 * c + part * c + head * dim;
                            std::slice::from_raw_parts_mut(target.at(at), dim)
                        };
                        to.copy_from_slice(&from[slot * dim..(slot + 1) * dim]);
                    }
                }
                let mut rest = b.dk[patch.own * dim..len * dim].to_vec();
                rest.extend_from_slice(&b.dv[patch.own * dim..len * dim]);
                (patch, head, rest)
            },
        )
        .filter(|(_, _, rest)| !rest.is_empty())
        .collect();
    for (patch, head, rest) in borrowed {
        let slots = patch.len - patch.own;
        for (i, slot) in (patch.start + patch.own..patch.start + patch.len).enumerate() {
            for part in 0..2 {
                let at = rows[slot] as usize * 3 * c + (part + 1) * c + head * dim;
                let from = &rest[(part * slots + i) * dim..(part * slots + i + 1) * dim];
                for (d, v) in dqkv[at..at + dim].iter_mut().zip(from) {
                    *d += v;
                }
            }
        }
    }
}

#[derive(Default)]
struct BackwardScratch {
    dk: Vec<f32>,
    dv: Vec<f32>,
    /// Values as columns: `dP = dO · Vᵀ`.
    values: Option<PackedMatrix>,
    /// Keys as rows: `dQ = dS · K`.
    keys: Option<PackedMatrix>,
    small: Option<PackedMatrix>,
    dp: Vec<f32>,
    turned: Vec<f32>,
    block: Vec<f32>,
}

impl BackwardScratch {
    #[expect(clippy::too_many_arguments, reason = "one call site")]
    fn run(
        &mut self,
        s: &mut Scratch,
        qkv: &[f32],
        heads: Heads,
        head: usize,
        rows: &[u32],
        own: usize,
        grad: &[f32],
        target: SharedMut,
    ) {
        let (len, dim, c) = (rows.len(), heads.dim, heads.channels());
        s.pack_keys(qkv, heads, head, rows);
        let keys = self.keys.get_or_insert_with(PackedMatrix::empty);
        let values = self.values.get_or_insert_with(PackedMatrix::empty);
        let small = self.small.get_or_insert_with(PackedMatrix::empty);
        // `gathered` still holds the values.
        repack(values, &s.gathered[..len * dim], dim, len, 1, dim);
        s.gather(qkv, heads, head, rows, 1);
        repack(keys, &s.gathered[..len * dim], len, dim, dim, 1);
        for (v, n) in [(&mut self.dk, len * dim), (&mut self.dv, len * dim)] {
            v.clear();
            v.resize(n, 0.0);
        }
        self.dp.resize(QUERY_BLOCK * len, 0.0);
        self.turned.resize(QUERY_BLOCK * len, 0.0);
        self.block.resize(QUERY_BLOCK * dim, 0.0);
        for queries in rows[..own].chunks(QUERY_BLOCK) {
            let q = queries.len();
            s.scores(qkv, heads, head, queries);
            let probabilities = &mut s.scores[..q * len];
            let sums = softmax_rows(probabilities, len, heads.scale());
            for (row, sum) in probabilities.chunks_exact_mut(len).zip(&sums) {
                let inverse = 1.0 / sum;
                row.iter_mut().for_each(|p| *p *= inverse);
            }
            // SAFETY: the head's channels of a row lie inside `grad`; buffers are ours.
            unsafe {
                multiply_rows(
                    q,
                    RowPointers::Gathered {
                        base: grad.as_ptr().add(head * dim),
                        stride: c,
                        ids: queries,
                    },
                    values,
                    0..len.next_multiple_of(16),
                    RowPointersMut::Contiguous { base: self.dp.as_mut_ptr(), stride: len },
                    false,
                );
            }
            // dV += Pᵀ · dO
            let gather = |block: &mut [f32], from: &[f32], stride: usize| {
                for (to, &row) in block.chunks_exact_mut(dim).zip(queries) {
                    let at = row as usize * stride + head * dim;
                    to.copy_from_slice(&from[at..at + dim]);
                }
            };
            gather(&mut self.block, grad, c);
            add_turned(
                small,
                &mut self.turned,
                probabilities,
                &self.block,
                (q, len, dim),
                &mut self.dv,
            );
            // dS = P ∘ (dP − Σ P∘dP), scaled
            for (p, dp) in probabilities.chunks_exact(len).zip(self.dp.chunks_exact_mut(len)) {
                let dot: f64 = p.iter().zip(&*dp).map(|(p, d)| f64::from(p * d)).sum();
                for (p, d) in p.iter().zip(dp) {
                    *d = p * (*d - dot as f32) * heads.scale();
                }
            }
            // dK += dSᵀ · Q
            gather(&mut self.block, qkv, 3 * c);
            add_turned(
                small,
                &mut self.turned,
                &self.dp[..q * len],
                &self.block,
                (q, len, dim),
                &mut self.dk,
            );
            // dQ = dS · K, straight into the result.
            // SAFETY: own rows and this head's query channels are written by no one else.
            unsafe {
                multiply_rows(
                    q,
                    RowPointers::Contiguous { base: self.dp.as_ptr(), stride: len },
                    keys,
                    0..dim.next_multiple_of(16),
                    RowPointersMut::Scattered {
                        base: target.at(head * dim),
                        stride: 3 * c,
                        ids: queries,
                    },
                    false,
                );
            }
        }
    }
}

/// `out += aᵀ · b` for `a`: `[q, len]`, `b`: `[q, dim]`.
fn add_turned(
    packed: &mut PackedMatrix,
    turned: &mut [f32],
    a: &[f32],
    b: &[f32],
    (q, len, dim): (usize, usize, usize),
    out: &mut [f32],
) {
    for (i, row) in a.chunks_exact(len).enumerate() {
        for (j, v) in row.iter().enumerate() {
            turned[j * q + i] = *v;
        }
    }
    repack(packed, &b[..q * dim], q, dim, dim, 1);
    // SAFETY: `turned` holds `len` rows of `q`, `out` `len` rows of `dim`.
    unsafe {
        multiply_rows(
            len,
            RowPointers::Contiguous { base: turned.as_ptr(), stride: q },
            packed,
            0..dim.next_multiple_of(16),
            RowPointersMut::Contiguous { base: out.as_mut_ptr(), stride: dim },
            true,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::patches::cut;
    use crate::reference;
    use rand::{Rng, SeedableRng};

    fn random(len: usize, seed: u64, scale: f32) -> Vec<f32> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..len).map(|_| rng.random_range(-1.0..1.0f32) * scale).collect()
    }

    fn setup(counts: &[usize], k: usize) -> (Patches, Vec<u32>) {
        let mut offsets = vec![0];
        for n in counts {
            offsets.push(offsets[offsets.len() - 1] + n);
        }
        let n = offsets[counts.len()];
        // Any permutation inside each scene will do: reverse.
        let mut order = Vec::with_capacity(n);
        for s in offsets.windows(2) {
            order.extend((s[0]..s[1]).rev().map(|v| v as u32));
        }
        (cut(&offsets, k), order)
    }

    fn slow(qkv: &[f32], heads: Heads, patches: &Patches, order: &[u32]) -> Vec<f64> {
        let c = heads.channels();
        let mut out = vec![f64::NAN; order.len() * c];
        for p in &patches.patches {
            let rows: Vec<usize> = (p.start..p.start + p.len)
                .map(|s| order[patches.pad[s] as usize] as usize)
                .collect();
            let part = reference::attention_segment(qkv, heads.count, heads.dim, &rows);
            for (i, &row) in rows[..p.own].iter().enumerate() {
                out[row * c..(row + 1) * c].copy_from_slice(&part[i * c..(i + 1) * c]);
            }
        }
        out
    }

    #[test]
    fn agrees_with_f64_at_all_sizes_and_logit_scales() {
        for (counts, k, heads) in [
            (vec![1], 64, Heads { count: 2, dim: 16 }),
            (vec![2, 63], 64, Heads { count: 1, dim: 8 }),
            (vec![64, 65, 10, 200], 64, Heads { count: 2, dim: 48 }),
            (vec![129], 64, Heads { count: 3, dim: 12 }),
        ] {
            let (patches, order) = setup(&counts, k);
            for scale in [1e-20, 1.0, 60.0, 1e4] {
                let qkv = random(order.len() * 3 * heads.channels(), 1, scale);
                let mut out = vec![f32::NAN; order.len() * heads.channels()];
                forward(&qkv, heads, &patches, &order, &mut out);
                let want = slow(&qkv, heads, &patches, &order);
                let mut bad = 0;
                for (g, w) in out.iter().zip(&want) {
                    assert!(g.is_finite());
                    if (f64::from(*g) - w).abs() > 1e-4 * f64::from(scale) {
                        bad += 1;
                    }
                }
                // With logits of 1e8 two keys may tie within rounding; elsewhere none may differ.
                assert!(bad == 0 || scale > 1e3, "{counts:?} at {scale}: {bad}");
                assert!(bad * 50 <= out.len(), "{counts:?} at {scale}: {bad}");
            }
        }
    }

    #[test]
    fn gradients_agree_with_differences() {
        let heads = Heads { count: 2, dim: 4 };
        let (patches, order) = setup(&[5, 11, 3], 4);
        let qkv = random(order.len() * 24, 2, 1.0);
        let g = random(order.len() * 8, 3, 1.0);
        let mut dqkv = vec![f32::NAN; qkv.len()];
        backward(&qkv, heads, &patches, &order, &g, &mut dqkv);
        let loss = |qkv: &[f32]| -> f64 {
            slow(qkv, heads, &patches, &order).iter().zip(&g).map(|(o, g)| o * f64::from(*g)).sum()
        };
        for i in 0..qkv.len() {
            let h = 1e-2;
            let (mut up, mut down) = (qkv.clone(), qkv.clone());
            up[i] += h;
            down[i] -= h;
            let want = (loss(&up) - loss(&down)) / f64::from(up[i] - down[i]);
            assert!((f64::from(dqkv[i]) - want).abs() < 2e-4, "{i}: {} {want}", dqkv[i]);
        }
    }

    #[test]
    fn a_scene_does_not_feel_its_batch_mates() {
        let heads = Heads { count: 1, dim: 16 };
        let qkv = random(300 * 48, 4, 1.0);
        let (both, order) = setup(&[200, 100], 64);
        let mut together = vec![0.0; 300 * 16];
        forward(&qkv, heads, &both, &order, &mut together);
        let (one, order) = setup(&[200], 64);
        let mut alone = vec![0.0; 200 * 16];
        forward(&qkv[..200 * 48], heads, &one, &order, &mut alone);
        assert_eq!(alone, together[..200 * 16]);
    }
}

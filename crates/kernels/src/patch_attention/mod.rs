//! Softmax attention inside patches of the serialized order.
//!
//! One task works on one patch and head; scores exist for a small block at a time, so nothing of
//! size N × K is ever stored. Scores, softmax and sums are f32; a number near the largest score is
//! subtracted before the exponential, so logits of any finite size are safe. Where the definition
//! gives NaN or ±∞ (a NaN or ∞ among the inputs of the patch), so does this; other patches do not
//! notice. Sums over keys follow the order of the patch, so results are bit-identical for any number
//! of threads.

mod backward;
mod block;
mod forward;
#[cfg(target_arch = "x86_64")]
mod pairs;
mod softmax;
mod task;
#[cfg(test)]
mod tests;
mod tile;
mod weights;

pub use backward::backward;

use crate::gemm::SharedMut;
use crate::gemm::micro::Singles;
use crate::patches::Patches;
use crate::precision::Precision;
use crate::shape::elements;
use forward::{Scratch, attend};
use rayon::prelude::*;
use softmax::dispatch_softmax;
use task::Task;
use weights::Rounded;

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
    ///
    /// # Panics
    /// If a `usize` cannot count them.
    pub fn channels(self) -> usize {
        elements([self.count, self.dim])
    }

    /// `1 / √dim`
    fn scale(self) -> f32 {
        (1.0 / (self.dim as f64).sqrt()) as f32
    }

    /// `log₂e / √dim`: with it weights are powers of two.
    fn exponent_scale(self) -> f32 {
        (std::f64::consts::LOG2_E / (self.dim as f64).sqrt()) as f32
    }
}

/// Attention of every row to the rows of its patch, in f32.
///
/// `order[position]` is the row at that position of the serialized sequence.
///
/// # Shapes
/// `qkv`: `[N, 3·C]`, the channels of a row being q, k, v, each `[heads, dim]` ·
/// `order`: `[N]` · `out`: `[N, C]`
///
/// # Panics
/// If lengths do not fit each other or the patches, or `order` is no permutation (bugs of the caller).
pub fn forward(qkv: &[f32], heads: Heads, patches: &Patches, order: &[u32], out: &mut [f32]) {
    forward_with(Precision::F32, qkv, heads, patches, order, out);
}

/// [`forward`] in a precision.
///
/// With [`Precision::Bf16`] the scaled queries, keys, values and the weights before they are divided
/// by their sum are rounded to bf16; scores, exponentials and sums are f32. A weight of 8 bits moves
/// a result by up to 0.4 % of the largest value of the patch. [`Precision::F32Split`] computes as
/// `F32`, [`Precision::Int8`] as `Bf16`.
///
/// # Panics
/// As [`forward`].
pub fn forward_with(
    precision: Precision,
    qkv: &[f32],
    heads: Heads,
    patches: &Patches,
    order: &[u32],
    out: &mut [f32],
) {
    let c = heads.channels();
    let rounds = matches!(precision, Precision::Bf16 | Precision::Int8);
    assert_eq!(qkv.len(), elements([order.len(), 3, c]), "attention: qkv length");
    assert_eq!(out.len(), elements([order.len(), c]), "attention: output length");
    let rows = slot_rows(patches, order);
    if out.is_empty() {
        return;
    }
    let out = SharedMut(out.as_mut_ptr());
    // In all of these each row is owned by one patch, and each head has its own channels.
    #[cfg(target_arch = "x86_64")]
    if rounds && pairs::has_pairs() {
        return tasks(patches, heads).for_each_init(
            || Scratch::new(heads.dim, patches.longest()),
            |s, t| {
                let task = &Task::new(qkv, heads, patches, &rows, t);
                // SAFETY: the instruction set was asked for; disjoint writes as above.
                unsafe { pairs::attend_pairs(task, s, out) };
            },
        );
    }
    tasks(patches, heads).for_each_init(
        || Scratch::new(heads.dim, patches.longest()),
        |s, t| {
            let task = &Task::new(qkv, heads, patches, &rows, t);
            if rounds {
                dispatch_softmax!(
                    (task: &Task<'_>, s: &mut Scratch<f32>, out: SharedMut),
                    V, MR, NV => attend::<Rounded<V>, MR, NV>(task, s, out)
                );
            } else {
                dispatch_softmax!(
                    (task: &Task<'_>, s: &mut Scratch<f32>, out: SharedMut),
                    V, MR, NV => attend::<Singles<V>, MR, NV>(task, s, out)
                );
            }
        },
    );
}

/// Row of each slot. Checks that every row is the own row of one slot only, on which the parallel
/// writes rely, and that there is a slot for every row.
fn slot_rows(patches: &Patches, order: &[u32]) -> Vec<u32> {
    assert_eq!(patches.num_positions(), order.len(), "attention: positions of the patches");
    let rows: Vec<u32> = patches.pad().iter().map(|&p| order[p as usize]).collect();
    let mut owned = vec![false; order.len()];
    for patch in patches.patches() {
        assert!(patch.own <= patch.len, "attention: patch {patch:?}");
        for &row in &rows[patch.start..patch.start + patch.own] {
            let first = !std::mem::replace(&mut owned[row as usize], true);
            assert!(first, "attention: row {row} occurs twice; the order is no permutation");
        }
    }
    rows
}

/// One task for each patch and head.
fn tasks(patches: &Patches, heads: Heads) -> impl IndexedParallelIterator<Item = usize> {
    (0..elements([patches.patches().len(), heads.count])).into_par_iter()
}

//! Attention of the tokens of each phrase to each other.

use rayon::prelude::*;
use scenesplat_kernels::activation::exp_in_place;

/// `softmax(q·kᵀ / √d) · v` in each phrase and head.
///
/// # Shapes
/// `qkv`: `[Σ lengths, 3 · width]` · returns `[Σ lengths, width]`
pub(super) fn attend(qkv: &[f32], lengths: &[usize], heads: usize, width: usize) -> Vec<f32> {
    let mut out = vec![0.0; qkv.len() / 3];
    let mut phrases = Vec::with_capacity(lengths.len());
    let (mut from, mut rest) = (qkv, &mut out[..]);
    for &length in lengths {
        let (own, others) = from.split_at(length * 3 * width);
        let (own_out, others_out) = rest.split_at_mut(length * width);
        phrases.push((own, own_out));
        (from, rest) = (others, others_out);
    }
    phrases.into_par_iter().for_each(|(qkv, out)| attend_one(qkv, heads, width, out));
    out
}

fn attend_one(qkv: &[f32], heads: usize, width: usize, out: &mut [f32]) {
    let dim = width / heads;
    let scale = 1.0 / (dim as f32).sqrt();
    let tokens = out.len() / width;
    let mut weights = vec![0.0; tokens];
    for head in 0..heads {
        let part =
            |row: usize, third: usize| &qkv[row * 3 * width + third * width + head * dim..][..dim];
        for (i, out) in out.chunks_exact_mut(width).enumerate() {
            let query = part(i, 0);
            for (j, weight) in weights.iter_mut().enumerate() {
                *weight = scale * query.iter().zip(part(j, 1)).map(|(q, k)| q * k).sum::<f32>();
            }
            let top = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            weights.iter_mut().for_each(|w| *w -= top);
            exp_in_place(&mut weights);
            let sum: f32 = weights.iter().sum();
            let out = &mut out[head * dim..][..dim];
            for (j, weight) in weights.iter().enumerate() {
                let weight = weight / sum;
                out.iter_mut().zip(part(j, 2)).for_each(|(o, v)| *o += weight * v);
            }
        }
    }
}

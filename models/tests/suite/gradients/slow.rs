//! Every operation from its formula, in f64.

use scenesplat_kernels::patch_attention::Heads;
use scenesplat_kernels::patches::Patches;
use scenesplat_kernels::segment::{Groups, Reduce};
use scenesplat_kernels::serialized_cloud::SerializedCloud;
use scenesplat_test_support::reference;

/// `x · Wᵀ + b`; `w`: `[m, k]`
pub fn linear(x: &[f64], k: usize, w: &[f64], b: Option<&[f64]>) -> Vec<f64> {
    let rows = x.chunks_exact(k);
    rows.flat_map(|x| {
        w.chunks_exact(k).enumerate().map(move |(j, w)| {
            let dot: f64 = x.iter().zip(w).map(|(x, w)| x * w).sum();
            dot + b.map_or(0.0, |b| b[j])
        })
    })
    .collect()
}

pub fn gelu(x: &[f64]) -> Vec<f64> {
    x.iter().map(|v| reference::gelu(*v)).collect()
}

pub fn add(x: &[f64], y: &[f64]) -> Vec<f64> {
    x.iter().zip(y).map(|(x, y)| x + y).collect()
}

/// Adds rows times their factor.
pub fn add_scaled(x: &[f64], factors: &[f64], y: &[f64]) -> Vec<f64> {
    let c = x.len() / factors.len();
    (0..x.len()).map(|i| x[i] * factors[i / c] + y[i]).collect()
}

pub fn layer_norm(x: &[f64], w: &[f64], b: &[f64]) -> Vec<f64> {
    let c = w.len();
    let mut out = Vec::new();
    for row in x.chunks_exact(c) {
        let mean = row.iter().sum::<f64>() / c as f64;
        let var = row.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / c as f64;
        out.extend((0..c).map(|j| (row[j] - mean) / (var + 1e-5).sqrt() * w[j] + b[j]));
    }
    out
}

/// With statistics of the batch, or with given ones.
pub fn batch_norm(x: &[f64], w: &[f64], b: &[f64], given: Option<(&[f64], &[f64])>) -> Vec<f64> {
    let c = w.len();
    let n = (x.len() / c) as f64;
    let mut out = vec![0.0; x.len()];
    for j in 0..c {
        let column = || x.iter().skip(j).step_by(c);
        let (mean, var) = given.map_or_else(
            || {
                let mean = column().sum::<f64>() / n;
                (mean, column().map(|v| (v - mean).powi(2)).sum::<f64>() / n)
            },
            |(mean, var)| (mean[j], var[j]),
        );
        for (i, v) in column().enumerate() {
            out[i * c + j] = (v - mean) / (var + 1e-3).sqrt() * w[j] + b[j];
        }
    }
    out
}

pub fn l2_normalize(x: &[f64], c: usize) -> Vec<f64> {
    let unit = |row: &[f64]| {
        let norm = row.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-12);
        row.iter().map(|v| v / norm).collect::<Vec<_>>()
    };
    x.chunks_exact(c).flat_map(unit).collect()
}

/// `w`: `[out, k, k, k, in]`
pub fn conv(
    x: &[f64],
    cin: usize,
    w: &[f64],
    b: Option<&[f64]>,
    cloud: &SerializedCloud,
    k: usize,
) -> Vec<f64> {
    let taps = k.pow(3);
    let cout = w.len() / taps / cin;
    let mut out: Vec<f64> =
        (0..cloud.len() * cout).map(|i| b.map_or(0.0, |b| b[i % cout])).collect();
    for (tap, from, to) in reference::kernel_pairs(cloud.grid_coord(), cloud.offsets(), k as i32) {
        let x = &x[from as usize * cin..][..cin];
        for o in 0..cout {
            let w = &w[(o * taps + tap) * cin..][..cin];
            out[to as usize * cout + o] += x.iter().zip(w).map(|(x, w)| x * w).sum::<f64>();
        }
    }
    out
}

pub fn attention(qkv: &[f64], heads: Heads, patches: &Patches, order: &[u32]) -> Vec<f64> {
    let (c, dim) = (heads.channels(), heads.dim);
    let mut out = vec![f64::NAN; order.len() * c];
    for patch in patches.patches() {
        let slots = patch.start..patch.start + patch.len;
        let rows: Vec<usize> = slots.map(|s| order[patches.pad()[s] as usize] as usize).collect();
        for (&query, h) in
            rows[..patch.own].iter().flat_map(|q| (0..heads.count).map(move |h| (q, h)))
        {
            let part = |row: usize, part: usize| &qkv[row * 3 * c + part * c + h * dim..][..dim];
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let logit = |key: &usize| dot(part(query, 0), part(*key, 1)) / (dim as f64).sqrt();
            let weights: Vec<f64> = rows.iter().map(|key| logit(key).exp()).collect();
            let total: f64 = weights.iter().sum();
            for d in 0..dim {
                let values = rows.iter().zip(&weights).map(|(&key, w)| w / total * part(key, 2)[d]);
                out[query * c + h * dim + d] = values.sum();
            }
        }
    }
    out
}

pub fn reduce(x: &[f64], c: usize, groups: &Groups, how: Reduce) -> Vec<f64> {
    let mut out = Vec::new();
    for span in groups.offsets().windows(2) {
        let rows = &groups.rows()[span[0] as usize..span[1] as usize];
        for j in 0..c {
            let values = rows.iter().map(|r| x[*r as usize * c + j]);
            out.push(match how {
                Reduce::Sum => values.sum(),
                Reduce::Mean => values.sum::<f64>() / rows.len() as f64,
                Reduce::Max => values.fold(f64::NEG_INFINITY, f64::max),
            });
        }
    }
    out
}

/// Row `index[i]` at place i.
pub fn gather(x: &[f64], c: usize, index: &[u32]) -> Vec<f64> {
    index.iter().flat_map(|i| x[*i as usize * c..][..c].to_vec()).collect()
}

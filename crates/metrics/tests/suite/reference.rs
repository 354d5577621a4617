//! Slow, obvious versions of this crate's algorithms. Only tests call them.

use crate::IGNORE;
use scenesplat_kernels::neighbors::distance_squared;
use std::collections::BTreeMap;

/// Rows of the `k` nearest points: all distances, sorted by (distance, row).
pub fn nearest(coord: &[[f32; 3]], query: [f32; 3], k: usize) -> Vec<u32> {
    let mut all: Vec<(f64, u32)> =
        coord.iter().zip(0..).map(|(&c, row)| (distance_squared(c, query), row)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.into_iter().take(k).map(|(_, row)| row).collect()
}

/// As [`vote`](crate::vote), by sorting all distances for each query.
pub fn vote(
    reference: &[[f32; 3]],
    labels: &[i32],
    valid: Option<&[bool]>,
    query: &[[f32; 3]],
    k: usize,
) -> Vec<i32> {
    let rows: Vec<usize> = (0..reference.len()).filter(|&r| valid.is_none_or(|v| v[r])).collect();
    let coord: Vec<[f32; 3]> = rows.iter().map(|&r| reference[r]).collect();
    query
        .iter()
        .map(|&q| {
            let mut votes = BTreeMap::new();
            for near in nearest(&coord, q, k) {
                *votes.entry(labels[rows[near as usize]]).or_insert(0_usize) += 1;
            }
            votes.remove(&IGNORE);
            let most = votes.values().max().copied();
            votes.iter().find(|&(_, &n)| Some(n) == most).map_or(IGNORE, |(&label, _)| label)
        })
        .collect()
}

/// Cosine in f64; `None` where either row has no direction.
pub fn cosine(a: &[f32], b: &[f32]) -> Option<f64> {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum()
    };
    let norms = (dot(a, a) * dot(b, b)).sqrt();
    // The product of two squared norms of 1e-45 underflows even in f64.
    let norms = if norms == 0.0 { dot(a, a).sqrt() * dot(b, b).sqrt() } else { norms };
    (norms.is_finite() && norms > 0.0).then(|| dot(a, b) / norms)
}

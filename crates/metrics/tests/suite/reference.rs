//! Slow versions of what the crate computes.

use scenesplat_metrics::IGNORE;
use scenesplat_metrics::image::{ImageView, SsimPadding};
use std::collections::BTreeMap;

/// Rows of the `k` nearest points: all squared distances in f64, sorted by (distance, row).
pub fn nearest(coord: &[[f32; 3]], query: [f32; 3], k: usize) -> Vec<u32> {
    let squared = |c: [f32; 3]| {
        let [x, y, z] = std::array::from_fn(|i| (f64::from(c[i]) - f64::from(query[i])).powi(2));
        x + y + z
    };
    let mut all: Vec<(f64, u32)> = coord.iter().map(|c| squared(*c)).zip(0..).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    all.into_iter().take(k).map(|(_, row)| row).collect()
}

/// As `vote`, by sorting all distances for each query.
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

/// Cosine in f64, of rows with a direction.
pub fn cosine(a: &[f32], b: &[f32]) -> f64 {
    let dot = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum()
    };
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
}

/// SSIM by its definition: a 2-D window around each pixel, everything f64.
pub fn ssim(pred: ImageView<'_>, truth: ImageView<'_>, padding: SsimPadding) -> f64 {
    let (width, height, channels) =
        (pred.width() as i64, pred.height() as i64, pred.channels() as i64);
    let gauss = |d: i64| (-(d * d) as f64 / 4.5).exp();
    let norm: f64 = (-5..=5).map(gauss).sum();
    let mirror = |i: i64, len: i64| {
        if i < 0 {
            -i
        } else if i >= len {
            2 * (len - 1) - i
        } else {
            i
        }
    };
    let cut = if padding == SsimPadding::Valid { 5 } else { 0 };
    let (mut sum, mut count) = (0.0, 0.0);
    for y in cut..height - cut {
        for x in cut..width - cut {
            for c in 0..channels {
                let mut m = [0.0; 5];
                for dy in -5..=5 {
                    for dx in -5..=5 {
                        let (mut yy, mut xx) = (y + dy, x + dx);
                        if padding == SsimPadding::Reflect {
                            (yy, xx) = (mirror(yy, height), mirror(xx, width));
                        }
                        if !(0..height).contains(&yy) || !(0..width).contains(&xx) {
                            continue;
                        }
                        let at = ((yy * width + xx) * channels + c) as usize;
                        let (a, b) = (f64::from(pred.values()[at]), f64::from(truth.values()[at]));
                        let w = gauss(dy) * gauss(dx) / (norm * norm);
                        for (m, v) in m.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                            *m += w * v;
                        }
                    }
                }
                let [m1, m2, aa, bb, ab] = m;
                let (mut v1, mut v2) = (aa - m1 * m1, bb - m2 * m2);
                if padding == SsimPadding::Reflect {
                    (v1, v2) = (v1.max(0.0), v2.max(0.0));
                }
                sum += (2.0 * m1 * m2 + 1e-4) * (2.0 * (ab - m1 * m2) + 9e-4)
                    / ((m1 * m1 + m2 * m2 + 1e-4) * (v1 + v2 + 9e-4));
                count += 1.0;
            }
        }
    }
    sum / count
}

//! The same results in f64, for some rows, the slow way.

use super::report::Accuracy;
use rayon::prelude::*;
use scenesplat::kernels::kernel_map::KernelMap;
use std::collections::HashMap;

/// `count` rows of `n`, evenly spaced.
pub(super) fn some_rows(n: usize, count: usize) -> Vec<usize> {
    let count = count.min(n);
    (0..count).map(|i| (2 * i + 1) * n / (2 * count)).collect()
}

/// Root of the summed squared differences over that of `better`.
pub(super) fn relative_error(got: &[f32], better: &[f64]) -> f64 {
    let (mut difference, mut size) = (0.0, 0.0);
    for (&g, &b) in got.iter().zip(better) {
        difference += (f64::from(g) - b).powi(2);
        size += b * b;
    }
    // NaN and infinity stay visible; two zeros agree.
    if difference == 0.0 { 0.0 } else { (difference / size).sqrt() }
}

/// Accuracy of the given rows of `out`, `[N, c]`, against their f64 values.
pub(super) fn against_f64(out: &[f32], c: usize, rows: &[usize], better: &[f64]) -> Accuracy {
    let got: Vec<f32> = rows.iter().flat_map(|&r| &out[r * c..(r + 1) * c]).copied().collect();
    Accuracy {
        max_error: relative_error(&got, better),
        against: format!("f64, {} rows", rows.len()),
        cosine_median: None,
        cosine_p01: None,
    }
}

/// Accuracy of rows in less than f32 against those in f32, `[N, c]` both; `what` they are.
pub(super) fn against_f32(got: &[f32], better: &[f32], c: usize, what: &str) -> Accuracy {
    let wide: Vec<f64> = better.iter().map(|&v| f64::from(v)).collect();
    let cosine = |(a, b): (&[f32], &[f64])| {
        let (mut product, mut x, mut y) = (0.0, 0.0, 0.0);
        for (&a, &b) in a.iter().zip(b) {
            let a = f64::from(a);
            product += a * b;
            x += a * a;
            y += b * b;
        }
        if x == y && x == 0.0 { 1.0 } else { product / (x * y).sqrt() }
    };
    let mut cosines: Vec<f64> = got.chunks_exact(c).zip(wide.chunks_exact(c)).map(cosine).collect();
    // NaN is the worst of all.
    cosines.sort_by(|a, b| b.is_nan().cmp(&a.is_nan()).then(a.total_cmp(b)));
    Accuracy {
        max_error: relative_error(got, &wide),
        against: format!("f32, {} {what}", cosines.len()),
        cosine_median: cosines.get(cosines.len() / 2).copied(),
        cosine_p01: cosines.get(cosines.len() / 100).copied(),
    }
}

/// Share of entries found wrong.
pub(super) fn wrong_share(wrong: usize, of: usize, what: &str) -> Accuracy {
    Accuracy {
        max_error: wrong as f64 / of.max(1) as f64,
        against: format!("{what}, {of} checked"),
        cosine_median: None,
        cosine_p01: None,
    }
}

fn dot(a: &[f64], b: &[f32]) -> f64 {
    // Eight sums side by side, which the compiler turns into vectors.
    let mut sums = [0.0; 8];
    let (a, a_rest) = a.as_chunks::<8>();
    let (b, b_rest) = b.as_chunks::<8>();
    for (a, b) in a.iter().zip(b) {
        for i in 0..8 {
            sums[i] += a[i] * f64::from(b[i]);
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * f64::from(*b)).sum();
    sums.iter().sum::<f64>() + rest
}

/// `x · Wᵀ + b`. `x`: `[m, k]` · `weight`: `[n, k]` · `bias`: `[n]` or empty · result `[m, n]`
pub(super) fn linear(x: &[f64], k: usize, weight: &[f32], bias: &[f32]) -> Vec<f64> {
    let n = weight.len() / k;
    let mut out = vec![0.0; x.len() / k * n];
    out.par_chunks_mut(n).zip(x.par_chunks(k)).for_each(|(out, x)| {
        for (j, out) in out.iter_mut().enumerate() {
            let bias = bias.get(j).map_or(0.0, |b| f64::from(*b));
            *out = dot(x, &weight[j * k..(j + 1) * k]) + bias;
        }
    });
    out
}

/// Rows of a matrix as f64.
pub(super) fn widened(x: &[f32], c: usize, rows: impl IntoIterator<Item = usize>) -> Vec<f64> {
    rows.into_iter().flat_map(|r| &x[r * c..(r + 1) * c]).map(|&v| f64::from(v)).collect()
}

/// Some rows of a convolution. `x`: `[N, cin]` · `weight`: `[cout, taps, cin]` · result
/// `[rows, cout]`
pub(super) fn convolution(
    map: &KernelMap,
    x: &[f32],
    weight: &[f32],
    bias: &[f32],
    rows: &[usize],
) -> Vec<f64> {
    let (taps, cout) = (map.taps(), bias.len());
    let cin = weight.len() / (taps * cout);
    let slots: HashMap<u32, usize> = rows.iter().enumerate().map(|(i, &r)| (r as u32, i)).collect();
    let mut pairs = vec![Vec::new(); rows.len()];
    for tap in 0..taps {
        let (input, output) = map.tap_pairs(tap);
        for (i, o) in input.into_iter().zip(output) {
            if let Some(&slot) = slots.get(&o) {
                pairs[slot].push((tap, i as usize));
            }
        }
    }
    let mut out = vec![0.0; rows.len() * cout];
    out.par_chunks_mut(cout).zip(&pairs).for_each(|(out, pairs)| {
        for (out, &b) in out.iter_mut().zip(bias) {
            *out = f64::from(b);
        }
        for &(tap, input) in pairs {
            let x = widened(x, cin, [input]);
            for (o, out) in out.iter_mut().enumerate() {
                *out += dot(&x, &weight[(o * taps + tap) * cin..][..cin]);
            }
        }
    });
    out
}

/// Attention of some queries over the keys and values of one patch. `query`: `[m, c]` ·
/// `key`, `value`: `[len, c]` · result `[m, c]`
pub(super) fn attention(
    query: &[f64],
    key: &[f64],
    value: &[f64],
    c: usize,
    heads: usize,
) -> Vec<f64> {
    let dim = c / heads;
    let scale = 1.0 / (dim as f64).sqrt();
    let mut out = vec![0.0; query.len()];
    out.par_chunks_mut(c).zip(query.par_chunks(c)).for_each(|(out, query)| {
        for head in 0..heads {
            let part = head * dim..(head + 1) * dim;
            let scores: Vec<f64> = key
                .chunks_exact(c)
                .map(|k| {
                    let of_head = query[part.clone()].iter().zip(&k[part.clone()]);
                    of_head.map(|(q, k)| q * k).sum::<f64>() * scale
                })
                .collect();
            let top = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let weights: Vec<f64> = scores.iter().map(|s| (s - top).exp()).collect();
            let total: f64 = weights.iter().sum();
            for (weight, v) in weights.iter().zip(value.chunks_exact(c)) {
                for (out, v) in out[part.clone()].iter_mut().zip(&v[part.clone()]) {
                    *out += weight / total * v;
                }
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_test_support::reference;

    fn values(n: usize, seed: u64) -> Vec<f32> {
        scenesplat::kernels::bench_room::values(n, seed)
    }

    #[test]
    fn the_slow_ways_agree_with_slower_ones() {
        let (c, heads) = (12, 3);
        let qkv = values(5 * 3 * c, 1);
        let part = |p: usize| -> Vec<f64> {
            (0..5).flat_map(|r| widened(&qkv[r * 3 * c + p * c..][..c], c, [0])).collect()
        };
        let got = attention(&part(0), &part(1), &part(2), c, heads);
        let want = reference::attention_segment(&qkv, heads, c / heads, &[0, 1, 2, 3, 4]);
        assert!(got.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-12));

        let grid = scenesplat::kernels::bench_room::voxels(200);
        let map = KernelMap::build(&grid, &[0, 200], 3).unwrap();
        let (x, weight, bias) = (values(200 * 9, 2), values(5 * 27 * 9, 3), values(5, 4));
        let rows = some_rows(200, 20);
        let got = convolution(&map, &x, &weight, &bias, &rows);
        let all = reference::submanifold_conv(&grid, &[0, 200], &x, 9, &weight, Some(&bias), 3);
        let want: Vec<f64> = rows.iter().flat_map(|r| &all[r * 5..(r + 1) * 5]).copied().collect();
        assert!(got.iter().zip(&want).all(|(a, b)| (a - b).abs() < 1e-12));

        let got = linear(&widened(&x, 9, 0..7), 9, &weight[..4 * 9], &bias[..4]);
        let products = reference::matmul_nt(&x[..63], &weight[..36], 7, 9, 4);
        let want = products.iter().enumerate().map(|(i, v)| v + f64::from(bias[i % 4]));
        assert!(got.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn rows_are_spread_and_errors_are_relative() {
        assert_eq!(some_rows(10, 5), [1, 3, 5, 7, 9]);
        assert_eq!(some_rows(2, 5), [0, 1]);
        assert!(some_rows(0, 5).is_empty());
        assert_eq!(relative_error(&[3.0, 4.0], &[0.0, 4.0]), 0.75);
        assert_eq!(relative_error(&[0.0], &[0.0]), 0.0);
        assert!(relative_error(&[f32::NAN], &[1.0]).is_nan());
        let seen = against_f32(
            &[1.0, 0.0, 0.0, 0.0, f32::NAN, 1.0],
            &[1.0, 1.0, 0.0, 0.0, 1.0, 1.0],
            2,
            "rows",
        );
        assert!(seen.cosine_p01.unwrap().is_nan());
        assert!((seen.cosine_median.unwrap() - 0.5f64.sqrt()).abs() < 1e-12);
    }
}

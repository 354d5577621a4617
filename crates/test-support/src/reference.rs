//! Slow, obvious versions of the kernels in f64.

/// `a · wᵀ`: `[m, k] × [n, k] → [m, n]`.
pub fn matmul_nt(a: &[f32], w: &[f32], m: usize, k: usize, n: usize) -> Vec<f64> {
    let mut out = vec![0.0; m * n];
    for i in 0..m {
        for j in 0..n {
            out[i * n + j] =
                (0..k).map(|p| f64::from(a[i * k + p]) * f64::from(w[j * k + p])).sum();
        }
    }
    out
}

/// `aᵀ · b`: `[rows, m] × [rows, n] → [m, n]`.
pub fn matmul_tn(a: &[f32], b: &[f32], rows: usize, m: usize, n: usize) -> Vec<f64> {
    let mut out = vec![0.0; m * n];
    for r in 0..rows {
        for i in 0..m {
            for j in 0..n {
                out[i * n + j] += f64::from(a[r * m + i]) * f64::from(b[r * n + j]);
            }
        }
    }
    out
}

/// The error function: Taylor series near 0, continued fraction of the complement beyond.
pub fn erf(x: f64) -> f64 {
    let z = x.abs();
    let value = if z < 3.0 {
        let mut term = z;
        let mut sum = z;
        let mut n = 0.0;
        while term.abs() > 1e-18 * sum.abs().max(1e-300) {
            n += 1.0;
            term *= -z * z / n;
            sum += term / (2.0 * n + 1.0);
        }
        sum * 2.0 / std::f64::consts::PI.sqrt()
    } else {
        let mut fraction = z;
        for k in (1..=80).rev() {
            fraction = z + f64::from(k) / 2.0 / fraction;
        }
        1.0 - (-z * z).exp() / (fraction * std::f64::consts::PI.sqrt())
    };
    value.copysign(x)
}

/// Standard normal distribution function, accurate in the tail.
pub fn normal_cdf(x: f64) -> f64 {
    let z = -x / std::f64::consts::SQRT_2;
    if z < 3.0 {
        return 0.5 * (1.0 - erf(z));
    }
    let fraction = (1..=80).rev().fold(z, |f, k| z + f64::from(k) / 2.0 / f);
    0.5 * (-z * z).exp() / (fraction * std::f64::consts::PI.sqrt())
}

/// Exact GELU.
pub fn gelu(x: f64) -> f64 {
    x * normal_cdf(x)
}

/// LayerNorm of each row. `x`: `[m, c]`
pub fn layer_norm(x: &[f32], c: usize, weight: &[f32], bias: &[f32], eps: f64) -> Vec<f64> {
    let mut out = Vec::with_capacity(x.len());
    for row in x.chunks_exact(c) {
        let mean = row.iter().map(|v| f64::from(*v)).sum::<f64>() / c as f64;
        let var = row.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / c as f64;
        for (j, v) in row.iter().enumerate() {
            let unit = (f64::from(*v) - mean) / (var + eps).sqrt();
            out.push(unit * f64::from(weight[j]) + f64::from(bias[j]));
        }
    }
    out
}

/// Pairs of a submanifold convolution as (tap, input row, output row), sorted, by comparing every two
/// voxels of a scene.
pub fn kernel_pairs(grid: &[[i32; 3]], offsets: &[usize], k: i32) -> Vec<(usize, u32, u32)> {
    let mut out = Vec::new();
    for s in offsets.windows(2) {
        for p in s[0]..s[1] {
            for q in s[0]..s[1] {
                let d: [i32; 3] = std::array::from_fn(|a| grid[q][a] - grid[p][a] + k / 2);
                if d.iter().all(|v| (0..k).contains(v)) {
                    out.push((((d[0] * k + d[1]) * k + d[2]) as usize, q as u32, p as u32));
                }
            }
        }
    }
    out.sort_unstable();
    out
}

/// Batch normalization with the batch's own statistics. `x`: `[N, C]`
pub fn batch_norm(x: &[f32], weight: &[f32], bias: &[f32], eps: f64) -> Vec<f64> {
    let c = weight.len();
    let n = x.len() / c;
    let at = |i: usize, j: usize| f64::from(x[i * c + j]);
    let mut out = vec![0.0; x.len()];
    for j in 0..c {
        let mean = (0..n).map(|i| at(i, j)).sum::<f64>() / n as f64;
        let var = (0..n).map(|i| (at(i, j) - mean).powi(2)).sum::<f64>() / n as f64;
        for i in 0..n {
            let unit = (at(i, j) - mean) / (var + eps).sqrt();
            out[i * c + j] = unit * f64::from(weight[j]) + f64::from(bias[j]);
        }
    }
    out
}

/// Mean (or maximum) of the rows with the same group number. `x`: `[N, C]` → `[groups, C]`
pub fn pool(x: &[f32], c: usize, group: &[u32], groups: usize, max: bool) -> Vec<f64> {
    let mut out = vec![if max { f64::NEG_INFINITY } else { 0.0 }; groups * c];
    let mut count = vec![0.0; groups];
    for (i, &g) in group.iter().enumerate() {
        count[g as usize] += 1.0;
        for j in 0..c {
            let (v, o) = (f64::from(x[i * c + j]), &mut out[g as usize * c + j]);
            *o = if max { o.max(v) } else { *o + v };
        }
    }
    if !max {
        for (row, n) in out.chunks_exact_mut(c).zip(&count) {
            row.iter_mut().for_each(|v| *v /= n);
        }
    }
    out
}

/// Submanifold convolution by looking at every pair of voxels of the same scene.
///
/// # Shapes
/// `grid_coord`: `[N, 3]` · `offsets`: `[B + 1]` · `x`: `[N, cin]` ·
/// `weight`: `[cout, k, k, k, cin]` · result `[N, cout]`
pub fn submanifold_conv(
    grid_coord: &[[i32; 3]],
    offsets: &[usize],
    x: &[f32],
    cin: usize,
    weight: &[f32],
    bias: Option<&[f32]>,
    kernel_size: usize,
) -> Vec<f64> {
    let taps = kernel_size.pow(3);
    let cout = weight.len() / (taps * cin);
    let half = kernel_size as i32 / 2;
    let mut out = vec![0.0; grid_coord.len() * cout];
    for scene in offsets.windows(2) {
        for p in scene[0]..scene[1] {
            for q in scene[0]..scene[1] {
                let d: [i32; 3] =
                    std::array::from_fn(|a| grid_coord[q][a].wrapping_sub(grid_coord[p][a]));
                if d.iter().any(|v| v.unsigned_abs() > half as u32) {
                    continue;
                }
                let tap = d.iter().fold(0, |t, v| t * kernel_size + (v + half) as usize);
                for o in 0..cout {
                    for i in 0..cin {
                        out[p * cout + o] += f64::from(weight[(o * taps + tap) * cin + i])
                            * f64::from(x[q * cin + i]);
                    }
                }
            }
            for o in 0..cout {
                out[p * cout + o] += bias.map_or(0.0, |b| f64::from(b[o]));
            }
        }
    }
    out
}

/// Softmax attention among the given rows of `qkv` (`[N, 3·heads·dim]`), one segment after another.
///
/// `segments` lists the rows whose keys are seen; the output of each segment is written for its
/// own rows only (`own` = how many leading or trailing slots count is decided by the caller).
pub fn attention_segment(qkv: &[f32], heads: usize, dim: usize, rows: &[usize]) -> Vec<f64> {
    let c = heads * dim;
    let at = |row: usize, part: usize, h: usize, d: usize| {
        f64::from(qkv[row * 3 * c + part * c + h * dim + d])
    };
    let mut out = vec![0.0; rows.len() * c];
    for h in 0..heads {
        for (i, &q) in rows.iter().enumerate() {
            let scores: Vec<f64> = rows
                .iter()
                .map(|&k| {
                    (0..dim).map(|d| at(q, 0, h, d) * at(k, 1, h, d)).sum::<f64>()
                        / (dim as f64).sqrt()
                })
                .collect();
            let top = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let weights: Vec<f64> = scores.iter().map(|s| (s - top).exp()).collect();
            let total: f64 = weights.iter().sum();
            for (w, &k) in weights.iter().zip(rows) {
                for d in 0..dim {
                    out[i * c + h * dim + d] += w / total * at(k, 2, h, d);
                }
            }
        }
    }
    out
}

/// Queries and keys of `qkv` (`[N, 3·heads·dim]`) turned by their voxels' numbers, values as they are.
pub fn point_rope(
    qkv: &[f32],
    grid_coord: &[[i32; 3]],
    heads: usize,
    dim: usize,
    base: f64,
) -> Vec<f64> {
    let third = dim / 6;
    let mut out: Vec<f64> = qkv.iter().map(|v| f64::from(*v)).collect();
    for (row, place) in grid_coord.iter().enumerate() {
        for head in 0..2 * heads {
            for axis in 0..3 {
                for i in 0..third {
                    let angle = f64::from(place[axis]) / base.powf(i as f64 / third as f64);
                    let u = (row * 3 * heads + head) * dim + 2 * axis * third + i;
                    let v = u + third;
                    let (a, b) = (out[u], out[v]);
                    out[u] = a * angle.cos() - b * angle.sin();
                    out[v] = b * angle.cos() + a * angle.sin();
                }
            }
        }
    }
    out
}

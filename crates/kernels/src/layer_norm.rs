//! Layer normalization over the channels of each row.
//!
//! `y = (x − mean) / √(var + ε) · weight + bias`, biased variance, two passes over the cached row.
//! A row whose variance overflows f32 is normalized in f64 instead; a row with NaN or ±∞ is NaN.

use crate::simd::{Vector, dispatch};
use rayon::prelude::*;

/// Rows that one task works on; also the stretch of one partial sum of the parameter gradients.
const BLOCK: usize = 512;

/// Mean and `1 / √(var + ε)` of a row.
#[inline(always)]
fn statistics(row: &[f32], eps: f32) -> (f32, f32) {
    let count = row.len() as f32;
    let mean = lane_sum(row, |v| v) / count;
    let var = lane_sum(row, |v| (v - mean) * (v - mean)) / count;
    if var.is_finite() {
        return (mean, 1.0 / (var + eps).sqrt());
    }
    let count = row.len() as f64;
    let mean = row.iter().map(|v| f64::from(*v)).sum::<f64>() / count;
    let var = row.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / count;
    (mean as f32, (1.0 / (var + f64::from(eps)).sqrt()) as f32)
}

/// Sums `f` over a row in sixteen interleaved chains, then the chains in order.
#[inline(always)]
fn lane_sum(row: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0f32; 16];
    let chunks = row.chunks_exact(16);
    let rest = chunks.remainder();
    for chunk in chunks {
        for (l, v) in lanes.iter_mut().zip(chunk) {
            *l += f(*v);
        }
    }
    for (l, v) in lanes.iter_mut().zip(rest) {
        *l += f(*v);
    }
    let pairs: [f32; 8] = std::array::from_fn(|i| lanes[i] + lanes[i + 8]);
    let quads: [f32; 4] = std::array::from_fn(|i| pairs[i] + pairs[i + 4]);
    (quads[0] + quads[2]) + (quads[1] + quads[3])
}

#[inline(always)]
unsafe fn normalise<V: Vector>(
    x: &[f32],
    residual: Option<&[f32]>,
    weight: &[f32],
    bias: &[f32],
    eps: f32,
    out: &mut [f32],
) {
    let c = weight.len();
    for (i, (row, out)) in x.chunks_exact(c).zip(out.chunks_exact_mut(c)).enumerate() {
        let (mean, inverse) = statistics(row, eps);
        for j in 0..c {
            out[j] = (row[j] - mean) * inverse * weight[j] + bias[j];
        }
        if let Some(residual) = residual {
            for (o, r) in out.iter_mut().zip(&residual[i * c..(i + 1) * c]) {
                *o += r;
            }
        }
    }
}

/// `out = LayerNorm(x) [+ residual]`.
///
/// # Shapes
/// `x`, `residual`, `out`: `[N, C]` · `weight`, `bias`: `[C]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn forward(
    x: &[f32],
    residual: Option<&[f32]>,
    weight: &[f32],
    bias: &[f32],
    eps: f32,
    out: &mut [f32],
) {
    let c = weight.len();
    assert_eq!((bias.len(), out.len()), (c, x.len()), "layer norm: bias and output lengths");
    assert!(residual.is_none_or(|r| r.len() == x.len()), "layer norm: residual length");
    if c == 0 {
        return;
    }
    assert!(x.len().is_multiple_of(c), "layer norm: rows of {c} channels");
    out.par_chunks_mut(BLOCK * c).zip(x.par_chunks(BLOCK * c)).enumerate().for_each(
        |(block, (out, x))| {
            let residual = residual.map(|r| &r[block * BLOCK * c..block * BLOCK * c + x.len()]);
            dispatch!((x: &[f32], residual: Option<&[f32]>, weight: &[f32], bias: &[f32],
                eps: f32, out: &mut [f32]),
                V => normalise::<V>(x, residual, weight, bias, eps, out));
        },
    );
}

/// Gradients of [`forward`] without residual: of `x`, written to `dx`, and of weight and bias.
///
/// # Shapes
/// `x`, `grad`, `dx`: `[N, C]` · returns `([C], [C])`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn backward(
    x: &[f32],
    grad: &[f32],
    weight: &[f32],
    eps: f32,
    dx: &mut [f32],
) -> (Vec<f32>, Vec<f32>) {
    let c = weight.len();
    if c == 0 {
        return (Vec::new(), Vec::new());
    }
    assert!(x.len().is_multiple_of(c), "layer norm: rows of {c} channels");
    assert_eq!([grad.len(), dx.len()], [x.len(); 2], "layer norm: gradient lengths");
    let partial: Vec<Vec<f64>> = dx
        .par_chunks_mut(BLOCK * c)
        .zip(x.par_chunks(BLOCK * c))
        .zip(grad.par_chunks(BLOCK * c))
        .map(|((dx, x), grad)| {
            let mut sums = vec![0f64; 2 * c];
            let into = sums.as_mut_slice();
            dispatch!((x: &[f32], grad: &[f32], weight: &[f32], eps: f32, dx: &mut [f32],
                into: &mut [f64]),
                V => gradients::<V>(x, grad, weight, eps, dx, into));
            sums
        })
        .collect();
    let mut total = vec![0f64; 2 * c];
    for part in partial {
        for (t, p) in total.iter_mut().zip(part) {
            *t += p;
        }
    }
    let total: Vec<f32> = total.into_iter().map(|v| v as f32).collect();
    (total[..c].to_vec(), total[c..].to_vec())
}

/// Rows whose share in the gradients of the parameters is added up in f32 before it goes to the sums
/// in f64, which are then loaded and stored less often.
const TOGETHER: usize = 4;

/// Gradients of a block of rows; adds those of weight and bias to `sums` (`[2 C]`).
#[inline(always)]
unsafe fn gradients<V: Vector>(
    x: &[f32],
    grad: &[f32],
    weight: &[f32],
    eps: f32,
    dx: &mut [f32],
    sums: &mut [f64],
) {
    let c = weight.len();
    let (dw, db) = sums.split_at_mut(c);
    let mut x = x.chunks_exact(TOGETHER * c);
    let mut grad = grad.chunks_exact(TOGETHER * c);
    let mut dx = dx.chunks_exact_mut(TOGETHER * c);
    for ((x, grad), dx) in (&mut x).zip(&mut grad).zip(&mut dx) {
        some_rows::<TOGETHER>(x, grad, weight, eps, dx, dw, db);
    }
    let rest = x.remainder().chunks_exact(c).zip(grad.remainder().chunks_exact(c));
    for ((x, grad), dx) in rest.zip(dx.into_remainder().chunks_exact_mut(c)) {
        some_rows::<1>(x, grad, weight, eps, dx, dw, db);
    }
}

#[inline(always)]
fn some_rows<const R: usize>(
    x: &[f32],
    grad: &[f32],
    weight: &[f32],
    eps: f32,
    dx: &mut [f32],
    dw: &mut [f64],
    db: &mut [f64],
) {
    let c = weight.len();
    let x: [&[f32]; R] = std::array::from_fn(|r| &x[r * c..(r + 1) * c]);
    let grad: [&[f32]; R] = std::array::from_fn(|r| &grad[r * c..(r + 1) * c]);
    let mut rest = dx;
    let dx: [&mut [f32]; R] = std::array::from_fn(|_| {
        let (row, after) = std::mem::take(&mut rest).split_at_mut(c);
        rest = after;
        row
    });
    let rows: [Row; R] = std::array::from_fn(|r| Row::of(x[r], grad[r], weight, eps));
    let (dw, db) = (&mut dw[..c], &mut db[..c]);
    for j in 0..c {
        let (mut to_weight, mut to_bias) = (0.0, 0.0);
        for r in 0..R {
            let Row { mean, inverse, mean_g, mean_gx } = rows[r];
            let unit = (x[r][j] - mean) * inverse;
            let g = grad[r][j];
            dx[r][j] = inverse * (g * weight[j] - mean_g - unit * mean_gx);
            to_weight += g * unit;
            to_bias += g;
        }
        dw[j] += f64::from(to_weight);
        db[j] += f64::from(to_bias);
    }
}

/// What the gradients of a row's values have in common.
#[derive(Clone, Copy)]
struct Row {
    mean: f32,
    inverse: f32,
    /// Mean of `grad · weight`.
    mean_g: f32,
    /// Mean of `grad · weight` times the normalized value.
    mean_gx: f32,
}

impl Row {
    #[inline(always)]
    fn of(x: &[f32], grad: &[f32], weight: &[f32], eps: f32) -> Self {
        let (mean, inverse) = statistics(x, eps);
        // In f64, in eight chains for the lanes of a register.
        let (mut sum_g, mut sum_gx) = ([0f64; 8], [0f64; 8]);
        let mut add = |lane: usize, x: f32, grad: f32, weight: f32| {
            let g = grad * weight;
            sum_g[lane] += f64::from(g);
            sum_gx[lane] += f64::from(g * ((x - mean) * inverse));
        };
        let (x, x_rest) = x.as_chunks::<8>();
        let (grad, grad_rest) = grad.as_chunks::<8>();
        let (weight, weight_rest) = weight.as_chunks::<8>();
        for ((x, grad), weight) in x.iter().zip(grad).zip(weight) {
            for i in 0..8 {
                add(i, x[i], grad[i], weight[i]);
            }
        }
        for (i, ((x, grad), weight)) in x_rest.iter().zip(grad_rest).zip(weight_rest).enumerate() {
            add(i, *x, *grad, *weight);
        }
        let count = (8 * x.len() + x_rest.len()) as f64;
        let total = |s: [f64; 8]| ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
        let (mean_g, mean_gx) = (total(sum_g) / count, total(sum_gx) / count);
        Self { mean, inverse, mean_g: mean_g as f32, mean_gx: mean_gx as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::random;
    use scenesplat_test_support::reference;

    #[test]
    fn agrees_with_f64_at_hard_scales() {
        for c in [1, 3, 16, 48, 100, 768] {
            let (weight, bias) = (random(c, 1), random(c, 2));
            for scale in [1.0, 1e-12, 1e12, 1e25, 1e37] {
                let x: Vec<f32> = random(5 * c, 3).iter().map(|v| v * scale).collect();
                let mut y = vec![f32::NAN; x.len()];
                forward(&x, None, &weight, &bias, 1e-5, &mut y);
                let want = reference::layer_norm(&x, c, &weight, &bias, f64::from(1e-5f32));
                for (g, w) in y.iter().zip(&want) {
                    assert!((f64::from(*g) - w).abs() < 2e-5, "c {c} scale {scale}: {g} {w}");
                }
            }
            let constant = vec![3.5; 2 * c];
            let mut y = vec![0.0; 2 * c];
            forward(&constant, None, &weight, &bias, 1e-5, &mut y);
            for (j, v) in y.iter().enumerate() {
                assert!((v - bias[j % c]).abs() < 1e-6, "a constant row gives the bias");
            }
        }
    }

    #[test]
    fn residual_is_added_last() {
        let c = 20;
        let (x, r, w, b) = (random(7 * c, 1), random(7 * c, 2), random(c, 3), random(c, 4));
        let (mut plain, mut with) = (vec![0.0; 7 * c], vec![0.0; 7 * c]);
        forward(&x, None, &w, &b, 1e-5, &mut plain);
        forward(&x, Some(&r), &w, &b, 1e-5, &mut with);
        for i in 0..7 * c {
            assert_eq!(with[i], plain[i] + r[i]);
        }
    }

    #[test]
    fn gradients_agree_with_differences() {
        gradients_of(4, 9);
        gradients_of(7, 19);
        gradients_of(1, 16);
    }

    fn gradients_of(n: usize, c: usize) {
        let (x, w, b, g) = (random(n * c, 5), random(c, 6), random(c, 7), random(n * c, 8));
        let loss = |x: &[f32], w: &[f32], b: &[f32]| -> f64 {
            reference::layer_norm(x, c, w, b, 1e-5)
                .iter()
                .zip(&g)
                .map(|(y, g)| y * f64::from(*g))
                .sum()
        };
        let mut dx = vec![0.0; n * c];
        let (dw, db) = backward(&x, &g, &w, 1e-5, &mut dx);
        let difference = |values: &[f32], i: usize, f: &dyn Fn(&[f32]) -> f64| {
            let h = 1e-2f32;
            let (mut up, mut down) = (values.to_vec(), values.to_vec());
            up[i] += h;
            down[i] -= h;
            (f(&up) - f(&down)) / f64::from(up[i] - down[i])
        };
        for i in 0..n * c {
            let want = difference(&x, i, &|x| loss(x, &w, &b));
            assert!((f64::from(dx[i]) - want).abs() < 5e-3, "dx {i}: {} {want}", dx[i]);
        }
        for i in 0..c {
            let want = difference(&w, i, &|w| loss(&x, w, &b));
            assert!((f64::from(dw[i]) - want).abs() < 1e-4);
            let want = difference(&b, i, &|b| loss(&x, &w, b));
            assert!((f64::from(db[i]) - want).abs() < 1e-4);
        }
    }
}

//! Batch normalisation over the rows of each channel.
//!
//! Statistics are summed in f64 over fixed stretches of rows, so they depend neither on the number
//! of threads nor on cancellation.

use rayon::prelude::*;

/// Rows of one partial sum.
const BLOCK: usize = 1024;

/// Mean and variance of each channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// `[C]`
    pub mean: Vec<f64>,
    /// Biased: divided by N. `[C]`
    pub var: Vec<f64>,
}

fn column_sums(
    rows: &[f32],
    other: &[f32],
    c: usize,
    f: impl Fn(usize, f32, f32) -> f64 + Sync,
) -> Vec<f64> {
    if c == 0 {
        return Vec::new();
    }
    let partial: Vec<Vec<f64>> = rows
        .par_chunks(BLOCK * c)
        .zip(other.par_chunks(BLOCK * c))
        .map(|(rows, other)| {
            let mut sums = vec![0f64; c];
            for (row, other) in rows.chunks_exact(c).zip(other.chunks_exact(c)) {
                for j in 0..c {
                    sums[j] += f(j, row[j], other[j]);
                }
            }
            sums
        })
        .collect();
    let mut total = vec![0f64; c];
    for part in partial {
        for (t, p) in total.iter_mut().zip(part) {
            *t += p;
        }
    }
    total
}

/// Statistics of `x` (`[N, C]`); zeros when there is no row.
pub fn statistics(x: &[f32], c: usize) -> Statistics {
    let n = (x.len() / c.max(1)).max(1) as f64;
    let mean: Vec<f64> =
        column_sums(x, x, c, |_, v, _| f64::from(v)).into_iter().map(|s| s / n).collect();
    let var = column_sums(x, x, c, |j, v, _| {
        let d = f64::from(v) - mean[j];
        d * d
    });
    Statistics { mean, var: var.into_iter().map(|s| s / n).collect() }
}

/// `out = x · scale + shift` per channel, then the exact GELU if asked for.
///
/// # Shapes
/// `x`, `out`: `[N, C]` · `scale`, `shift`: `[C]`
pub fn apply(x: &[f32], scale: &[f32], shift: &[f32], gelu: bool, out: &mut [f32]) {
    let c = scale.len();
    if c == 0 {
        return;
    }
    out.par_chunks_mut(BLOCK * c).zip(x.par_chunks(BLOCK * c)).for_each(|(out, x)| {
        for (out, x) in out.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
            for j in 0..c {
                out[j] = x[j] * scale[j] + shift[j];
            }
        }
        if gelu {
            crate::activation::gelu_in_place(out);
        }
    });
}

/// Gradients of `y = (x − mean)·inverse·weight + bias`.
///
/// `batch` says whether mean and `inverse = 1/√(var + ε)` came from this very batch (training) or
/// are constants (evaluation). Returns the gradients of weight and bias.
///
/// # Shapes
/// `x`, `grad`, `dx`: `[N, C]` · `weight`, `mean`, `inverse`: `[C]`
pub fn backward(
    x: &[f32],
    grad: &[f32],
    weight: &[f32],
    mean: &[f64],
    inverse: &[f64],
    batch: bool,
    dx: &mut [f32],
) -> (Vec<f32>, Vec<f32>) {
    let c = weight.len();
    if c == 0 {
        return (Vec::new(), Vec::new());
    }
    let n = (x.len() / c.max(1)).max(1) as f64;
    let dw =
        column_sums(x, grad, c, |j, v, g| f64::from(g) * (f64::from(v) - mean[j]) * inverse[j]);
    let db = column_sums(x, grad, c, |_, _, g| f64::from(g));
    dx.par_chunks_mut(BLOCK * c)
        .zip(x.par_chunks(BLOCK * c))
        .zip(grad.par_chunks(BLOCK * c))
        .for_each(|((dx, x), grad)| {
            let rows = x.chunks_exact(c).zip(grad.chunks_exact(c)).zip(dx.chunks_exact_mut(c));
            for ((x, grad), dx) in rows {
                for j in 0..c {
                    let mut g = f64::from(grad[j]);
                    if batch {
                        let unit = (f64::from(x[j]) - mean[j]) * inverse[j];
                        g -= (db[j] + unit * dw[j]) / n;
                    }
                    dx[j] = (g * inverse[j] * f64::from(weight[j])) as f32;
                }
            }
        });
    let to_f32 = |v: Vec<f64>| v.into_iter().map(|v| v as f32).collect();
    (to_f32(dw), to_f32(db))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_survive_a_large_offset() {
        let x: Vec<f32> = (0..3000).map(|i| 1e6 + (i % 3) as f32 / 4.0).collect();
        let s = statistics(&x, 1);
        assert!((s.mean[0] - 1_000_000.25).abs() < 1e-6);
        assert!((s.var[0] - 0.125 / 3.0).abs() < 1e-9, "{}", s.var[0]);
    }

    /// f64 sums over several stretches, scales from tiny to huge, and gradients by differences.
    #[test]
    fn output_and_gradients_agree_with_f64() {
        use crate::reference;
        let (n, c) = (2500, 3);
        let noise = |i: usize| ((i * 7919 % 10_007) as f32 / 10_007.0) - 0.5;
        let (weight, bias) = ([1.5, -0.5, 1.0], [0.25, 0.0, -1.0]);
        for scale in [1.0, 1e-12, 1e15] {
            let x: Vec<f32> = (0..n * c).map(|i| noise(i) * scale).collect();
            let s = statistics(&x, c);
            let inverse: Vec<f64> = s.var.iter().map(|v| 1.0 / (v + 1e-3).sqrt()).collect();
            let scales: Vec<f32> =
                (0..c).map(|j| (f64::from(weight[j]) * inverse[j]) as f32).collect();
            let shifts: Vec<f32> = (0..c)
                .map(|j| {
                    let moved = s.mean[j] * f64::from(weight[j]) * inverse[j];
                    (f64::from(bias[j]) - moved) as f32
                })
                .collect();
            let mut y = vec![0.0; n * c];
            apply(&x, &scales, &shifts, false, &mut y);
            let want = reference::batch_norm(&x, &weight, &bias, 1e-3);
            for (g, w) in y.iter().zip(&want) {
                assert!((f64::from(*g) - w).abs() < 2e-6, "{scale}: {g} {w}");
            }
        }
        let x: Vec<f32> = (0..5 * c).map(noise).collect();
        let grad: Vec<f32> = (0..5 * c).map(|i| noise(i + 77)).collect();
        let loss = |x: &[f32]| -> f64 {
            let y = reference::batch_norm(x, &weight, &bias, 1e-3);
            y.iter().zip(&grad).map(|(y, g)| y * f64::from(*g)).sum()
        };
        let s = statistics(&x, c);
        let inverse: Vec<f64> = s.var.iter().map(|v| 1.0 / (v + 1e-3).sqrt()).collect();
        let mut dx = vec![0.0; x.len()];
        backward(&x, &grad, &weight, &s.mean, &inverse, true, &mut dx);
        for i in 0..x.len() {
            let (mut up, mut down) = (x.clone(), x.clone());
            up[i] += 1e-3;
            down[i] -= 1e-3;
            let want = (loss(&up) - loss(&down)) / f64::from(up[i] - down[i]);
            assert!((f64::from(dx[i]) - want).abs() < 1e-3, "{i}: {} {want}", dx[i]);
        }
    }

    #[test]
    fn no_row_and_one_row() {
        assert_eq!(statistics(&[], 2), Statistics { mean: vec![0.0; 2], var: vec![0.0; 2] });
        assert_eq!(statistics(&[3.0, -4.0], 2).mean, [3.0, -4.0]);
        assert_eq!(statistics(&[3.0, -4.0], 2).var, [0.0, 0.0]);
    }
}

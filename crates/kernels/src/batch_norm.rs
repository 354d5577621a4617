//! Batch normalization over the rows of each channel.
//!
//! Statistics are summed in f64 over fixed stretches of rows, so they depend neither on the number
//! of threads nor on cancellation. Each array is read from memory once; the gradients need a second
//! look, because every gradient of the input depends on sums over all rows.

use crate::activation::gelu_in_place;
use crate::shape::elements;
use crate::simd::{Vector, dispatch};
use rayon::prelude::*;

/// Rows of one partial sum.
const BLOCK: usize = 1024;
/// Values that fit into a core's second-level cache between two passes over them.
const CACHED: usize = 1 << 15;

/// Mean and variance of each channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// `[C]`
    pub mean: Vec<f64>,
    /// Biased: divided by N. `[C]`
    pub var: Vec<f64>,
}

/// Sums of some rows: of the values, and of the squares of their differences from their mean.
struct Moments {
    rows: f64,
    sum: Vec<f64>,
    squares: Vec<f64>,
}

impl Moments {
    fn none(c: usize) -> Self {
        Self { rows: 0.0, sum: vec![0.0; c], squares: vec![0.0; c] }
    }

    /// Of a stretch of rows, piece by piece: the second pass over a piece, with its mean, finds it in
    /// the cache. Differences from a mean nearby, not from zero, keep variances from cancelling.
    fn of(x: &[f32], c: usize) -> Self {
        let mut all = Self::none(c);
        let mut piece = Self::none(c);
        let mut mean = vec![0.0; c];
        for x in x.chunks((CACHED / c).max(8) * c) {
            let Self { rows, sum, squares } = &mut piece;
            *rows = (x.len() / c) as f64;
            sum.fill(0.0);
            squares.fill(0.0);
            dispatch!((x: &[f32], sum: &mut [f64]), V => add_rows::<V>(x, sum));
            mean.iter_mut().zip(&*sum).for_each(|(m, s)| *m = s / *rows);
            let mean = mean.as_slice();
            dispatch!((x: &[f32], mean: &[f64], squares: &mut [f64]),
                V => add_squares::<V>(x, mean, squares));
            all.add(&piece);
        }
        all
    }

    fn statistics(self) -> Statistics {
        let n = self.rows.max(1.0);
        let by_rows = |sums: Vec<f64>| sums.into_iter().map(|s| s / n).collect();
        Statistics { mean: by_rows(self.sum), var: by_rows(self.squares) }
    }

    fn add(&mut self, other: &Self) {
        if self.rows > 0.0 {
            let weight = self.rows * other.rows / (self.rows + other.rows);
            let sums = self.sum.iter().zip(&other.sum);
            for (square, (own, others)) in self.squares.iter_mut().zip(sums) {
                let apart = others / other.rows - own / self.rows;
                *square += apart * apart * weight;
            }
        }
        self.rows += other.rows;
        self.sum.iter_mut().zip(&other.sum).for_each(|(s, o)| *s += o);
        self.squares.iter_mut().zip(&other.squares).for_each(|(s, o)| *s += o);
    }
}

/// Adds rows to `sum`, four at a time: loading and storing the sums would be most of the work.
#[inline(always)]
unsafe fn add_rows<V: Vector>(x: &[f32], sum: &mut [f64]) {
    let c = sum.len();
    let fours = x.chunks_exact(4 * c);
    for row in fours.remainder().chunks_exact(c) {
        for j in 0..c {
            sum[j] += f64::from(row[j]);
        }
    }
    for four in fours {
        let [p, q, r, s] = rows_of_four(four, c);
        for j in 0..c {
            let [p, q, r, s] = [p[j], q[j], r[j], s[j]].map(f64::from);
            sum[j] += (p + q) + (r + s);
        }
    }
}

/// As [`add_rows`], the squares of the differences from `mean`.
#[inline(always)]
unsafe fn add_squares<V: Vector>(x: &[f32], mean: &[f64], sum: &mut [f64]) {
    let c = sum.len();
    let mean = &mean[..c];
    let square = |v: f32, j: usize| {
        let d = f64::from(v) - mean[j];
        d * d
    };
    let fours = x.chunks_exact(4 * c);
    for row in fours.remainder().chunks_exact(c) {
        for j in 0..c {
            sum[j] += square(row[j], j);
        }
    }
    for four in fours {
        let [p, q, r, s] = rows_of_four(four, c);
        for j in 0..c {
            sum[j] += (square(p[j], j) + square(q[j], j)) + (square(r[j], j) + square(s[j], j));
        }
    }
}

#[inline(always)]
fn rows_of_four(x: &[f32], c: usize) -> [&[f32]; 4] {
    std::array::from_fn(|i| &x[i * c..(i + 1) * c])
}

/// Statistics of `x` (`[N, C]`); zeros when there is no row.
pub fn statistics(x: &[f32], c: usize) -> Statistics {
    if c == 0 {
        return Statistics { mean: Vec::new(), var: Vec::new() };
    }
    let parts: Vec<Moments> = x.par_chunks(BLOCK * c).map(|x| Moments::of(x, c)).collect();
    let mut all = Moments::none(c);
    parts.iter().for_each(|part| all.add(part));
    all.statistics()
}

/// The number of all rows and their statistics together, from those of each part, in this order. Parts without rows
/// add nothing; zeros when there is no row.
///
/// # Shapes
/// Statistics of each part: `[C]`
///
/// # Panics
/// If a part has another number of channels (a bug of the caller).
pub fn merge(parts: &[(f64, Statistics)], c: usize) -> (f64, Statistics) {
    let mut all = Moments::none(c);
    for (rows, part) in parts.iter().filter(|(rows, _)| *rows > 0.0) {
        assert_eq!((part.mean.len(), part.var.len()), (c, c), "batch norm: channels of a part");
        let times = |values: &[f64]| values.iter().map(|v| v * rows).collect();
        all.add(&Moments { rows: *rows, sum: times(&part.mean), squares: times(&part.var) });
    }
    (all.rows, all.statistics())
}

/// `out = x · scale + shift` per channel, then the exact GELU if asked for.
///
/// # Shapes
/// `x`, `out`: `[N, C]` · `scale`, `shift`: `[C]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn apply(x: &[f32], scale: &[f32], shift: &[f32], gelu: bool, out: &mut [f32]) {
    let c = scale.len();
    assert_eq!((shift.len(), x.len()), (c, out.len()), "batch norm: shift and output lengths");
    if c == 0 {
        return;
    }
    assert!(x.len().is_multiple_of(c), "batch norm: rows of {c} channels");
    let piece = (CACHED / c).max(1) * c;
    out.par_chunks_mut(piece).zip(x.par_chunks(piece)).for_each(|(out, x)| {
        dispatch!((x: &[f32], scale: &[f32], shift: &[f32], out: &mut [f32]),
            V => scale_rows::<V>(x, scale, shift, out));
        if gelu {
            gelu_in_place(out);
        }
    });
}

#[inline(always)]
unsafe fn scale_rows<V: Vector>(x: &[f32], scale: &[f32], shift: &[f32], out: &mut [f32]) {
    let c = scale.len();
    let shift = &shift[..c];
    for (out, x) in out.chunks_exact_mut(c).zip(x.chunks_exact(c)) {
        for j in 0..c {
            out[j] = x[j] * scale[j] + shift[j];
        }
    }
}

/// Gradients of `y = (x − mean)·inverse·weight + bias`.
///
/// `batch` says whether mean and `inverse = 1/√(var + ε)` came from this very batch (training) or
/// are constants (evaluation). Returns the gradients of weight and bias.
///
/// # Shapes
/// `x`, `grad`, `dx`: `[N, C]` · `weight`, `mean`, `inverse`: `[C]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
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
    let sums = gradient_sums(x, grad, mean);
    let rows = (x.len() / c).max(1) as f64;
    input_gradient(x, grad, weight, mean, inverse, batch.then_some((&sums, rows)), dx);
    parameter_gradients(&sums, inverse)
}

/// Sums of `grad · (x − mean)` over the rows, then of `grad`. `[2C]`
///
/// # Shapes
/// `x`, `grad`: `[N, C]` · `mean`: `[C]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn gradient_sums(x: &[f32], grad: &[f32], mean: &[f64]) -> Vec<f64> {
    let c = mean.len();
    let mut sums = vec![0.0; 2 * c];
    if c == 0 {
        return sums;
    }
    assert!(x.len() == grad.len() && x.len().is_multiple_of(c), "batch norm: gradient lengths");
    let parts: Vec<Vec<f64>> = x
        .par_chunks(BLOCK * c)
        .zip(grad.par_chunks(BLOCK * c))
        .map(|(x, grad)| {
            let mut sums = vec![0.0; 2 * c];
            let (products, plain) = sums.split_at_mut(c);
            dispatch!((x: &[f32], grad: &[f32], mean: &[f64], products: &mut [f64],
                plain: &mut [f64]),
                V => add_gradients::<V>(x, grad, mean, products, plain));
            sums
        })
        .collect();
    for part in parts {
        sums.iter_mut().zip(part).for_each(|(s, p)| *s += p);
    }
    sums
}

/// The gradients of weight and bias from [`gradient_sums`]. `[C]` each
pub fn parameter_gradients(sums: &[f64], inverse: &[f64]) -> (Vec<f32>, Vec<f32>) {
    let (products, db) = sums.split_at(sums.len() / 2);
    let dw = products.iter().zip(inverse).map(|(p, i)| (p * i) as f32).collect();
    (dw, db.iter().map(|&d| d as f32).collect())
}

/// The gradient of the input. `batch`: the sums ([`gradient_sums`]) and the number of all rows that mean and
/// `inverse` come from; nothing where these are constants.
///
/// # Shapes
/// `x`, `grad`, `dx`: `[N, C]` · `weight`, `mean`, `inverse`: `[C]` · sums: `[2C]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn input_gradient(
    x: &[f32],
    grad: &[f32],
    weight: &[f32],
    mean: &[f64],
    inverse: &[f64],
    batch: Option<(&[f64], f64)>,
    dx: &mut [f32],
) {
    let c = weight.len();
    if c == 0 {
        return;
    }
    let arrays = [x.len(), grad.len(), dx.len()] == [elements([x.len() / c, c]); 3];
    assert!(arrays && [mean.len(), inverse.len()] == [c; 2], "batch norm: gradient lengths");
    // dx = (g − (db + unit · dw) / n) · inverse · weight, with what does not change over the rows
    // taken together.
    let factor: Vec<f64> = inverse.iter().zip(weight).map(|(i, w)| i * f64::from(*w)).collect();
    let (mut constant, mut slope) = (vec![0.0; c], vec![0.0; c]);
    if let Some((sums, n)) = batch {
        let (products, db) = sums.split_at(c);
        constant.iter_mut().zip(db).for_each(|(s, d)| *s = d / n);
        for ((s, p), i) in slope.iter_mut().zip(products).zip(inverse) {
            *s = p * i * i / n;
        }
    }
    let batch = batch.is_some();
    let channels = Channels { mean, factor: &factor, constant: &constant, slope: &slope, batch };
    let piece = (CACHED / c).max(1) * c;
    dx.par_chunks_mut(piece).zip(x.par_chunks(piece)).zip(grad.par_chunks(piece)).for_each(
        |((dx, x), grad)| {
            dispatch!((x: &[f32], grad: &[f32], channels: Channels<'_>, dx: &mut [f32]),
                V => input_gradients::<V>(x, grad, channels, dx));
        },
    );
}

/// Adds `grad · (x − mean)` to `products` and `grad` to `plain`, four rows at a time.
#[inline(always)]
unsafe fn add_gradients<V: Vector>(
    x: &[f32],
    grad: &[f32],
    mean: &[f64],
    products: &mut [f64],
    plain: &mut [f64],
) {
    let c = plain.len();
    let (mean, products) = (&mean[..c], &mut products[..c]);
    let (x_fours, grad_fours) = (x.chunks_exact(4 * c), grad.chunks_exact(4 * c));
    let x_rest = x_fours.remainder().chunks_exact(c);
    for (x, grad) in x_rest.zip(grad_fours.remainder().chunks_exact(c)) {
        for j in 0..c {
            products[j] += f64::from(grad[j]) * (f64::from(x[j]) - mean[j]);
            plain[j] += f64::from(grad[j]);
        }
    }
    for (x, grad) in x_fours.zip(grad_fours) {
        let ([x0, x1, x2, x3], [g0, g1, g2, g3]) = (rows_of_four(x, c), rows_of_four(grad, c));
        for j in 0..c {
            let [g0, g1, g2, g3] = [g0[j], g1[j], g2[j], g3[j]].map(f64::from);
            let [x0, x1, x2, x3] = [x0[j], x1[j], x2[j], x3[j]].map(|v| f64::from(v) - mean[j]);
            products[j] += (g0 * x0 + g1 * x1) + (g2 * x2 + g3 * x3);
            plain[j] += (g0 + g1) + (g2 + g3);
        }
    }
}

/// What the gradient of a row needs to know of each channel. `[C]` each
#[derive(Clone, Copy)]
struct Channels<'a> {
    mean: &'a [f64],
    factor: &'a [f64],
    constant: &'a [f64],
    slope: &'a [f64],
    /// Whether constant and slope count.
    batch: bool,
}

/// `dx = (grad − constant − slope · (x − mean)) · factor`.
#[inline(always)]
unsafe fn input_gradients<V: Vector>(
    x: &[f32],
    grad: &[f32],
    channels: Channels<'_>,
    dx: &mut [f32],
) {
    let c = channels.mean.len();
    let (mean, factor) = (channels.mean, &channels.factor[..c]);
    let (constant, slope) = (&channels.constant[..c], &channels.slope[..c]);
    let rows = x.chunks_exact(c).zip(grad.chunks_exact(c)).zip(dx.chunks_exact_mut(c));
    for ((x, grad), dx) in rows {
        if channels.batch {
            for j in 0..c {
                let apart = f64::from(x[j]) - mean[j];
                let g = f64::from(grad[j]) - constant[j] - apart * slope[j];
                dx[j] = (g * factor[j]) as f32;
            }
        } else {
            for j in 0..c {
                dx[j] = (f64::from(grad[j]) * factor[j]) as f32;
            }
        }
    }
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

    /// Rows in parts of any size, an empty one among them, come to what all rows come to.
    #[test]
    fn parts_of_the_rows_are_merged_to_the_whole() {
        let (n, c) = (2500, 3);
        let value = |i: usize| ((i * 7919 % 10_007) as f32 / 10_007.0) + 1e4 * (i / 3000) as f32;
        let x: Vec<f32> = (0..n * c).map(value).collect();
        let grad: Vec<f32> = (0..n * c).map(|i| (i * 4957 % 8009) as f32 / 8009.0 - 0.4).collect();
        let weight = [1.5, -0.5, 1.0];
        let whole = statistics(&x, c);
        let cuts = [0, 1, 1, 700, n];
        let part = |w: &[usize]| (w[0] * c)..(w[1] * c);
        let parts: Vec<_> =
            cuts.windows(2).map(|w| ((w[1] - w[0]) as f64, statistics(&x[part(w)], c))).collect();
        let (rows, merged) = merge(&parts, c);
        assert_eq!(rows, n as f64);
        for j in 0..c {
            assert!((merged.mean[j] - whole.mean[j]).abs() < 1e-12 * whole.mean[j].abs());
            assert!((merged.var[j] - whole.var[j]).abs() < 1e-11 * whole.var[j]);
        }
        let (none, zeros) = merge(&[(0.0, statistics(&[], c))], c);
        assert_eq!((none, zeros.mean), (0.0, vec![0.0; c]));

        let inverse: Vec<f64> = whole.var.iter().map(|v| 1.0 / (v + 1e-3).sqrt()).collect();
        let mut want = vec![0.0; n * c];
        let (dw, db) = backward(&x, &grad, &weight, &whole.mean, &inverse, true, &mut want);
        let sums = cuts.windows(2).map(|w| gradient_sums(&x[part(w)], &grad[part(w)], &whole.mean));
        let sums = sums.fold(vec![0.0; 2 * c], |mut all, part| {
            all.iter_mut().zip(part).for_each(|(a, p)| *a += p);
            all
        });
        let mut dx = vec![f32::NAN; n * c];
        for w in cuts.windows(2) {
            let (x, grad) = (&x[part(w)], &grad[part(w)]);
            let all = Some((sums.as_slice(), rows));
            input_gradient(x, grad, &weight, &whole.mean, &inverse, all, &mut dx[part(w)]);
        }
        let (dw_of_parts, db_of_parts) = parameter_gradients(&sums, &inverse);
        let pairs = |a: &[f32], b: &[f32]| {
            let largest = b.iter().fold(0.0_f32, |largest, b| largest.max(b.abs()));
            for (a, b) in a.iter().zip(b) {
                assert!((a - b).abs() <= 1e-6 * largest, "{a} {b} of {largest}");
            }
        };
        pairs(&dx, &want);
        pairs(&dw_of_parts, &dw);
        pairs(&db_of_parts, &db);
    }

    /// f64 sums over several stretches, scales from tiny to huge, and gradients by differences.
    #[test]
    fn output_and_gradients_agree_with_f64() {
        use scenesplat_test_support::reference;
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

    /// Several stretches and pieces, rows that are no multiple of four, a first row far off.
    #[test]
    fn statistics_and_sums_agree_with_f64() {
        for (n, c) in [(1, 5), (7, 1), (2500, 3), (1100, 100), (130, 768)] {
            let noise = |i: usize| ((i * 7919 % 10_007) as f32 / 10_007.0) - 0.5;
            let mut x: Vec<f32> = (0..n * c).map(|i| 100.0 + noise(i)).collect();
            x[..c].iter_mut().for_each(|v| *v = -3e4);
            let grad: Vec<f32> = (0..n * c).map(|i| noise(i + 5)).collect();
            let s = statistics(&x, c);
            let inverse = vec![0.5; c];
            let mut dx = vec![f32::NAN; n * c];
            let weight = vec![2.0; c];
            for batch in [false, true] {
                let (dw, db) = backward(&x, &grad, &weight, &s.mean, &inverse, batch, &mut dx);
                for j in 0..c {
                    let column = |v: &[f32]| -> Vec<f64> {
                        v.iter().skip(j).step_by(c).map(|v| f64::from(*v)).collect()
                    };
                    let (values, grads) = (column(&x), column(&grad));
                    let mean = values.iter().sum::<f64>() / n as f64;
                    let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64;
                    assert!((s.mean[j] - mean).abs() <= 1e-12 * mean.abs(), "{n} {c}");
                    assert!((s.var[j] - var).abs() <= 1e-10 * var, "{n} {c}: {} {var}", s.var[j]);
                    let sum: f64 = grads.iter().sum();
                    let units = values.iter().map(|v| (v - mean) * 0.5);
                    let product: f64 = units.clone().zip(&grads).map(|(u, g)| u * g).sum();
                    assert!((f64::from(db[j]) - sum).abs() < 1e-6 * (1.0 + sum.abs()));
                    assert!((f64::from(dw[j]) - product).abs() < 1e-6 * (1.0 + product.abs()));
                    for (i, (unit, g)) in units.zip(&grads).enumerate() {
                        let shift = if batch { (sum + unit * product) / n as f64 } else { 0.0 };
                        let want = g - shift;
                        let got = f64::from(dx[i * c + j]);
                        assert!((got - want).abs() < 1e-6 * (1.0 + want.abs()), "{got} {want}");
                    }
                }
            }
        }
    }

    #[test]
    fn infinities_and_nan_stay_in_their_channel() {
        let mut x = vec![1.0; 3000 * 3];
        x[3 * 2000] = f32::INFINITY;
        x[3 * 10 + 1] = f32::NAN;
        let s = statistics(&x, 3);
        assert_eq!(s.mean[0], f64::INFINITY);
        assert!(s.var[0].is_nan() && s.mean[1].is_nan() && s.var[1].is_nan());
        assert_eq!((s.mean[2], s.var[2]), (1.0, 0.0));
    }

    #[test]
    fn no_row_and_one_row() {
        assert_eq!(statistics(&[], 2), Statistics { mean: vec![0.0; 2], var: vec![0.0; 2] });
        assert_eq!(statistics(&[3.0, -4.0], 2).mean, [3.0, -4.0]);
        assert_eq!(statistics(&[3.0, -4.0], 2).var, [0.0, 0.0]);
    }
}

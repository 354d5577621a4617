//! Matrix products in every precision.

use super::compare::{Wide, compare, products};
use crate::doctor::case::{Case, Finding};
use crate::doctor::noise::{Noise, noise};
use crate::doctor::table::case;
use crate::doctor::trial::{Failure, Trial, ensure};
use scenesplat_kernels::Precision;
use scenesplat_kernels::gemm::{Epilogue, PackedMatrix, gemm, gemm_tn_with, gemm_unit_rows, mlp};

/// Rows times columns: `[m, k]` and `[n, k]`.
struct Factors {
    m: usize,
    k: usize,
    n: usize,
    a: Vec<f32>,
    w: Vec<f32>,
}

impl Factors {
    fn of(m: usize, k: usize, n: usize, size: f32) -> Self {
        Self { m, k, n, a: noise(m * k, 1, size), w: noise(n * k, 2, size) }
    }

    fn product(&self, precision: Precision) -> Vec<f32> {
        let (k, n) = (self.k, self.n);
        let packed = PackedMatrix::from_strided_with(precision, &self.w, k, n, 1, k);
        let mut out = vec![0.0; self.m * n];
        gemm(&self.a, &packed, Epilogue::default(), &mut out);
        out
    }

    fn check(&self, trial: &Trial<'_>, precision: Precision) -> Result<Finding, Failure> {
        trial.keep(&format!("a_{}x{}", self.m, self.k), &self.a)?;
        trial.keep(&format!("w_{}x{}", self.n, self.k), &self.w)?;
        let got = trial.one_and_many(|| Ok(self.product(precision)))?;
        let at = |i: usize| {
            format!("row {}, column {} of {}×{}×{}", i / self.n, i % self.n, self.m, self.k, self.n)
        };
        compare(&got, &products(&self.a, &self.w, self.k), at)
    }
}

/// What goes in.
const INPUTS: &[(&str, fn() -> Vec<Factors>)] = &[
    ("odd-shapes", || {
        [(1, 1, 1), (2, 3, 17), (3, 65, 16), (193, 70, 33), (65, 385, 66), (5, 768, 80)]
            .map(|(m, k, n)| Factors::of(m, k, n, 1.0))
            .into()
    }),
    ("huge", || vec![Factors::of(9, 96, 80, 1e15)]),
    ("tiny", || vec![Factors::of(9, 96, 80, 1e-15)]),
    ("cancelling", || {
        let mut factors = Factors::of(4, 512, 80, 1.0);
        // Every second term is the one before with the other sign, and a little more.
        for row in factors.a.chunks_exact_mut(512) {
            for pair in row.chunks_exact_mut(2) {
                pair[1] = -pair[0] * 1.001;
            }
        }
        for row in factors.w.chunks_exact_mut(512) {
            for pair in row.chunks_exact_mut(2) {
                pair[1] = pair[0];
            }
        }
        vec![factors]
    }),
    ("outlier", || {
        let mut factors = Factors::of(6, 128, 96, 1.0);
        factors.a[128 + 5] = 40.0;
        factors.w[2 * 128 + 77] = -40.0;
        vec![factors]
    }),
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for precision in Precision::ALL {
        for &(name, inputs) in INPUTS {
            cases.push(case(format!("product-{precision}-{name}"), move |trial| {
                let mut found = Finding::right();
                for factors in inputs() {
                    found.join(factors.check(trial, precision)?);
                }
                Ok(found)
            }));
        }
        let name = format!("product-{precision}-nan-in-a-row");
        cases.push(case(name, move |_| nan_in_a_row(precision)));
    }
    cases.push(case("product-f32-of-20000-terms", |t| {
        Factors::of(3, 20_000, 17, 1.0).check(t, Precision::F32)
    }));
    for precision in [Precision::F32, Precision::F32Split, Precision::Bf16] {
        let name = format!("weight-gradient-{precision}");
        cases.push(case(name, move |t| transposed(t, precision)));
    }
    cases.push(case("mlp-fused", fused));
    cases.push(case("unit-rows-of-a-product", unit_rows));
    cases
}

fn nan_in_a_row(precision: Precision) -> Result<(), Failure> {
    let clean = Factors::of(7, 128, 96, 1.0);
    let mut bad = Factors::of(7, 128, 96, 1.0);
    bad.a[3 * 128 + 50] = f32::NAN;
    bad.a[5 * 128 + 9] = f32::INFINITY;
    let (clean, bad) = (clean.product(precision), bad.product(precision));
    for row in 0..7 {
        let at = row * 96..(row + 1) * 96;
        if [3, 5].contains(&row) {
            ensure!(bad[at].iter().all(|v| !v.is_finite()), "row {row} hides what is not finite");
        } else {
            ensure!(bad[at.clone()] == clean[at], "row {row} changed with another row");
        }
    }
    Ok(())
}

fn transposed(trial: &Trial<'_>, precision: Precision) -> Result<Finding, Failure> {
    let (rows, m, n) = (3001, 33, 18);
    let (a, b) = (noise(rows * m, 3, 1.0), noise(rows * n, 4, 1.0));
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; m * n];
        gemm_tn_with(precision, &a, m, &b, n, None, &mut out);
        Ok(out)
    })?;
    let mut want = vec![Wide::of(0.0, 0.0); m * n];
    for row in 0..rows {
        for i in 0..m {
            for j in 0..n {
                want[i * n + j].add(f64::from(a[row * m + i]) * f64::from(b[row * n + j]));
            }
        }
    }
    compare(&got, &want, |i| format!("element {}, {}", i / n, i % n))
}

/// Φ by the complementary error function's continued fraction and series, in f64.
pub(super) fn normal_cdf(x: f64) -> f64 {
    let t = x.abs() / std::f64::consts::SQRT_2;
    let upper = if t < 3.0 {
        // erf by its series.
        let (mut term, mut sum) = (t, t);
        for n in 1..200 {
            term *= -t * t / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        0.5 * (1.0 - 2.0 / std::f64::consts::PI.sqrt() * sum)
    } else {
        // erfc(t) = e^(−t²)/√π · 1/(t + ½/(t + 1/(t + 3⁄2/(t + …))))
        let fraction = (1..80).rev().fold(t, |below, k| t + f64::from(k) / 2.0 / below);
        0.5 * (-t * t).exp() / std::f64::consts::PI.sqrt() / fraction
    };
    if x > 0.0 { 1.0 - upper } else { upper }
}

fn fused(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let (m, k, h, n) = (101, 24, 50, 19);
    let a = noise(m * k, 5, 1.0);
    let (w1, b1) = (noise(h * k, 6, 0.3), noise(h, 7, 0.5));
    let (w2, b2) = (noise(n * h, 8, 0.3), noise(n, 9, 0.5));
    let residual = noise(m * n, 10, 1.0);
    let (p1, p2) =
        (PackedMatrix::from_strided(&w1, k, h, 1, k), PackedMatrix::from_strided(&w2, h, n, 1, h));
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; m * n];
        let epilogue = Epilogue { bias: Some(&b2), residual: Some(&residual), gelu: false };
        mlp(&a, (&p1, &b1), &p2, epilogue, &mut out);
        Ok(out)
    })?;
    let biased = |(i, sum): (usize, &Wide)| {
        let x = sum.value + f64::from(b1[i % h]);
        x * normal_cdf(x)
    };
    let hidden: Vec<f64> = products(&a, &w1, k).iter().enumerate().map(biased).collect();
    let mut want = Vec::new();
    for (hidden, residual) in hidden.chunks_exact(h).zip(residual.chunks_exact(n)) {
        for (j, w) in w2.chunks_exact(h).enumerate() {
            let mut sum = Wide::of(0.0, 0.0);
            hidden.iter().zip(w).for_each(|(x, w)| sum.add(x * f64::from(*w)));
            sum.add(f64::from(b2[j]));
            sum.add(f64::from(residual[j]));
            want.push(sum);
        }
    }
    compare(&got, &want, |i| format!("row {}, column {}", i / n, i % n))
}

fn unit_rows(trial: &Trial<'_>) -> Result<Finding, Failure> {
    let (m, k, n) = (100, 20, 33);
    let mut a = noise(m * k, 11, 1.0);
    let mut rng = Noise::new(12);
    for (row, a) in a.chunks_exact_mut(k).enumerate() {
        let size = [0.0, 1.0, 1e-30, 1e30][row % 4];
        a.iter_mut().for_each(|v| *v = rng.float() * size);
    }
    let w = noise(n * k, 13, 1.0);
    let packed = PackedMatrix::from_strided(&w, k, n, 1, k);
    let got = trial.one_and_many(|| {
        let mut out = vec![0.0; m * n];
        gemm_unit_rows(&a, &packed, None, &mut out);
        Ok(out)
    })?;
    let mut want = products(&a, &w, k);
    for row in want.chunks_exact_mut(n) {
        let norm = row.iter().map(|v| v.value * v.value).sum::<f64>().sqrt();
        // Norms below 1e-12 count as that: a zero row stays zero.
        row.iter_mut().for_each(|v| *v = Wide::of(v.value / norm.max(1e-12), 1.0));
    }
    compare(&got, &want, |i| format!("row {}, column {}", i / n, i % n))
}

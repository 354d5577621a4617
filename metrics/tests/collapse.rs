//! Indicators of a collapse against formulas, and on rows that have none.

#![allow(clippy::unwrap_used, reason = "a test may fail loudly")]

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scenesplat_metrics::{Collapse, FeatureFn, FeatureSlice, collapse};

/// Entropy and pairs in f64, from eigenvalues that are known by construction.
const F64_EPS: f64 = 1e-9;

fn run(values: &[f32], dim: usize) -> Collapse {
    collapse(&FeatureSlice::new(values, dim).unwrap(), 0).unwrap()
}

fn noise(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| rng.random_range(-1.0..1.0f32)).collect()
}

/// Mean cosine of all pairs, one after another.
fn pairs(values: &[f32], dim: usize) -> f64 {
    let n = values.len() / dim;
    let mean: Vec<f64> = (0..dim)
        .map(|j| (0..n).map(|i| f64::from(values[i * dim + j])).sum::<f64>() / n as f64)
        .collect();
    let row = |i: usize| -> Vec<f64> {
        (0..dim).map(|j| f64::from(values[i * dim + j]) - mean[j]).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut total = 0.0;
    for i in 0..n {
        for j in (0..n).filter(|j| *j != i) {
            let (a, b) = (row(i), row(j));
            total += dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt();
        }
    }
    total / (n * (n - 1)) as f64
}

/// The eigenvalues' entropy by Jacobi's rotations.
fn rank(values: &[f32], dim: usize) -> f64 {
    let n = values.len() / dim;
    let at = |i: usize, j: usize| f64::from(values[i * dim + j]);
    let mean: Vec<f64> =
        (0..dim).map(|j| (0..n).map(|i| at(i, j)).sum::<f64>() / n as f64).collect();
    let mut a = vec![vec![0.0; dim]; dim];
    for j in 0..dim {
        for k in 0..dim {
            a[j][k] = (0..n).map(|i| (at(i, j) - mean[j]) * (at(i, k) - mean[k])).sum();
        }
    }
    for _ in 0..60 {
        for p in 0..dim {
            for q in p + 1..dim {
                if a[p][q].abs() < 1e-300 {
                    continue;
                }
                let theta = 0.5 * (2.0 * a[p][q]).atan2(a[q][q] - a[p][p]);
                let (s, c) = theta.sin_cos();
                for k in 0..dim {
                    let (x, y) = (a[k][p], a[k][q]);
                    (a[k][p], a[k][q]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..dim {
                    let (x, y) = (a[p][k], a[q][k]);
                    (a[p][k], a[q][k]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
    }
    let total: f64 = (0..dim).map(|i| a[i][i]).sum();
    let shares = (0..dim).map(|i| (a[i][i] / total).max(0.0)).filter(|p| *p > 1e-15);
    shares.map(|p| -p * p.ln()).sum::<f64>().exp()
}

#[test]
fn against_the_formulas() {
    for (n, dim) in [(2, 3), (3, 1), (5, 9), (40, 6), (200, 24)] {
        let mut values = noise(n * dim, n as u64);
        // Channels of different strength, and a part that all rows share.
        for (i, v) in values.iter_mut().enumerate() {
            *v = *v / (1.0 + (i % dim) as f32) + 3.0;
        }
        let found = run(&values, dim);
        let (rank, pairs) = (rank(&values, dim), pairs(&values, dim));
        let got = found.effective_rank.unwrap();
        assert!((got - rank).abs() < 1e-7 * rank, "{n}·{dim}: {got} and {rank}");
        let got = found.centred_cosine.unwrap();
        assert!((got - pairs).abs() < F64_EPS, "{n}·{dim}: {got} and {pairs}");
        assert_eq!(found.rows, n);
    }
}

#[test]
fn known_ranks() {
    // ± each axis: D equal eigenvalues.
    for dim in [1, 2, 7, 64] {
        let mut values = vec![0f32; 2 * dim * dim];
        for i in 0..dim {
            values[2 * i * dim + i] = 1.0;
            values[(2 * i + 1) * dim + i] = -1.0;
        }
        let found = run(&values, dim);
        assert!((found.effective_rank.unwrap() - dim as f64).abs() < F64_EPS, "{dim}");
    }
    // On a line, however far away and however long.
    for scale in [1e-20f32, 1.0, 1e20] {
        let values: Vec<f32> = (0..50)
            .flat_map(|i| [i as f32 * scale, 7.0 * scale, -2.0 * i as f32 * scale])
            .collect();
        let found = run(&values, 3);
        assert!((found.effective_rank.unwrap() - 1.0).abs() < 1e-6, "{scale:e}: {found:?}");
    }
    // One outlier: all other rows lie on the other side of the mean.
    let mut values = vec![1f32; 100 * 4];
    values[0] = 50.0;
    let found = run(&values, 4);
    assert!((found.centred_cosine.unwrap() - (99.0 * 98.0 - 2.0 * 99.0) / 9900.0).abs() < F64_EPS);
}

#[test]
fn rows_that_do_not_differ() {
    let none = Collapse { rows: 0, effective_rank: None, centred_cosine: None };
    assert_eq!(run(&[], 5), none);
    assert_eq!(run(&[1.0, 2.0], 2), Collapse { rows: 1, ..none });
    let equal = Collapse { effective_rank: Some(0.0), ..none };
    assert_eq!(run(&[0.1, 0.2, 0.1, 0.2], 2), Collapse { rows: 2, ..equal });
    let row = noise(33, 3);
    let values: Vec<f32> = row.iter().copied().cycle().take(33 * 777).collect();
    assert_eq!(run(&values, 33), Collapse { rows: 777, ..equal });
    assert_eq!(run(&vec![0.0; 99], 3), Collapse { rows: 33, ..equal });
    // Two different rows lie opposite each other.
    let two = run(&[0.0, 1.0, 0.5, 0.0], 2);
    assert!((two.effective_rank.unwrap() - 1.0).abs() < F64_EPS);
    assert!((two.centred_cosine.unwrap() + 1.0).abs() < F64_EPS);
}

#[test]
fn values_of_any_size() {
    let values = noise(40 * 5, 9);
    let want = run(&values, 5);
    for factor in [1e-38f32, 1e-20, 1e20, 3e38] {
        let scaled: Vec<f32> = values.iter().map(|v| v * factor).collect();
        let found = run(&scaled, 5);
        // Values below 1e-38 lose digits.
        let (a, b) = (found.effective_rank.unwrap(), want.effective_rank.unwrap());
        assert!((a - b).abs() < 1e-4, "{factor:e}: {a} and {b}");
    }
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut values = values.clone();
        values[17] = bad;
        let message = collapse(&FeatureSlice::new(&values, 5).unwrap(), 0).unwrap_err().to_string();
        assert!(message.contains(&format!("features[3, 2] is {bad}")), "{message}");
    }
}

#[test]
fn many_rows_are_sampled_by_the_seed() {
    let fill = |rows: std::ops::Range<usize>, out: &mut [f32]| {
        for (row, out) in rows.zip(out.chunks_exact_mut(8)) {
            out.copy_from_slice(&noise(8, row as u64));
        }
        Ok(())
    };
    let features = FeatureFn::new(30_000, 8, fill).unwrap();
    let found = collapse(&features, 1).unwrap();
    assert_eq!(found.rows, 4096);
    assert_eq!(found, collapse(&features, 1).unwrap());
    assert_ne!(found, collapse(&features, 2).unwrap());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(found, pool.install(|| collapse(&features, 1).unwrap()));
    // Eight equally strong channels, seen through 4096 rows.
    assert!((found.effective_rank.unwrap() - 8.0).abs() < 0.05, "{found:?}");
    assert!(found.centred_cosine.unwrap().abs() < 1e-3, "{found:?}");
}

/// The width of the language features.
#[test]
fn wide_rows() {
    let values = noise(4096 * 768, 5);
    let found = run(&values, 768);
    let rank = found.effective_rank.unwrap();
    // Marchenko–Pastur with ratio 768 / 4096: the entropy is less than full by about ratio / 2.
    let want = 768.0 * (-768.0f64 / 4096.0 / 2.0).exp();
    assert!((rank - want).abs() < 0.02 * want, "{rank} and {want}");
}

use super::packed::Unit;
use super::*;
use crate::Precision;
use crate::simd::Isa;
use crate::tests::{max_error, on_threads, random, rounded};
use scenesplat_test_support::reference;

/// Rows, k, columns.
pub(crate) const SHAPES: [(usize, usize, usize); 10] = [
    (1, 1, 1),
    (2, 2, 3),
    (5, 11, 3),
    (6, 16, 16),
    (7, 33, 20),
    (31, 64, 48),
    (193, 400, 50),
    (13, 768, 130),
    (40, 801, 64),
    (200, 1600, 192),
];

#[test]
fn agrees_with_f64_for_odd_shapes() {
    for (m, k, n) in SHAPES {
        let (a, w) = (random(m * k, 1), random(n * k, 2));
        let (bias, residual) = (random(n, 3), random(m * n, 4));
        let packed = PackedMatrix::from_strided(&w, k, n, 1, k);
        let mut out = vec![f32::NAN; m * n];
        let epilogue = Epilogue { bias: Some(&bias), gelu: false, residual: Some(&residual) };
        gemm(&a, &packed, epilogue, &mut out);
        let mut want = reference::matmul_nt(&a, &w, m, k, n);
        for i in 0..m * n {
            want[i] += f64::from(bias[i % n]) + f64::from(residual[i]);
        }
        let error = max_error(&out, &want);
        assert!(error < 3e-7 * (k as f64).sqrt() * 3.0, "{m}x{k}x{n}: {error}");
    }
}

#[test]
fn nothing_is_written_beyond_the_columns_that_exist() {
    for precision in Precision::ALL {
        for n in [1, 7, 15, 16, 17, 36, 60, 63, 65, 72, 130] {
            let (m, k) = (13, 400);
            let (a, w) = (random(m * k, 1), random(n * k, 2));
            let packed = PackedMatrix::from_strided_with(precision, &w, k, n, 1, k);
            let mut out = vec![f32::NAN; m * n + 64];
            gemm(&a, &packed, Epilogue::default(), &mut out[..m * n]);
            assert!(out[m * n..].iter().all(|v| v.is_nan()), "{precision}: {n} columns");
            assert!(out[..m * n].iter().all(|v| v.is_finite()), "{precision}: {n} columns");
        }
    }
}

#[test]
fn rows_of_unit_length_are_those_of_the_plain_product() {
    for (m, k, n) in [(1, 5, 3), (97, 72, 770), (300, 40, 64), (2, 0, 4)] {
        let (a, w, bias) = (random(m * k, 1), random(n * k, 2), random(n, 3));
        let packed = PackedMatrix::from_strided(&w, k, n, 1, k);
        let mut want = vec![0.0; m * n];
        gemm(&a, &packed, Epilogue { bias: Some(&bias), ..Epilogue::default() }, &mut want);
        crate::normalize::normalize_rows(&mut want, n);
        let mut got = vec![f32::NAN; m * n];
        gemm_unit_rows(&a, &packed, Some(&bias), &mut got);
        assert_eq!(got, want, "{m}x{k}x{n}");
    }
}

#[test]
fn transposed_product_agrees_with_f64() {
    for (rows, m, n) in
        [(0, 3, 5), (1, 7, 20), (1, 5, 16), (700, 33, 18), (3001, 70, 112), (20_000, 16, 32)]
    {
        let a = random(rows * m, 7);
        let b = random(rows * n, 8);
        let mut out = vec![f32::NAN; m * n];
        gemm_tn(&a, m, &b, n, None, &mut out);
        let want = reference::matmul_tn(&a, &b, rows, m, n);
        let error = max_error(&out, &want);
        assert!(error < 1e-6 * (rows as f64).sqrt().max(1.0) * 4.0, "{rows}: {error}");
    }
}

#[test]
fn transposed_product_over_pairs() {
    for (rows, m, n) in [(50, 9, 21), (50, 9, 32), (50, 200, 16)] {
        let a = random(rows * m, 9);
        let b = random(rows * n, 10);
        let ra: Vec<u32> = (0..900).map(|i| (i * 7 % 50) as u32).collect();
        let rb: Vec<u32> = (0..900).map(|i| (i * 11 % 50) as u32).collect();
        let mut out = vec![0.0; m * n];
        gemm_tn(&a, m, &b, n, Some((&ra, &rb)), &mut out);
        let pick = |v: &[f32], w: usize, ids: &[u32]| -> Vec<f32> {
            ids.iter().flat_map(|&r| v[r as usize * w..(r as usize + 1) * w].to_vec()).collect()
        };
        let want = reference::matmul_tn(&pick(&a, m, &ra), &pick(&b, n, &rb), 900, m, n);
        // Every row meets 18 times: sums of correlated terms.
        assert!(max_error(&out, &want) < 3e-4);
    }
}

#[test]
fn mlp_agrees_with_f64() {
    let (m, k, h, n) = (205, 24, 96, 40);
    let (a, w1, b1) = (random(m * k, 11), random(h * k, 12), random(h, 13));
    let (w2, b2) = (random(n * h, 14), random(n, 15));
    let mut out = vec![0.0; m * n];
    mlp(
        &a,
        (&PackedMatrix::from_strided(&w1, k, h, 1, k), &b1),
        &PackedMatrix::from_strided(&w2, h, n, 1, h),
        Epilogue { bias: Some(&b2), ..Epilogue::default() },
        &mut out,
    );
    let mut hidden = reference::matmul_nt(&a, &w1, m, k, h);
    for (i, v) in hidden.iter_mut().enumerate() {
        *v = reference::gelu(*v + f64::from(b1[i % h]));
    }
    let mut want = vec![0f64; m * n];
    for r in 0..m {
        for j in 0..n {
            want[r * n + j] = f64::from(b2[j])
                + (0..h).map(|p| hidden[r * h + p] * f64::from(w2[j * h + p])).sum::<f64>();
        }
    }
    assert!(max_error(&out, &want) < 2e-5, "{}", max_error(&out, &want));
}

#[test]
fn bf16_is_the_product_of_rounded_operands() {
    for (m, k, n) in SHAPES {
        let (a, w, bias) = (random(m * k, 1), random(n * k, 2), random(n, 3));
        let want = reference::matmul_nt(&rounded(&a), &rounded(&w), m, k, n);
        let check = |packed: &PackedMatrix| {
            let mut out = vec![f32::NAN; m * n];
            let epilogue = Epilogue { bias: Some(&bias), ..Epilogue::default() };
            gemm(&a, packed, epilogue, &mut out);
            let want: Vec<f64> =
                want.iter().enumerate().map(|(i, w)| w + f64::from(bias[i % n])).collect();
            let error = max_error(&out, &want);
            assert!(error < 2e-6 * (k as f64).sqrt(), "{m}x{k}x{n} {:?}: {error}", packed.unit());
        };
        check(&PackedMatrix::from_strided_with(Precision::Bf16, &w, k, n, 1, k));
        check(&PackedMatrix::for_unit(Unit::RoundedVector, &w, k, n, 1, k));
    }
}

#[test]
fn split_operands_come_close_to_f32() {
    for (m, k, n) in SHAPES {
        let (a, w) = (random(m * k, 1), random(n * k, 2));
        // Rows and columns of very different size: the error is relative to each.
        let a: Vec<f32> = a
            .iter()
            .enumerate()
            .map(|(i, v)| v * 10f32.powi((i / k % 7) as i32 * 4 - 12))
            .collect();
        let want = reference::matmul_nt(&a, &w, m, k, n);
        let mut units = vec![Unit::of(Precision::F32Split, k, n)];
        if Isa::current() == Isa::Avx512Bf16 {
            units.push(Unit::SplitPairs);
        }
        for unit in units {
            let mut out = vec![f32::NAN; m * n];
            let packed = PackedMatrix::for_unit(unit, &w, k, n, 1, k);
            gemm(&a, &packed, Epilogue::default(), &mut out);
            for (got, want) in out.chunks_exact(n).zip(want.chunks_exact(n)) {
                let error: f64 =
                    got.iter().zip(want).map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
                let norm: f64 = want.iter().map(|w| w * w).sum();
                // A single product may cancel to nearly nothing; a long row cannot.
                let bound = if n * k > 100 { 2e-5 } else { 6e-5 };
                assert!(error <= norm * bound * bound, "{m}x{k}x{n} {unit:?}: {error} {norm}");
            }
        }
    }
}

#[test]
fn bf16_of_hard_values() {
    for precision in Precision::ALL {
        let (k, n) = (40, 17);
        let w = vec![1.0; k * n];
        let packed = PackedMatrix::from_strided_with(precision, &w, k, n, 1, k);
        let run = |set: &[(usize, f32)]| {
            let mut a = vec![0.0; k];
            set.iter().for_each(|(i, v)| a[*i] = *v);
            let mut out = vec![f32::NAN; n];
            gemm(&a, &packed, Epilogue::default(), &mut out);
            assert!(out.iter().all(|o| o.to_bits() == out[0].to_bits()));
            out[0]
        };
        assert_eq!(run(&[]), 0.0);
        assert!(run(&[(3, f32::NAN)]).is_nan());
        // The low part of the other factor is 0, so two parts make NaN of ∞.
        let infinite = run(&[(3, f32::INFINITY), (5, 2.0)]);
        let split = precision == Precision::F32Split && infinite.is_nan();
        assert!(infinite == f32::INFINITY || split, "{precision}: {infinite}");
        assert!(run(&[(3, f32::INFINITY), (5, f32::NEG_INFINITY)]).is_nan());
        assert_eq!(run(&[(0, 1e30), (1, -1e30), (39, 0.5)]), 0.5, "{precision}");
        assert!((run(&[(7, 1e-37)]) / 1e-37 - 1.0).abs() < 5e-3);
        if precision != Precision::Bf16 {
            assert!((run(&[(7, f32::MAX)]) / f32::MAX - 1.0).abs() < 1e-4, "{precision}");
        }
        let none = PackedMatrix::from_strided_with(precision, &[], 0, n, 1, 0);
        let mut out = vec![f32::NAN; 2 * n];
        gemm(&[], &none, Epilogue::default(), &mut out);
        assert_eq!(out, vec![0.0; 2 * n]);
    }
}

#[test]
fn any_precision_is_independent_of_threads_and_neighbors() {
    let (m, k, n) = (500, 500, 96);
    let (a, w) = (random(m * k, 5), random(k * n, 6));
    let mut packed = vec![PackedMatrix::for_unit(Unit::Quads, &w, k, n, n, 1)];
    packed.extend(
        Precision::ALL.map(|precision| PackedMatrix::from_strided_with(precision, &w, k, n, n, 1)),
    );
    for packed in packed {
        let run = |a: &[f32]| {
            let mut out = vec![f32::NAN; a.len() / k * n];
            gemm(a, &packed, Epilogue::default(), &mut out);
            out
        };
        let all = run(&a);
        for row in [0, 1, 191, 192, 333, 499] {
            let one = run(&a[row * k..(row + 1) * k]);
            assert_eq!(one, all[row * n..(row + 1) * n], "{:?} row {row}", packed.unit());
        }
        for threads in [1, 3] {
            assert_eq!(on_threads(threads, || run(&a)), all, "{:?}", packed.unit());
        }
    }
}

#[test]
fn weight_gradients_in_bf16() {
    let (rows, m, n) = (20_000, 20, 33);
    let (a, b) = (random(rows * m, 1), random(rows * n, 2));
    let mut out = vec![0.0; m * n];
    gemm_tn_with(Precision::Bf16, &a, m, &b, n, None, &mut out);
    let want = reference::matmul_tn(&rounded(&a), &rounded(&b), rows, m, n);
    assert!(max_error(&out, &want) < 2e-3, "{}", max_error(&out, &want));
}

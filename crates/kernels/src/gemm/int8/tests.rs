use super::super::packed::{Unit, Values};
use super::super::rows::multiply_quads;
use super::super::tests::SHAPES;
use super::super::{Epilogue, PackedMatrix, Product, RowPointers, gemm};
use super::*;
use crate::Precision;
use crate::tests::random;
use scenesplat_test_support::reference;

/// Also fewer rows than one, fewer channels than [`LEAST_CHANNELS`], more than a block of k, and all remainders.
fn shapes() -> impl Iterator<Item = (usize, usize, usize)> {
    SHAPES.into_iter().chain([(0, 64, 64), (40, 1535, 64), (20, 3203, 192)])
}

fn packed(w: &[f32], k: usize, n: usize) -> PackedMatrix {
    PackedMatrix::for_unit(Unit::Quads, w, k, n, 1, k)
}

fn product(a: &[f32], b: &PackedMatrix, m: usize) -> Vec<f32> {
    let mut out = vec![f32::NAN; m * b.n()];
    gemm(a, b, Epilogue::default(), &mut out);
    out
}

/// Integers and scales of rows of `k` values, in f64.
fn rounded(values: &[f32], k: usize) -> (Vec<f32>, Vec<f64>) {
    let mut scales = Vec::new();
    let mut integers = Vec::new();
    for row in values.chunks_exact(k) {
        let most = row.iter().fold(0f64, |most, x| most.max(f64::from(x.abs())));
        scales.push(most / 127.0);
        let integer = |x: &f32| if most > 0.0 { f64::from(*x) / most * 127.0 } else { 0.0 };
        integers.extend(row.iter().map(|x| integer(x).round_ties_even() as f32));
    }
    (integers, scales)
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

#[test]
fn it_is_the_product_of_integers_and_near_the_exact_one() {
    for (m, k, n) in shapes() {
        let (mut a, w) = (random(m * k, 1), random(n * k, 2));
        // Rows of very different size: each has its own scale.
        a.iter_mut().enumerate().for_each(|(i, v)| *v *= 10f32.powi((i / k % 9) as i32 * 8 - 32));
        let got = product(&a, &packed(&w, k, n), m);
        let ((a8, row), (w8, column)) = (rounded(&a, k), rounded(&w, k));
        let sums = reference::matmul_nt(&a8, &w8, m, k, n);
        let exact = reference::matmul_nt(&a, &w, m, k, n);
        for i in 0..m {
            let of = i * n..(i + 1) * n;
            let want: Vec<f64> =
                sums[of.clone()].iter().zip(&column).map(|(s, c)| s * row[i] * c).collect();
            let (got, exact) = (&got[of.clone()], &exact[of]);
            let differences = |to: &[f64]| norm(got.iter().zip(to).map(|(g, t)| f64::from(*g) - t));
            // One value in a thousand lies so near to the middle between two integers that f32 and
            // f64 round it apart.
            let same = differences(&want) / norm(want.iter().copied()).max(1e-30);
            assert!(same < 2e-3, "{m}x{k}x{n} row {i}: {same} from the integers' product");
            if k * n > 100 {
                let near = differences(exact) / norm(exact.iter().copied());
                assert!(near < 1.5e-2, "{m}x{k}x{n} row {i}: {near} from the exact product");
            }
        }
    }
}

#[test]
fn integers_are_the_nearest_and_of_any_length() {
    for k in [1_usize, 3, 4, 15, 16, 17, 63, 64, 65, 1000] {
        let x: Vec<f32> = (0..k).map(|i| (i as f32 * 0.37 + 0.2).sin() * 3e5).collect();
        let mut words = vec![7; k.div_ceil(4) + 2];
        let scale = quantize(&x, &mut words);
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_ne_bytes()).collect();
        for (x, byte) in x.iter().zip(&bytes) {
            let integer = f32::from(*byte) - 128.0;
            assert!(
                (x / scale - integer).abs() <= 0.5001 && integer.abs() <= 127.0,
                "{x} {integer}"
            );
        }
        assert_eq!(bytes.iter().zip(&x).filter(|(b, _)| matches!(b, 1 | 255)).count().min(1), 1);
        assert_eq!(words[k.div_ceil(4)..], [7; 2], "{k}");
    }
}

#[test]
fn all_versions_have_the_same_bits() {
    let there: Vec<Dots> = Dots::ALL.into_iter().filter(|d| d.is_there()).collect();
    assert!(there.contains(&Dots::Plain) && there.contains(&Dots::current()));
    for (m, k, n) in shapes() {
        let (mut a, mut w) = (random(m * k, 3), random(n * k, 4));
        // Both ends of the integers meet.
        a.iter_mut().step_by(3).for_each(|v| *v = v.signum());
        w.iter_mut().step_by(2).for_each(|v| *v = v.signum());
        let b = packed(&w, k, n);
        let Values::Quads(quads) = &b.values else { panic!("{:?}", b.unit()) };
        let stride = b.row_words();
        let mut rows = vec![0; m * stride];
        for (to, from) in rows.chunks_exact_mut(stride).zip(a.chunks_exact(k)) {
            b.unit().prepare_words(from, to);
        }
        for accumulate in [false, true] {
            let results = there.iter().map(|&dots| {
                let mut out = random(m * n, 5);
                let from = RowPointers::of(&rows, stride, None);
                let c = RowPointers { base: out.as_mut_ptr(), stride: n, ids: None };
                let columns = 0..b.padded_n();
                let product = Product { rows: m, b: &b, columns, c, accumulate };
                // SAFETY: rows and results of these sizes; the version is there.
                unsafe { multiply_quads(dots, from, quads, product) };
                out.into_iter().map(f32::to_bits).collect::<Vec<_>>()
            });
            let results: Vec<_> = results.collect();
            #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
            if super::super::amx::available() && super::super::amx::has_bytes() && !accumulate {
                let tiles = PackedMatrix::for_unit(Unit::QuadTiles, &w, k, n, 1, k);
                let bits: Vec<u32> = product(&a, &tiles, m).into_iter().map(f32::to_bits).collect();
                assert!(bits == results[0], "{m}x{k}x{n} tiles");
            }
            for (dots, result) in there.iter().zip(&results) {
                assert!(*result == results[0], "{m}x{k}x{n} {dots:?} accumulate {accumulate}");
            }
        }
    }
}

#[test]
fn versions_are_the_same_compiled_for_any_instruction_set() {
    // The loops that make integers are plain ones; this is what they must give on any CPU.
    let x =
        [0.0, -0.0, 1.0, -1.0, 0.5, 0.003_937, 0.003_938, f32::MIN_POSITIVE, 0.996_06, 0.996_07];
    let mut words = [0; 3];
    let scale = quantize(&x, &mut words);
    let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_ne_bytes()).collect();
    assert_eq!(scale, 1.0 / 127.0);
    // 0.5 · 127 = 63.5 goes to the even 64; half a step is 0.0039370079.
    assert_eq!(bytes[..10], [128, 128, 255, 1, 192, 128, 129, 128, 254, 255]);
}

#[test]
fn hard_values_stay_what_they_are() {
    let (k, n) = (70, 65);
    let b = packed(&vec![1.0; k * n], k, n);
    let run = |set: &[(usize, f32)]| {
        let mut a = vec![0.0; k];
        set.iter().for_each(|(i, v)| a[*i] = *v);
        let out = product(&a, &b, 1);
        assert!(out.iter().all(|o| o.to_bits() == out[0].to_bits()), "{set:?}");
        out[0]
    };
    assert_eq!(run(&[]).to_bits(), 0);
    for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert!(run(&[(3, bad)]).is_nan() && run(&[(3, bad), (69, 1.0)]).is_nan(), "{bad}");
    }
    for size in [1e38, 1e30, 1.0, 1e-20, 1e-30, 1e-31, 1e-36, 1e-37, 1e-38, 1e-39, 1e-41f32] {
        for sign in [1.0, -1.0] {
            let got = run(&[(7, sign * size), (68, sign * size)]);
            let relative = f64::from(got) / f64::from(size) / 2.0 - f64::from(sign);
            assert!(relative.abs() < if size < 2e-38 { 2e-2 } else { 1e-5 }, "{size}: {got}");
        }
    }
    // Less than half a step of the row's largest value is lost: that is what 8 bits are.
    assert_eq!(run(&[(0, 1.0), (1, -1.0), (2, 0.003)]), 0.0);
    // A bad value stays in its row.
    let mut a = random(3 * k, 1);
    let clean = product(&a, &b, 3);
    a[k + 5] = f32::NAN;
    let spoilt = product(&a, &b, 3);
    assert!(spoilt[n..2 * n].iter().all(|v| v.is_nan()));
    assert_eq!((&spoilt[..n], &spoilt[2 * n..]), (&clean[..n], &clean[2 * n..]));
}

#[test]
fn hard_columns_stay_what_they_are() {
    let (m, k, n) = (9, 66, 70);
    let (a, mut w) = (random(m * k, 1), random(n * k, 2));
    w[3 * k..4 * k].fill(0.0);
    let clean = product(&a, &packed(&w, k, n), m);
    assert!(clean.chunks_exact(n).all(|row| row[3] == 0.0));
    for (column, bad) in [(0, f32::NAN), (17, f32::INFINITY), (69, f32::NEG_INFINITY)] {
        let mut w = w.clone();
        w[column * k + 65] = bad;
        let spoilt = product(&a, &packed(&w, k, n), m);
        for (i, (got, want)) in spoilt.iter().zip(&clean).enumerate() {
            assert!(if i % n == column { got.is_nan() } else { got == want }, "{bad} {i}");
        }
    }
}

#[test]
fn narrow_matrices_compute_in_f32() {
    for (k, n, want) in [(63, 64, false), (64, 63, false), (64, 64, true), (768, 20, false)] {
        let packed =
            PackedMatrix::from_strided_with(Precision::Int8, &vec![1.0; k * n], k, n, 1, k);
        assert_eq!(matches!(packed.unit(), Unit::Quads | Unit::QuadTiles), want, "[{k}, {n}]");
        // A byte a value, and two words for each column.
        let bytes = if want { k * n + 8 * n } else { 4 * k * n.next_multiple_of(16) };
        assert_eq!(packed.bytes(), bytes, "[{k}, {n}]");
    }
}

#[test]
fn either_stride_packs_the_same() {
    let (k, n) = (130, 67);
    let w = random(k * n, 1);
    let turned: Vec<f32> = (0..k * n).map(|i| w[i % n * k + i / n]).collect();
    let a = random(5 * k, 2);
    let one = product(&a, &packed(&w, k, n), 5);
    assert_eq!(product(&a, &PackedMatrix::for_unit(Unit::Quads, &turned, k, n, n, 1), 5), one);
}

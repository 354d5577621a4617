//! Linear layers and convolutions.

use crate::support::{close, gpu, random, rows, stored, values};
use scenesplat_gpu::ops::product::{NONE, Product, Weights, product};
use scenesplat_gpu::ops::{Rows, Stored};
use scenesplat_gpu::{Array, Gpu, GpuError};
use scenesplat_kernels::kernel_map::KernelMap;
use scenesplat_test_support::reference;

/// Rows times a matrix plus bias in f64.
fn linear(x: &[f32], w: &[f32], bias: &[f32], [m, k, n]: [usize; 3]) -> Vec<f64> {
    let mut out = reference::matmul_nt(x, w, m, k, n);
    for (i, value) in out.iter_mut().enumerate() {
        *value += f64::from(bias[i % n]);
    }
    out
}

fn weights(gpu: &Gpu, w: &[f32], bias: Option<&[f32]>, shape: [usize; 3], s: Stored) -> Weights {
    Weights::upload(gpu, w, bias, shape, s).unwrap()
}

#[test]
pub fn linear_layers_follow_the_formula_at_every_width() {
    let Some(gpu) = gpu() else { return };
    for (stored, rounding) in stored(&gpu) {
        for (m, k, n) in
            [(1, 1, 1), (2, 11, 32), (65, 17, 33), (130, 64, 192), (70, 96, 5), (3, 768, 41)]
        {
            let (x, w, bias) = (random(m * k, 1), random(n * k, 2), random(n, 3));
            let layer = weights(&gpu, &w, Some(&bias), [n, 1, k], stored);
            let mut commands = gpu.commands();
            let input = rows(&gpu, &x, k, stored);
            let out = product(&mut commands, &input, &layer, &Product::default()).unwrap();
            let want = linear(&x, &w, &bias, [m, k, n]);
            close("linear", &out.read(&mut commands).unwrap(), &want, rounding * 2.0);
            // GELU, and a residual behind it.
            let beside = random(m * n, 4);
            let residual = rows(&gpu, &beside, n, stored);
            let how = Product { gelu: true, residual: Some(&residual), ..Product::default() };
            let out = product(&mut commands, &input, &layer, &how).unwrap();
            let want: Vec<f64> = want
                .iter()
                .zip(&beside)
                .map(|(v, r)| reference::gelu(*v) + f64::from(*r))
                .collect();
            close("linear, gelu", &out.read(&mut commands).unwrap(), &want, rounding * 2.0);
        }
    }
}

#[test]
pub fn lists_say_which_rows_are_read_and_where_results_go() {
    let Some(gpu) = gpu() else { return };
    let (m, k, n) = (100, 20, 48);
    let (x, w, bias) = (random(m * k, 1), random(n * k, 2), random(n, 3));
    let layer = weights(&gpu, &w, Some(&bias), [n, 1, k], Stored::F32);
    let input = rows(&gpu, &x, k, Stored::F32);
    let want = linear(&x, &w, &bias, [m, k, n]);
    let from: Vec<u32> = (0..70).map(|i| i * 37 % 100).collect();
    let to: Vec<u32> = (0..70).map(|i| 79 - i).collect();
    // The lists begin with entries that do not count, and source rows are counted from 5.
    let longer = |list: &[u32], base: u32| {
        let list: Vec<u32> = [7, 7, 7].into_iter().chain(list.iter().map(|r| r + base)).collect();
        gpu.upload("list", &list).unwrap()
    };
    let (from_list, to_list) = (longer(&from, 5), longer(&to, 0));
    let before = random(80 * n, 5);
    let into = rows(&gpu, &before, n, Stored::F32);
    let residual = random(9 * n, 6);
    let residual_rows: Vec<u32> = (0..80).map(|i| i % 9).collect();
    let how = Product {
        range: Some(3..73),
        gather: Some(&from_list),
        base: 5,
        scatter: Some(&to_list),
        into: Some(&into),
        residual: Some(&rows(&gpu, &residual, n, Stored::F32)),
        residual_rows: Some(&gpu.upload("list", &residual_rows).unwrap()),
        ..Product::default()
    };
    let mut commands = gpu.commands();
    let out = product(&mut commands, &input, &layer, &how).unwrap();
    let mut expected: Vec<f64> = before.iter().map(|v| f64::from(*v)).collect();
    for (from, to) in from.iter().zip(&to) {
        for c in 0..n {
            let beside = residual[(*to as usize % 9) * n + c];
            expected[*to as usize * n + c] = want[*from as usize * n + c] + f64::from(beside);
        }
    }
    close("lists", &out.read(&mut commands).unwrap(), &expected, 2e-6);
    // Rows 0 to 9 were not named: they keep every bit.
    let got = values(&gpu, &into);
    assert_eq!(got[..10 * n], before[..10 * n]);
    // Without a list for it, the residual is that of the place where a result goes.
    let beside = random(80 * n, 7);
    let beside_rows = rows(&gpu, &beside, n, Stored::F32);
    let how = Product { residual: Some(&beside_rows), residual_rows: None, ..how };
    let out = product(&mut commands, &input, &layer, &how).unwrap();
    for (from, to) in from.iter().zip(&to) {
        for c in 0..n {
            let at = *to as usize * n + c;
            expected[at] = want[*from as usize * n + c] + f64::from(beside[at]);
        }
    }
    close("a residual by place", &out.read(&mut commands).unwrap(), &expected, 2e-6);
}

/// Scattered voxels of two scenes.
fn voxels() -> (Vec<[i32; 3]>, Vec<usize>) {
    let mut cells = Vec::new();
    for i in 0..90 {
        let cell = [i * 7 % 6, i * 5 % 7, i * 3 % 5];
        if !cells.contains(&cell) {
            cells.push(cell);
        }
    }
    let first = cells.len();
    cells.extend([[0, 0, 0], [0, 0, 1], [9, 9, 9]]);
    let offsets = vec![0, first, cells.len()];
    (cells, offsets)
}

/// Table of source rows. `[taps, range]`
fn table(gpu: &Gpu, map: &KernelMap, range: std::ops::Range<usize>) -> Array<u32> {
    let mut all = vec![NONE; map.taps() * range.len()];
    for tap in 0..map.taps() {
        let (from, to) = map.tap_pairs(tap);
        for (from, to) in from.into_iter().zip(to) {
            if range.contains(&(to as usize)) {
                all[tap * range.len() + to as usize - range.start] = from;
            }
        }
    }
    gpu.upload("table", &all).unwrap()
}

#[test]
pub fn convolutions_follow_the_formula_whole_and_in_ranges() {
    let Some(gpu) = gpu() else { return };
    let (cells, offsets) = voxels();
    let n = cells.len();
    for (stored, rounding) in stored(&gpu) {
        for (size, cin, cout) in [(3, 16, 32), (3, 7, 70), (5, 11, 32)] {
            let map = KernelMap::build(&cells, &offsets, size).unwrap();
            let (x, w) = (random(n * cin, 1), random(cout * map.taps() * cin, 2));
            let bias = random(cout, 3);
            let want =
                reference::submanifold_conv(&cells, &offsets, &x, cin, &w, Some(&bias), size);
            let layer = weights(&gpu, &w, Some(&bias), [cout, map.taps(), cin], stored);
            let input = rows(&gpu, &x, cin, stored);
            let mut commands = gpu.commands();
            let whole = table(&gpu, &map, 0..n);
            let how = Product { table: Some(&whole), ..Product::default() };
            let out = product(&mut commands, &input, &layer, &how).unwrap();
            let got = out.read(&mut commands).unwrap();
            close("convolution", &got, &want, rounding * 2.0);
            // In two ranges, written into the same rows: the same bits.
            let into = rows(&gpu, &vec![0.0; n * cout], cout, stored);
            for range in [0..37, 37..n] {
                let part = table(&gpu, &map, range.clone());
                let how = Product {
                    range: Some(range),
                    table: Some(&part),
                    into: Some(&into),
                    ..Product::default()
                };
                product(&mut commands, &input, &layer, &how).unwrap();
            }
            assert_eq!(into.read(&mut commands).unwrap(), got);
        }
    }
}

#[test]
fn a_row_is_the_same_bits_alone_and_among_others_and_every_time() {
    let Some(gpu) = gpu() else { return };
    let (m, k, n) = (200, 48, 40);
    let (x, w) = (random(m * k, 1), random(n * k, 2));
    let layer = weights(&gpu, &w, None, [n, 1, k], Stored::F32);
    let run = |x: &[f32]| {
        let mut commands = gpu.commands();
        let input = rows(&gpu, x, k, Stored::F32);
        let out = product(&mut commands, &input, &layer, &Product::default()).unwrap();
        out.read(&mut commands).unwrap()
    };
    let all = run(&x);
    assert_eq!(run(&x), all);
    for row in [0, 63, 64, 199] {
        assert_eq!(run(&x[row * k..][..k]), all[row * n..][..n], "row {row}");
    }
}

#[test]
fn one_bad_row_spoils_no_other() {
    let Some(gpu) = gpu() else { return };
    let (m, k, n) = (70, 24, 33);
    let (x, w) = (random(m * k, 1), random(n * k, 2));
    let layer = weights(&gpu, &w, None, [n, 1, k], Stored::F32);
    let run = |x: &[f32], gelu| {
        let mut commands = gpu.commands();
        let input = rows(&gpu, x, k, Stored::F32);
        let how = Product { gelu, ..Product::default() };
        product(&mut commands, &input, &layer, &how).unwrap().read(&mut commands).unwrap()
    };
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3e38] {
        for gelu in [false, true] {
            let clean = run(&x, gelu);
            let mut spoiled = x.clone();
            spoiled[5 * k + 3] = bad;
            let got = run(&spoiled, gelu);
            for (i, (got, clean)) in got.iter().zip(&clean).enumerate() {
                assert!(i / n == 5 || got.to_bits() == clean.to_bits(), "{bad}: row {}", i / n);
            }
            if bad.is_nan() {
                assert!(got[5 * n..6 * n].iter().all(|v| v.is_nan()), "NaN is not lost");
            }
        }
    }
}

#[test]
fn sizes_that_do_not_fit_are_errors_and_no_rows_are_no_work() {
    let Some(gpu) = gpu() else { return };
    let layer = weights(&gpu, &random(12, 1), None, [4, 1, 3], Stored::F32);
    let mut commands = gpu.commands();
    let none = rows(&gpu, &[], 3, Stored::F32);
    let out = product(&mut commands, &none, &layer, &Product::default()).unwrap();
    assert_eq!((out.rows(), out.channels()), (0, 4));
    assert_eq!(out.read(&mut commands).unwrap(), Vec::<f32>::new());
    let wrong = rows(&gpu, &random(8, 1), 4, Stored::F32);
    let error = product(&mut commands, &wrong, &layer, &Product::default()).unwrap_err();
    assert!(matches!(&error, GpuError::Shape(m) if m.contains("rows of 4")), "{error}");
    let x = rows(&gpu, &random(9, 1), 3, Stored::F32);
    let list = gpu.upload("list", &[0u32, 1]).unwrap();
    let scatter = Product { scatter: Some(&list), ..Product::default() };
    assert!(product(&mut commands, &x, &layer, &scatter).is_err(), "nowhere to write to");
    let small = rows(&gpu, &random(4, 1), 4, Stored::F32);
    let residual = Product { residual: Some(&small), ..Product::default() };
    assert!(
        product(&mut commands, &x, &layer, &residual).is_err(),
        "a residual of one row for three"
    );
    assert!(Weights::upload(&gpu, &[1.0; 5], None, [2, 1, 3], Stored::F32).is_err());
    assert!(Rows::upload(&gpu, &[1.0; 5], 2, Stored::F32).is_err());
}

#[test]
fn numbers_too_large_for_16_bits_are_refused() {
    let Some(gpu) = gpu() else { return };
    if gpu.has_f16() {
        let error = Rows::upload(&gpu, &[1.0, 7e4], 2, Stored::F16).unwrap_err().to_string();
        assert!(error.contains("70000") && error.contains("f32"), "{error}");
        assert!(Rows::upload(&gpu, &[f32::INFINITY, f32::NAN], 2, Stored::F16).is_ok());
        assert!(Weights::upload(&gpu, &[-7e4], None, [1, 1, 1], Stored::F16).is_err());
    }
}

/// A device that goes away between recording and reading, and before anything is recorded.
#[test]
fn a_device_that_is_lost_gives_errors_from_then_on() {
    if gpu().is_none() {
        return;
    }
    let own = Gpu::open(&scenesplat_gpu::Choice::Best).unwrap();
    let layer = weights(&own, &random(12, 1), None, [4, 1, 3], Stored::F32);
    let x = rows(&own, &random(9, 1), 3, Stored::F32);
    let mut commands = own.commands();
    let out = product(&mut commands, &x, &layer, &Product::default()).unwrap();
    own.lose();
    let error = out.read(&mut commands).unwrap_err();
    assert!(matches!(error, GpuError::Lost(_)), "{error}");
    let error = Rows::upload(&own, &[1.0], 1, Stored::F32).unwrap_err();
    assert!(matches!(error, GpuError::Lost(_)), "{error}");
    let again = product(&mut own.commands(), &x, &layer, &Product::default());
    assert!(matches!(again.unwrap_err(), GpuError::Lost(_)));
    let own = Gpu::open(&scenesplat_gpu::Choice::Best).unwrap();
    own.lose();
    let error = Rows::upload(&own, &[1.0], 1, Stored::F32).unwrap_err();
    assert!(matches!(error, GpuError::Lost(_)), "{error}");
    let own = Gpu::open(&scenesplat_gpu::Choice::Best).unwrap();
    let x = rows(&own, &random(9, 1), 3, Stored::F32);
    let layer = weights(&own, &random(12, 1), None, [4, 1, 3], Stored::F32);
    own.lose();
    let error = product(&mut own.commands(), &x, &layer, &Product::default()).unwrap_err();
    assert!(matches!(error, GpuError::Lost(_)), "{error}");
}

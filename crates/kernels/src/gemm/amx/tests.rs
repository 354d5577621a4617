//! The tiles against plain loops.

use super::*;
use crate::gemm::bf16;
use crate::tests::{random, rounded};

fn tiles_or_say_so(test: &str) -> bool {
    let there = available();
    if !there {
        println!("{test}: not run, no AMX on this CPU or from this system");
    }
    there
}

fn pair(low: f32, high: f32) -> u32 {
    bf16::round(low) | bf16::round(high) << 16
}

/// Row-major `[rows, k]` values as pairs; a gap after each row and the rows up to a whole tile
/// are NaN. Returns the stride too.
fn pack_a(a: &[f32], rows: usize, k: usize) -> (Vec<u32>, usize) {
    let stride = k / 2 + 5;
    let mut pairs = vec![u32::MAX; rows.next_multiple_of(TILE) * stride];
    for i in 0..rows {
        for p in 0..k / 2 {
            let at = i * k + 2 * p;
            pairs[i * stride + p] = pair(a[at], a[at + 1]);
        }
    }
    (pairs, stride)
}

/// Row-major `[k, width]` values as pairs.
fn pack_b(b: &[f32], width: usize) -> Vec<u32> {
    let pairs =
        |rows: &[f32]| -> Vec<u32> { (0..width).map(|j| pair(rows[j], rows[width + j])).collect() };
    b.chunks_exact(2 * width).flat_map(pairs).collect()
}

#[derive(Clone, Copy, PartialEq, Debug)]
enum Rows {
    /// One after another.
    Dense,
    /// From the last to the first, with gaps of one value.
    Reversed,
    /// At places of no order.
    Scattered,
}

/// The product by [`panel`]; `old` are the values of `c` before it, to be added to.
fn product(
    (a, b): (&[f32], &[f32]),
    (rows, k, width): (usize, usize, usize),
    old: Option<&[f32]>,
    layout: Rows,
) -> Vec<f32> {
    const UNTOUCHED: f32 = -77.25;
    let (pairs, a_stride) = pack_a(a, rows, k);
    let b = pack_b(b, width);
    let place = |i: usize| match layout {
        Rows::Dense => i * width,
        Rows::Reversed => (rows - 1 - i) * (width + 1),
        // 7 and 193 have no common factor; more rows than 193 are not asked for.
        Rows::Scattered => i * 7 % 193 * (width + 3),
    };
    let len = (0..rows).map(|i| place(i) + width).max().unwrap_or(0) + 3;
    let mut c = vec![UNTOUCHED; len];
    for i in 0..rows {
        let at = place(i);
        match old {
            Some(old) => {
                c[at..at + width].copy_from_slice(&old[i * width..(i + 1) * width]);
            }
            // Must not be read.
            None => c[at..at + width].fill(f32::NAN),
        }
    }
    let base = c.as_mut_ptr();
    // SAFETY: places are inside `c` and apart; `a` has its surplus rows; tiles are available, as
    // every caller has checked.
    unsafe {
        let to: Vec<*mut f32> = (0..rows).map(|i| base.add(place(i))).collect();
        configure();
        let a = pairs.as_ptr();
        panel(Operands::Pairs, rows, a, a_stride, b.as_ptr(), width, &to, k / 2, old.is_some());
    }
    let mut out = Vec::new();
    for i in 0..rows {
        out.extend_from_slice(&c[place(i)..place(i) + width]);
        c[place(i)..place(i) + width].fill(UNTOUCHED);
    }
    assert!(c.iter().all(|&x| x == UNTOUCHED), "written beside the rows");
    out
}

/// `Σ a·b` and `Σ |a·b|` over the bf16-rounded operands, in f64.
fn reference((a, b): (&[f32], &[f32]), (rows, k, width): (usize, usize, usize)) -> Vec<(f64, f64)> {
    let [a, b] = [a, b].map(|v| rounded(v).into_iter().map(f64::from).collect::<Vec<_>>());
    let mut out = vec![(0.0, 0.0); rows * width];
    for i in 0..rows {
        for p in 0..k {
            for j in 0..width {
                let term = a[i * k + p] * b[p * width + j];
                let (sum, size) = &mut out[i * width + j];
                *sum += term;
                *size += term.abs();
            }
        }
    }
    out
}

/// A sum passes through at most so many roundings, each of half a unit in the last place of
/// something no larger than the sum of sizes.
fn tolerance(k: usize) -> f64 {
    (k / 32 + TILE + 2) as f64 * 0.5 * f64::from(f32::EPSILON)
}

#[test]
fn agrees_with_f64_of_rounded_operands() {
    if !tiles_or_say_so("agrees_with_f64_of_rounded_operands") {
        return;
    }
    for rows in [1, 2, 15, 16, 17, 31, 32, 33, 48, 192] {
        for width in [16, 32, 48, 64] {
            for k in [32, 64, 768] {
                let shape = (rows, k, width);
                let (a, b) = (random(rows * k, 1), random(k * width, 2));
                let old = random(rows * width, 3);
                let want = reference((&a, &b), shape);
                let plain = product((&a, &b), shape, None, Rows::Dense);
                let added = product((&a, &b), shape, Some(&old), Rows::Dense);
                for (i, &(sum, size)) in want.iter().enumerate() {
                    let error = (f64::from(plain[i]) - sum).abs();
                    assert!(error <= tolerance(k) * size, "{shape:?} at {i}: {error}");
                    let old = f64::from(old[i]);
                    let error = (f64::from(added[i]) - sum - old).abs();
                    let size = size + old.abs();
                    assert!(error <= tolerance(k) * size, "{shape:?} added at {i}: {error}");
                }
                for layout in [Rows::Reversed, Rows::Scattered] {
                    let again = product((&a, &b), shape, None, layout);
                    assert!(bits(&again) == bits(&plain), "{shape:?} {layout:?}");
                    let again = product((&a, &b), shape, Some(&old), layout);
                    assert!(bits(&again) == bits(&added), "{shape:?} {layout:?} added");
                }
            }
        }
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|x| x.to_bits()).collect()
}

/// Sums of small whole numbers have no rounding: each of the products must be there, once.
#[test]
fn whole_numbers_are_exact() {
    if !tiles_or_say_so("whole_numbers_are_exact") {
        return;
    }
    let whole =
        |len, seed| -> Vec<f32> { random(len, seed).iter().map(|x| (x * 100.0).round()).collect() };
    for shape in [(1, 32, 16), (50, 96, 48), (64, 768, 64), (33, 32, 32)] {
        let (rows, k, width) = shape;
        let (a, b) = (whole(rows * k, 4), whole(k * width, 5));
        let want: Vec<f32> =
            reference((&a, &b), shape).iter().map(|&(sum, _)| sum as f32).collect();
        assert_eq!(product((&a, &b), shape, None, Rows::Dense), want, "{shape:?}");
    }
}

#[test]
fn rows_and_cuts_of_k_never_change_a_bit() {
    if !tiles_or_say_so("rows_and_cuts_of_k_never_change_a_bit") {
        return;
    }
    let (rows, k, width) = (70, 192, 64);
    let (a, b) = (random(rows * k, 6), random(k * width, 7));
    let all = product((&a, &b), (rows, k, width), None, Rows::Dense);
    for row in [0, 15, 16, 31, 63, 69] {
        let one = product((&a[row * k..][..k], &b), (1, k, width), None, Rows::Dense);
        assert_eq!(bits(&one), bits(&all[row * width..][..width]), "row {row}");
    }
    for cut in [32, 96, 160] {
        let part = |from: usize, to: usize| -> Vec<f32> {
            a.chunks_exact(k).flat_map(|row| row[from..to].to_vec()).collect()
        };
        let (head, tail) = b.split_at(cut * width);
        let first = product((&part(0, cut), head), (rows, cut, width), None, Rows::Dense);
        let shape = (rows, k - cut, width);
        let both = product((&part(cut, k), tail), shape, Some(&first), Rows::Scattered);
        assert_eq!(bits(&both), bits(&all), "cut at {cut}");
    }
    let none = product((&[], &[]), (rows, 0, width), None, Rows::Scattered);
    assert!(none.iter().all(|&x| x == 0.0));
    assert_eq!(product((&[], &[]), (rows, 0, width), Some(&all), Rows::Dense), all);
}

/// The system saves the tiles of threads that take turns on a core, and each thread's first
/// use configures its own.
#[test]
fn threads_do_not_disturb_each_other() {
    if !tiles_or_say_so("threads_do_not_disturb_each_other") {
        return;
    }
    let shape = (48, 320, 64);
    let operands = |seed| (random(48 * 320, seed), random(320 * 64, seed + 100));
    let alone: Vec<Vec<u32>> = (0..4)
        .map(|seed| {
            let (a, b) = operands(seed);
            bits(&product((&a, &b), shape, None, Rows::Dense))
        })
        .collect();
    std::thread::scope(|scope| {
        for (seed, want) in (0..4).zip(&alone) {
            scope.spawn(move || {
                let (a, b) = operands(seed);
                for _ in 0..5 {
                    let got = product((&a, &b), shape, None, Rows::Scattered);
                    assert!(bits(&got) == *want, "thread {seed}");
                }
            });
        }
    });
}

#[test]
fn configuring_again_after_a_release() {
    if !tiles_or_say_so("configuring_again_after_a_release") {
        return;
    }
    let (a, b) = (random(20 * 64, 8), random(64 * 32, 9));
    let want = product((&a, &b), (20, 64, 32), None, Rows::Dense);
    // SAFETY: tiles are available, and nothing is in them between products.
    unsafe { asm!("tilerelease", options(nostack, preserves_flags)) };
    assert_eq!(product((&a, &b), (20, 64, 32), None, Rows::Dense), want);
}

#[test]
fn infinities_and_nan_stay_in_their_row_and_column() {
    if !tiles_or_say_so("infinities_and_nan_stay_in_their_row_and_column") {
        return;
    }
    let shape @ (rows, k, width) = (35, 64, 48);
    let positive =
        |len, seed| -> Vec<f32> { random(len, seed).iter().map(|x| x.abs() + 0.5).collect() };
    let (mut a, mut b) = (positive(rows * k, 10), positive(k * width, 11));
    a[3 * k + 7] = f32::NAN;
    a[20 * k + 60] = f32::INFINITY;
    a[34 * k + 1] = f32::NEG_INFINITY;
    a[5 * k + 31] = 1e30;
    b[31 * width + 40] = 1e30;
    b[9 * width + 17] = f32::NAN;
    let out = product((&a, &b), shape, None, Rows::Dense);
    for i in 0..rows {
        for j in 0..width {
            let x = out[i * width + j];
            let right = match (i, j) {
                (3, _) | (_, 17) => x.is_nan(),
                (20, _) => x == f32::INFINITY,
                (34, _) => x == f32::NEG_INFINITY,
                (5, 40) => x == f32::INFINITY,
                _ => x.is_finite(),
            };
            assert!(right, "{i}, {j}: {x}");
        }
    }
    a[20 * k + 61] = f32::NEG_INFINITY;
    b[60 * width + 2] = 0.0;
    let out = product((&a, &b), shape, None, Rows::Dense);
    assert!(out[20 * width + 30].is_nan(), "∞ − ∞");
    b[61 * width + 2] = 1.0;
    a[20 * k + 61] = 1.0;
    let out = product((&a, &b), shape, None, Rows::Dense);
    assert!(out[20 * width + 2].is_nan(), "∞ · 0");
    let old = vec![f32::INFINITY; rows * width];
    let out = product((&a, &b), shape, Some(&old), Rows::Dense);
    assert_eq!(out[0], f32::INFINITY);
}

#[test]
fn subnormal_numbers_count_as_zero() {
    if !tiles_or_say_so("subnormal_numbers_count_as_zero") {
        return;
    }
    let shape = (1, 32, 16);
    let one_product = |x: f32, y: f32, old: f32| {
        let (mut a, mut b) = (vec![0.0; 32], vec![0.0; 32 * 16]);
        a[4] = x;
        b[4 * 16 + 3] = y;
        product((&a, &b), shape, Some(&[old; 16]), Rows::Dense)[3]
    };
    let least = f32::MIN_POSITIVE;
    assert_eq!(one_product(least, 1.0, 0.0), least);
    assert_eq!(one_product(least / 2.0, 4.0, 0.0), 0.0, "operand");
    assert_eq!(one_product(4.0, least / 2.0, 0.0), 0.0, "operand");
    assert_eq!(one_product(least, 0.5, 0.0), 0.0, "result");
    assert_eq!(one_product(1.0, 0.0, least / 2.0), 0.0, "old value");
    assert!(one_product(least / 2.0, f32::INFINITY, 0.0).is_nan());
}

#[test]
fn products_of_bytes_are_exact() {
    if !tiles_or_say_so("products of bytes") || !has_bytes() {
        return;
    }
    for (rows, quads, width) in [(1_usize, 16, 16), (17, 32, 48), (33, 192, 64), (192, 384, 32)] {
        let byte = |i: usize| ((i * 2_654_435_761) >> 7) as u8;
        let word = |i: usize| u32::from_ne_bytes(std::array::from_fn(|b| byte(4 * i + b)));
        let a: Vec<u32> = (0..rows.next_multiple_of(TILE) * quads).map(word).collect();
        let b: Vec<u32> = (0..quads * width).map(|i| word(i + 77)).collect();
        let mut sums = vec![1i32; rows * width];
        let base = sums.as_mut_ptr().cast::<f32>();
        let to: Vec<*mut f32> = (0..rows).map(|i| base.wrapping_add(i * width)).collect();
        for accumulate in [false, true] {
            // SAFETY: tiles are there; whole tiles of rows, distinct rows of sums.
            unsafe {
                configure();
                let (a, b) = (a.as_ptr(), b.as_ptr());
                panel(Operands::Bytes, rows, a, quads, b, width, &to, quads, accumulate);
            }
        }
        for (i, row) in sums.chunks_exact(width).enumerate() {
            for (j, sum) in row.iter().enumerate() {
                let dot = |p: usize| {
                    let pairs = a[i * quads + p]
                        .to_ne_bytes()
                        .into_iter()
                        .zip(b[p * width + j].to_ne_bytes());
                    pairs.map(|(a, b)| i32::from(a) * i32::from(b.cast_signed())).sum::<i32>()
                };
                assert_eq!(
                    *sum,
                    2 * (0..quads).map(dot).sum::<i32>(),
                    "{rows} {quads} {width}: {i}, {j}"
                );
            }
        }
    }
}

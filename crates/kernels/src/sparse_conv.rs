//! Submanifold sparse convolution: gather, multiply, scatter, without a gathered copy.
//!
//! `out[p] = bias + Σ_tap W[:, tap, :] · in[p + tap − centre]` over occupied voxels: a
//! cross-correlation. A chunk of output rows belongs to one task, which adds the taps in order, so
//! no result depends on the number of threads or on other scenes.

use crate::Precision;
use crate::gemm::{
    PackedMatrix, PreparedRows, Product, RowPointers, SharedMut, add_outer_products, column_groups,
    gemm_tn_with,
};
use crate::kernel_map::{CHUNK, KernelMap};
use crate::shape::elements;
use rayon::prelude::*;

/// Weights of a convolution, packed tap by tap.
#[derive(Debug, Clone)]
pub struct PackedConv {
    taps: Vec<PackedMatrix>,
    cin: usize,
    cout: usize,
}

impl PackedConv {
    /// Packs weights stored `[cout, k, k, k, cin]`.
    ///
    /// # Panics
    /// If the length does not fit (a bug of the caller).
    pub fn new(weight: &[f32], cin: usize, cout: usize, taps: usize) -> Self {
        Self::with_precision(Precision::F32, weight, cin, cout, taps)
    }

    /// [`PackedConv::new`] for products of another precision.
    ///
    /// # Panics
    /// As [`PackedConv::new`].
    pub fn with_precision(
        precision: Precision,
        weight: &[f32],
        cin: usize,
        cout: usize,
        taps: usize,
    ) -> Self {
        let taps = pack_taps(weight, [cout, taps, cin], |of_tap| {
            PackedMatrix::from_strided_with(precision, of_tap, cin, cout, 1, taps * cin)
        });
        Self { taps, cin, cout }
    }

    /// Packs the same weights for the gradient of the input: `[cout → cin]` per tap.
    fn transposed(
        precision: Precision,
        weight: &[f32],
        cin: usize,
        cout: usize,
        taps: usize,
    ) -> Self {
        let taps = pack_taps(weight, [cout, taps, cin], |of_tap| {
            PackedMatrix::from_strided_with(precision, of_tap, cout, cin, taps * cin, 1)
        });
        Self { taps, cin: cout, cout: cin }
    }

    /// Input channels.
    pub fn cin(&self) -> usize {
        self.cin
    }

    /// Output channels.
    pub fn cout(&self) -> usize {
        self.cout
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.taps.iter().map(PackedMatrix::bytes).sum()
    }
}

/// A matrix of each tap, whose weights begin where `pack` gets them.
fn pack_taps(
    weight: &[f32],
    [cout, taps, cin]: [usize; 3],
    pack: impl Fn(&[f32]) -> PackedMatrix + Sync,
) -> Vec<PackedMatrix> {
    assert_eq!(weight.len(), elements([cout, taps, cin]), "convolution weight length");
    let of_tap = |t: usize| pack(&weight[(t * cin).min(weight.len())..]);
    (0..taps).into_par_iter().map(of_tap).collect()
}

/// Convolves `x` into `out`.
///
/// # Shapes
/// `x`: `[N, cin]` · `bias`: `[cout]` · `out`: `[N, cout]`
///
/// # Panics
/// If lengths do not fit the map and the weights (a bug of the caller).
pub fn forward(
    map: &KernelMap,
    x: &[f32],
    weight: &PackedConv,
    bias: Option<&[f32]>,
    out: &mut [f32],
) {
    assert_eq!(weight.taps.len(), map.taps(), "convolution taps");
    run(map, x, weight, |tap| tap, bias, out, false);
}

fn run(
    map: &KernelMap,
    x: &[f32],
    weight: &PackedConv,
    weight_tap: impl Fn(usize) -> usize + Sync,
    bias: Option<&[f32]>,
    out: &mut [f32],
    one_by_one: bool,
) {
    let (cin, cout) = (weight.cin, weight.cout);
    assert_eq!(x.len(), elements([map.rows(), cin]), "convolution input length");
    assert_eq!(out.len(), elements([map.rows(), cout]), "convolution output length");
    if cout == 0 {
        return;
    }
    // Rows by the chunk, so that they are still in the cache when sums are added to them.
    let start = |rows: &mut [f32]| match bias {
        Some(bias) => rows.chunks_exact_mut(cout).for_each(|row| row.copy_from_slice(bias)),
        None => rows.fill(0.0),
    };
    if cin == 0 {
        out.par_chunks_mut(CHUNK * cout).for_each(start);
        return;
    }
    let prepared = PreparedRows::new(x, &weight.taps[0]);
    let groups = column_groups(cout.next_multiple_of(16), map.num_chunks());
    if groups.len() > 1 {
        out.par_chunks_mut(CHUNK * cout).for_each(start);
    }
    let target = SharedMut(out.as_mut_ptr());
    (0..map.num_chunks() * groups.len()).into_par_iter().for_each(|task| {
        let chunk = task / groups.len();
        let columns = &groups[task % groups.len()];
        if groups.len() == 1 {
            let first = chunk * CHUNK;
            let rows = CHUNK.min(map.rows() - first);
            // SAFETY: the rows of this chunk, which no other task touches.
            start(unsafe { std::slice::from_raw_parts_mut(target.at(first * cout), rows * cout) });
        }
        for tap in 0..map.taps() {
            let (input, output) = map.pairs(chunk, tap);
            let matrix = &weight.taps[weight_tap(tap)];
            // In a transposed map with shared voxels an output row may repeat within a tap; then
            // pairs are added one at a time.
            let step = if one_by_one { 1 } else { input.len().max(1) };
            for (input, output) in input.chunks(step).zip(output.chunks(step)) {
                let (rows, columns) = (input.len(), columns.clone());
                // SAFETY: row numbers come from the map and are below `rows`; output rows of
                // different chunks are distinct, columns of different groups too.
                unsafe {
                    let c = RowPointers { base: target.at(0), stride: cout, ids: Some(output) };
                    let product = Product { rows, b: matrix, columns, c, accumulate: true };
                    prepared.multiply((x, cin), input, product);
                }
            }
        }
    });
}

/// Gradient of the input; [`Precision::Int8`], which has none, counts as f32.
///
/// # Shapes
/// `grad`: `[N, cout]` · `weight`: `[cout, k, k, k, cin]` · `dx`: `[N, cin]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn backward_input(
    precision: Precision,
    map: &KernelMap,
    grad: &[f32],
    weight: &[f32],
    cin: usize,
    cout: usize,
    dx: &mut [f32],
) {
    let taps = map.taps();
    let precision = precision.of_gradients();
    let packed = PackedConv::transposed(precision, weight, cin, cout, taps);
    if map.has_duplicates() {
        run(&map.transposed(), grad, &packed, |tap| tap, None, dx, true);
    } else {
        // Without shared voxels the pairs of a tap are those of the mirrored tap, exchanged.
        run(map, grad, &packed, |tap| taps - 1 - tap, None, dx, false);
    }
}

/// Largest gradient of a weight of which there are several partial sums.
const PARTIAL_BYTES: usize = 2 << 20;
/// Stretches of rows with a partial sum of their own. Fixed, so that the order of summation is.
const STRETCHES: usize = 16;

/// Gradient of the weight, `[cout, k, k, k, cin]`. That of a narrow layer is summed in f32 in every
/// precision: rounding its operands would take longer than the products.
///
/// # Shapes
/// `x`: `[N, cin]` · `grad`: `[N, cout]`
///
/// # Panics
/// If lengths do not fit (a bug of the caller).
pub fn backward_weight(
    precision: Precision,
    map: &KernelMap,
    x: &[f32],
    grad: &[f32],
    cin: usize,
    cout: usize,
    dw: &mut [f32],
) {
    let taps = map.taps();
    assert_eq!(dw.len(), elements([cout, taps, cin]), "convolution weight length");
    assert_eq!(x.len(), elements([map.rows(), cin]), "convolution input length");
    assert_eq!(grad.len(), elements([map.rows(), cout]), "convolution gradient length");
    if cin > 0 && cin.is_multiple_of(16) && cout > 0 && size_of_val(dw) <= PARTIAL_BYTES {
        return backward_narrow_weight(map, x, grad, cin, cout, dw);
    }
    let target = SharedMut(dw.as_mut_ptr());
    (0..taps).into_par_iter().for_each(|tap| {
        let (input, output) = map.tap_pairs(tap);
        let mut part = vec![0.0; cout * cin];
        let pairs = Some((&*output, &*input));
        gemm_tn_with(precision, grad, cout, x, cin, pairs, &mut part);
        for o in 0..cout {
            // SAFETY: each tap writes its own stretch of each output channel.
            let to =
                unsafe { std::slice::from_raw_parts_mut(target.at((o * taps + tap) * cin), cin) };
            to.copy_from_slice(&part[o * cin..(o + 1) * cin]);
        }
    });
}

/// Stretch of rows by stretch of rows, all taps of a chunk together: its rows stay in the cache.
fn backward_narrow_weight(
    map: &KernelMap,
    x: &[f32],
    grad: &[f32],
    cin: usize,
    cout: usize,
    dw: &mut [f32],
) {
    let (taps, chunks) = (map.taps(), map.num_chunks());
    let each = chunks.div_ceil(STRETCHES).max(1);
    let partial: Vec<Vec<f32>> = (0..chunks.div_ceil(each))
        .into_par_iter()
        .map(|stretch| {
            let mut sums = vec![0.0; dw.len()];
            for chunk in stretch * each..((stretch + 1) * each).min(chunks) {
                for (tap, sums) in sums.chunks_exact_mut(cout * cin).enumerate() {
                    let (input, output) = map.pairs(chunk, tap);
                    let pairs = Some((output, input));
                    // SAFETY: row numbers of the map are below its rows, which both sides have; the
                    // sums of a tap are `cout` rows of `cin` values.
                    unsafe {
                        let (grad, x) = ((grad, cout), (x, cin));
                        add_outer_products(grad, x, pairs, 0..input.len(), 0, sums);
                    }
                }
            }
            sums
        })
        .collect();
    dw.par_chunks_mut(cin).enumerate().for_each(|(row, to)| {
        let (o, tap) = (row / taps, row % taps);
        to.fill(0.0);
        for sums in &partial {
            let from = &sums[(tap * cout + o) * cin..][..cin];
            to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
        }
    });
}

/// Sum of the rows of `grad` (`[N, C]`): the gradient of a bias. Summed in f64 in fixed stretches.
pub fn backward_bias(grad: &[f32], c: usize) -> Vec<f32> {
    const BLOCK: usize = 1024;
    let partial: Vec<Vec<f64>> = grad
        .par_chunks(BLOCK * c.max(1))
        .map(|rows| {
            let mut sums = vec![0f64; c];
            for row in rows.chunks_exact(c.max(1)) {
                for (s, v) in sums.iter_mut().zip(row) {
                    *s += f64::from(*v);
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
    total.into_iter().map(|v| v as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{max_error, on_threads, random, rounded};
    use rand::{Rng, SeedableRng};
    use scenesplat_test_support::reference;

    fn grid(n: usize, side: i32, unique: bool) -> Vec<[i32; 3]> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let mut out: Vec<[i32; 3]> = Vec::new();
        while out.len() < n {
            let c = std::array::from_fn(|_| rng.random_range(0..side));
            if !unique || !out.contains(&c) {
                out.push(c);
            }
        }
        out
    }

    /// f32 against the dense sum, bf16 against that of rounded operands.
    #[test]
    fn agrees_with_the_dense_sum() {
        for (n, k, cin, cout) in
            [(0, 3, 4, 4), (1, 3, 11, 5), (300, 3, 7, 20), (200, 5, 11, 32), (90, 3, 64, 64)]
        {
            let grid = grid(n, 9, true);
            let offsets = [0, n / 3, n];
            let map = KernelMap::build(&grid, &offsets, k).unwrap();
            let (x, w, b) =
                (random(n * cin, 1), random(cout * k * k * k * cin, 2), random(cout, 3));
            for (precision, x_used, w_used, bound) in [
                (Precision::F32, x.clone(), w.clone(), 2e-5),
                (Precision::Bf16, rounded(&x), rounded(&w), 4e-5),
            ] {
                let weight = PackedConv::with_precision(precision, &w, cin, cout, map.taps());
                let mut out = vec![f32::NAN; n * cout];
                forward(&map, &x, &weight, Some(&b), &mut out);
                let bias = Some(&b[..]);
                let want =
                    reference::submanifold_conv(&grid, &offsets, &x_used, cin, &w_used, bias, k);
                let error = max_error(&out, &want);
                assert!(error < bound, "{precision} {n} {k} {cin} {cout}: {error}");
            }
        }
    }

    #[test]
    fn int8_is_near_tap_by_tap() {
        for (n, cin, cout) in [(0, 64, 64), (1, 64, 65), (2, 70, 64), (900, 64, 96), (300, 131, 67)]
        {
            let grid = grid(n, 11, true);
            let offsets = [0, n / 3, n];
            let map = KernelMap::build(&grid, &offsets, 3).unwrap();
            let (mut x, w, b) = (random(n * cin, 1), random(cout * 27 * cin, 2), random(cout, 3));
            // Neighbors of very different size: each row has its own scale.
            x.iter_mut().enumerate().for_each(|(i, v)| *v *= 4f32.powi((i / cin % 3) as i32));
            let weight = PackedConv::with_precision(Precision::Int8, &w, cin, cout, map.taps());
            let run = |x: &[f32]| {
                let mut out = vec![f32::NAN; n * cout];
                forward(&map, x, &weight, Some(&b), &mut out);
                out
            };
            let out = run(&x);
            let want = reference::submanifold_conv(&grid, &offsets, &x, cin, &w, Some(&b), 3);
            let pairs = out.iter().zip(&want);
            let error: f64 = pairs.map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
            let norm: f64 = want.iter().map(|w| w * w).sum();
            let relative = (error / norm.max(1e-30)).sqrt();
            assert!(
                relative < 1.2e-2 && (n == 0 || relative > 1e-3),
                "{n} {cin} {cout}: {relative}"
            );
            // A scene alone has the same bits, and so has any number of threads.
            let first = n / 3;
            let alone = KernelMap::build(&grid[..first], &[0, first], 3).unwrap();
            let mut single = vec![f32::NAN; first * cout];
            forward(&alone, &x[..first * cin], &weight, Some(&b), &mut single);
            assert_eq!(single, out[..first * cout]);
            for threads in [1, 3] {
                assert_eq!(on_threads(threads, || run(&x)), out);
            }
            if n > 100 {
                // NaN and ∞ spread to the row's neighbors, as NaN, and no further.
                let mut x = x.clone();
                (x[3], x[(n - 1) * cin + 5]) = (f32::NAN, f32::INFINITY);
                let mut bad = vec![false; n];
                for tap in 0..27 {
                    let (from, to) = map.tap_pairs(tap);
                    let pairs = from.iter().zip(to);
                    pairs
                        .filter(|(f, _)| [0, n as u32 - 1].contains(f))
                        .for_each(|(_, t)| bad[t as usize] = true);
                }
                for (i, (got, clean)) in run(&x).iter().zip(&out).enumerate() {
                    assert!(
                        if bad[i / cout] { got.is_nan() } else { got == clean },
                        "row {}",
                        i / cout
                    );
                }
            }
        }
    }

    #[test]
    fn gradients_in_bf16_are_near() {
        let (n, cin, cout) = (400, 24, 20);
        let grid = grid(n, 10, true);
        let map = KernelMap::build(&grid, &[0, n], 3).unwrap();
        let (x, w, g) = (random(n * cin, 1), random(cout * 27 * cin, 2), random(n * cout, 3));
        let run = |precision| {
            let (mut dx, mut dw) = (vec![f32::NAN; n * cin], vec![f32::NAN; w.len()]);
            backward_input(precision, &map, &g, &w, cin, cout, &mut dx);
            backward_weight(precision, &map, &x, &g, cin, cout, &mut dw);
            (dx, dw)
        };
        let (exact, near) = (run(Precision::F32), run(Precision::Bf16));
        for (exact, near) in [(exact.0, near.0), (exact.1, near.1)] {
            let error: f32 = exact.iter().zip(&near).map(|(a, b)| (a - b).powi(2)).sum();
            let norm: f32 = exact.iter().map(|a| a * a).sum();
            let relative = (error / norm).sqrt();
            assert!(relative > 1e-4 && relative < 5e-3, "{relative}");
        }
    }

    /// ⟨grad, conv(x)⟩ is linear in x and in the weights, so its gradients are exact sums.
    fn check_gradients(grid: &[[i32; 3]]) {
        check_gradients_of(grid, 5, 6);
        check_gradients_of(grid, 16, 7);
    }

    fn check_gradients_of(grid: &[[i32; 3]], cin: usize, cout: usize) {
        let n = grid.len();
        let map = KernelMap::build(grid, &[0, n], 3).unwrap();
        let (x, w, g) = (random(n * cin, 1), random(cout * 27 * cin, 2), random(n * cout, 3));
        let loss = |x: &[f32], w: &[f32]| -> f64 {
            let mut out = vec![0.0; n * cout];
            forward(&map, x, &PackedConv::new(w, cin, cout, 27), None, &mut out);
            out.iter().zip(&g).map(|(o, g)| f64::from(*o) * f64::from(*g)).sum()
        };
        let mut dx = vec![f32::NAN; n * cin];
        backward_input(Precision::F32, &map, &g, &w, cin, cout, &mut dx);
        let mut dw = vec![f32::NAN; w.len()];
        backward_weight(Precision::F32, &map, &x, &g, cin, cout, &mut dw);
        let base = loss(&x, &w);
        for i in (0..x.len()).step_by(7 * cin / 5) {
            let mut moved = x.clone();
            moved[i] += 1.0;
            let want = loss(&moved, &w) - base;
            assert!((f64::from(dx[i]) - want).abs() < 1e-4, "dx {i}: {} {want}", dx[i]);
        }
        for i in (0..w.len()).step_by(11 * cin / 5) {
            let mut moved = w.clone();
            moved[i] += 1.0;
            let want = loss(&x, &moved) - base;
            assert!((f64::from(dw[i]) - want).abs() < 2e-4, "dw {i}: {} {want}", dw[i]);
        }
    }

    #[test]
    fn gradients_are_exact() {
        check_gradients(&grid(150, 7, true));
        check_gradients(&grid(2500, 16, true)[..1500]);
    }

    #[test]
    fn gradients_are_exact_with_shared_voxels() {
        check_gradients(&grid(120, 4, false));
    }

    #[test]
    fn bias_gradient_is_the_column_sum() {
        let g = random(3000 * 3, 9);
        let want: f64 = g.iter().skip(1).step_by(3).map(|v| f64::from(*v)).sum();
        assert!((f64::from(backward_bias(&g, 3)[1]) - want).abs() < 1e-5);
        assert_eq!(backward_bias(&[], 3), [0.0; 3]);
    }
}

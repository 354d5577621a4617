//! Sums over feature rows, with the registers that the CPU has.

use super::tables::SegmentTables;
use scenesplat_kernels::simd::{Isa, compiled_for};

/// A segment and how much it counts.
pub(super) type Label = (u32, f32);

/// Values summed side by side: four registers of 16.
const STRIPE: usize = 64;
/// Rows summed in f32 before their sum is added in f64: the error of a sum is that of 64 terms,
/// however many there are.
const RUN: usize = 64;

/// Makes a function with versions for what the CPU can do; all add in the same order, but may
/// round differently (fused multiply–add).
macro_rules! with_versions {
    ($(#[$doc:meta])* $name:ident = $body:ident ($($arg:ident: $t:ty),*) $(-> $out:ty)?) => {
        $(#[$doc])*
        pub(super) fn $name($($arg: $t),*) $(-> $out)? {
            compiled_for(
                Isa::current(),
                #[inline(always)]
                |isa| {
                    if isa >= Isa::Avx2 { $body::<true>($($arg),*) } else { $body::<false>($($arg),*) }
                },
            )
        }
    };
}

#[inline(always)]
fn multiply_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    // Without the instruction, a fused one is a call of a library.
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

with_versions! {
    /// `Σ w · row(s)` over the labels. `out`: `[D]`, overwritten.
    weighted_sum = weighted_sum_body(tables: &SegmentTables, labels: &[Label], out: &mut [f64])
}

with_versions! {
    /// `sum · factor` into `out`, as long; gives the sum of the squares.
    scaled = scaled_body(sum: &[f64], factor: f64, out: &mut [f32]) -> f64
}

with_versions! {
    /// `Σ v²`, in f64.
    squared_length = squared_length_body(v: &[f32]) -> f64
}

with_versions! {
    /// `Σ (a − b)²`.
    squared_distance = squared_distance_body(a: &[f32], b: &[f32]) -> f32
}

with_versions! {
    /// `Σ a · b`.
    dot = dot_body(a: &[f32], b: &[f32]) -> f32
}

#[inline(always)]
fn weighted_sum_body<const FUSED: bool>(tables: &SegmentTables, labels: &[Label], out: &mut [f64]) {
    out.fill(0.0);
    for run in labels.chunks(RUN) {
        let mut stripes = out.chunks_exact_mut(STRIPE);
        let mut at = 0;
        for out in &mut stripes {
            let mut sum = [0f32; STRIPE];
            for &(segment, weight) in run {
                let row = &tables.row(segment)[at..at + STRIPE];
                for i in 0..STRIPE {
                    sum[i] = multiply_add::<FUSED>(weight, row[i], sum[i]);
                }
            }
            for i in 0..STRIPE {
                out[i] += f64::from(sum[i]);
            }
            at += STRIPE;
        }
        let rest = stripes.into_remainder();
        let mut sum = [0f32; STRIPE];
        for &(segment, weight) in run {
            for (sum, v) in sum.iter_mut().zip(&tables.row(segment)[at..]) {
                *sum = multiply_add::<FUSED>(weight, *v, *sum);
            }
        }
        rest.iter_mut().zip(sum).for_each(|(out, sum)| *out += f64::from(sum));
    }
}

/// Sums of squares side by side: additions need not wait for each other.
const SQUARES: usize = 16;

#[inline(always)]
fn scaled_body<const FUSED: bool>(sum: &[f64], factor: f64, out: &mut [f32]) -> f64 {
    let mut squares = [0f64; SQUARES];
    let one = |square: &mut f64, sum: &f64, out: &mut f32| {
        let value = sum * factor;
        *square += value * value;
        *out = value as f32;
    };
    let (mut sums, mut outs) = (sum.chunks_exact(SQUARES), out.chunks_exact_mut(SQUARES));
    for (sums, outs) in (&mut sums).zip(&mut outs) {
        for i in 0..SQUARES {
            one(&mut squares[i], &sums[i], &mut outs[i]);
        }
    }
    let rest = sums.remainder().iter().zip(outs.into_remainder());
    rest.zip(&mut squares).for_each(|((sum, out), square)| one(square, sum, out));
    squares.iter().sum()
}

#[inline(always)]
fn squared_length_body<const FUSED: bool>(v: &[f32]) -> f64 {
    let mut squares = [0f64; SQUARES];
    let mut blocks = v.chunks_exact(SQUARES);
    for block in &mut blocks {
        for i in 0..SQUARES {
            squares[i] += f64::from(block[i]) * f64::from(block[i]);
        }
    }
    for (square, x) in squares.iter_mut().zip(blocks.remainder()) {
        *square += f64::from(*x) * f64::from(*x);
    }
    squares.iter().sum()
}

#[inline(always)]
fn squared_distance_body<const FUSED: bool>(a: &[f32], b: &[f32]) -> f32 {
    lanes(a, b, |a, b, sum| multiply_add::<FUSED>(a - b, a - b, sum))
}

#[inline(always)]
fn dot_body<const FUSED: bool>(a: &[f32], b: &[f32]) -> f32 {
    lanes(a, b, multiply_add::<FUSED>)
}

/// Folds over pairs in 32 lanes, which are added up at the end.
#[inline(always)]
fn lanes(a: &[f32], b: &[f32], f: impl Fn(f32, f32, f32) -> f32) -> f32 {
    const LANES: usize = 32;
    let mut sum = [0f32; LANES];
    let (mut left, mut right) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    for (a, b) in (&mut left).zip(&mut right) {
        for i in 0..LANES {
            sum[i] = f(a[i], b[i], sum[i]);
        }
    }
    for (i, (a, b)) in left.remainder().iter().zip(right.remainder()).enumerate() {
        sum[i] = f(*a, *b, sum[i]);
    }
    let mut width = LANES / 2;
    while width > 0 {
        for i in 0..width {
            sum[i] += sum[i + width];
        }
        width /= 2;
    }
    sum[0]
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail loudly")]
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn sums_are_those_of_plain_loops_for_any_width_and_length() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        for dim in [1, 3, 63, 64, 65, 200, 768] {
            let rows: Vec<f32> = (0..300 * dim).map(|_| rng.random_range(-1.0..1.0)).collect();
            let mut tables = SegmentTables::new(dim);
            tables.push(&rows).unwrap();
            for count in [0, 1, 63, 64, 65, 1000] {
                let labels: Vec<Label> =
                    (0..count).map(|_| (rng.random_range(0..300), rng.random())).collect();
                let mut fast = vec![9.0; dim];
                weighted_sum(&tables, &labels, &mut fast);
                for (i, fast) in fast.iter().enumerate() {
                    let value = |s: u32| f64::from(tables.row(s)[i]);
                    let slow: f64 = labels.iter().map(|&(s, w)| f64::from(w) * value(s)).sum();
                    assert!((slow - fast).abs() < 1e-6 * (1.0 + f64::from(count)), "{dim} {count}");
                }
            }
            let (a, b) = (tables.row(0), tables.row(1));
            let pairs = || a.iter().zip(b).map(|(a, b)| (f64::from(*a), f64::from(*b)));
            let slow: f64 = pairs().map(|(a, b)| a * b).sum();
            assert!((f64::from(dot(a, b)) - slow).abs() < 1e-6);
            let slow: f64 = pairs().map(|(a, b)| (a - b) * (a - b)).sum();
            assert!((f64::from(squared_distance(a, b)) - slow).abs() < 1e-6);
        }
    }
}

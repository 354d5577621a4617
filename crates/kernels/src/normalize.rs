//! Rows brought to unit length.

use crate::simd::compiled;
use rayon::prelude::*;

/// Norms below this count as this, as in PyTorch.
const EPS: f64 = 1e-12;
/// Sums that a norm is made of; fixed, so that the order of summation is.
const LANES: usize = 16;

/// Euclidean norm in f64, at least 1e-12: no square of an f32 over- or underflows there.
pub fn norm(row: &[f32]) -> f64 {
    compiled(
        #[inline(always)]
        || norm_of(row),
    )
}

#[inline(always)]
fn norm_of(row: &[f32]) -> f64 {
    let (blocks, rest) = row.as_chunks::<LANES>();
    let mut sums = [0f64; LANES];
    for block in blocks {
        for (sum, v) in sums.iter_mut().zip(block) {
            *sum += f64::from(*v) * f64::from(*v);
        }
    }
    for (sum, v) in sums.iter_mut().zip(rest) {
        *sum += f64::from(*v) * f64::from(*v);
    }
    sums.iter().sum::<f64>().sqrt().max(EPS)
}

/// Divides each row of `values` (`[N, c]`) by its norm; a row of zeros is left as it is. On the calling
/// thread.
pub fn normalize_block(values: &mut [f32], c: usize) {
    if c == 0 {
        return;
    }
    compiled(
        #[inline(always)]
        || {
            for row in values.chunks_exact_mut(c) {
                let inverse = 1.0 / norm_of(row);
                row.iter_mut().for_each(|v| *v = (f64::from(*v) * inverse) as f32);
            }
        },
    );
}

/// [`normalize_block`] on all threads.
pub fn normalize_rows(values: &mut [f32], c: usize) {
    const ROWS: usize = 64;
    if c > 0 {
        values.par_chunks_mut(ROWS * c).for_each(|rows| normalize_block(rows, c));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_unit_length_whatever_their_size() {
        for c in [1, 3, 16, 17, 48, 770] {
            for scale in [1.0, 1e-30, 1e30, 3e38, 1e-44] {
                let row: Vec<f32> = (0..c).map(|i| ((i * 7 % 13) as f32 - 5.5) / 8.0).collect();
                let mut values: Vec<f32> = row.iter().map(|v| v * scale).collect();
                values.extend(vec![0.0; c]);
                let want: f64 = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
                assert!((norm(&values[..c]) - want.max(EPS)).abs() <= 1e-14 * want.max(EPS));
                let before = values.clone();
                normalize_rows(&mut values, c);
                let length = values[..c].iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
                let expected = if want < EPS { want / EPS } else { 1.0 };
                assert!((length - expected).abs() < 1e-6, "{c} · {scale}: {length}");
                for (after, before) in values.iter().zip(&before) {
                    let exact = f64::from(*before) / want.max(EPS);
                    assert!((f64::from(*after) - exact).abs() <= 1e-7);
                }
                assert!(values[c..].iter().all(|v| *v == 0.0));
            }
        }
        normalize_rows(&mut [], 0);
    }
}

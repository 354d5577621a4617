//! Whether feature rows still differ from each other.
//!
//! A network can lower many losses by giving all rows the same feature, or features on one line.
//! Every number is finite then and nothing else tells. Both measures here cost `n²·d` for `n` rows:
//! give them a sample of some hundreds.
//!
//! Rows with a value that is not finite are left out, and rows that lie on the mean have no
//! direction and are left out of the cosines. A number that cannot be computed is `None`.

use crate::{FeatureSlice, MetricError};
use rayon::prelude::*;

/// In how many directions the rows spread, `1..=min(n − 1, dim)`.
///
/// `(Σλ)² / Σλ²` over the eigenvalues `λ` of the covariance, also called participation ratio: the
/// exponential of their Rényi entropy of order 2. Equal spread in `k` directions gives `k`, and no
/// eigenvalue has to be computed for it: with centered rows `x` it is `(Σ‖xᵢ‖²)² / Σᵢⱼ⟨xᵢ,xⱼ⟩²`.
///
/// `None` for less than two usable rows or equal rows.
///
/// # Shapes
/// `values`: `[n, dim]` row-major, any scale
///
/// # Errors
/// If the values are no rows of that width.
pub fn effective_rank(values: &[f32], dim: usize) -> Result<Option<f64>, MetricError> {
    let rows = centred(values, dim)?;
    let trace: f64 = rows.iter().map(|row| dot(row, row)).sum();
    if rows.len() < 2 || trace <= 0.0 {
        return Ok(None);
    }
    let squares: Vec<f64> = rows
        .par_iter()
        .enumerate()
        .map(|(i, a)| {
            // Each pair counts twice, a row with itself once.
            let others: f64 = rows[..i].iter().map(|b| dot(a, b).powi(2)).sum();
            2.0 * others + dot(a, a).powi(2)
        })
        .collect();
    Ok(Some(trace * trace / squares.iter().sum::<f64>()))
}

/// Mean of `|cos|` over all pairs of rows, the mean row taken off first, `0..=1`.
///
/// Near 0 (about `0.8/√dim`) for rows that spread in all directions, 1 for rows on one line.
///
/// `None` if less than two rows have a direction.
///
/// # Shapes
/// `values`: `[n, dim]` row-major, any scale
///
/// # Errors
/// If the values are no rows of that width.
pub fn centred_cosine(values: &[f32], dim: usize) -> Result<Option<f64>, MetricError> {
    let mut rows = centred(values, dim)?;
    // What is left of equal rows after taking off their mean is rounding, no direction.
    let largest =
        values.iter().filter(|v| v.is_finite()).fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
    let least = largest * f64::from(f32::EPSILON) * (dim as f64).sqrt();
    rows.retain_mut(|row| {
        let norm = dot(row, row).sqrt();
        row.iter_mut().for_each(|v| *v /= norm);
        norm > least
    });
    let n = rows.len();
    if n < 2 {
        return Ok(None);
    }
    let sums: Vec<f64> = rows
        .par_iter()
        .enumerate()
        .map(|(i, a)| rows[..i].iter().map(|b| dot(a, b).abs()).sum())
        .collect();
    Ok(Some((sums.iter().sum::<f64>() / (n * (n - 1) / 2) as f64).min(1.0)))
}

/// The finite rows in f64, where no square of an f32 overflows, less their mean.
fn centred(values: &[f32], dim: usize) -> Result<Vec<Vec<f64>>, MetricError> {
    let _ = FeatureSlice::new(values, dim)?;
    let finite = values.chunks_exact(dim).filter(|row| row.iter().all(|v| v.is_finite()));
    let mut rows: Vec<Vec<f64>> =
        finite.map(|row| row.iter().map(|v| f64::from(*v)).collect()).collect();
    let n = rows.len().max(1) as f64;
    for column in 0..dim {
        // Twice: the first mean has rounding errors of the size of the values.
        for _ in 0..2 {
            let mean = rows.iter().map(|row| row[column]).sum::<f64>() / n;
            rows.iter_mut().for_each(|row| row[column] -= mean);
        }
    }
    Ok(rows)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows `±scale·e_k`, one pair a direction: mean 0, equal spread.
    fn cross(directions: usize, dim: usize, scale: f32) -> Vec<f32> {
        let mut values = vec![0.0; 2 * directions * dim];
        for k in 0..directions {
            values[2 * k * dim + k] = scale;
            values[(2 * k + 1) * dim + k] = -scale;
        }
        values
    }

    #[test]
    fn equal_spread_counts_directions() {
        for (k, dim) in [(1, 3), (2, 3), (5, 8)] {
            for scale in [1e-30, 1.0, 1e30] {
                let rank = effective_rank(&cross(k, dim, scale), dim).unwrap().unwrap();
                assert!((rank - k as f64).abs() < 1e-9, "{k} {scale} {rank}");
            }
        }
    }

    #[test]
    fn uneven_spread_by_hand() {
        // Variances 9 and 1: (9 + 1)² / (81 + 1).
        let values = [3.0, 0.0, -3.0, 0.0, 0.0, 1.0, 0.0, -1.0];
        let rank = effective_rank(&values, 2).unwrap().unwrap();
        assert!((rank - 100.0 / 82.0).abs() < 1e-12, "{rank}");
        // Of six pairs two are opposite, four at a right angle.
        let cosine = centred_cosine(&values, 2).unwrap().unwrap();
        assert!((cosine - 2.0 / 6.0).abs() < 1e-12, "{cosine}");
    }

    #[test]
    fn a_common_offset_changes_nothing() {
        let plain = cross(3, 4, 1.0);
        let moved: Vec<f32> = plain.iter().map(|v| v + 1024.0).collect();
        for f in [effective_rank, centred_cosine] {
            let (a, b) = (f(&plain, 4).unwrap().unwrap(), f(&moved, 4).unwrap().unwrap());
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
        assert_eq!(centred_cosine(&cross(1, 4, 2.0), 4).unwrap(), Some(1.0));
    }

    #[test]
    fn nothing_to_compare() {
        for f in [effective_rank, centred_cosine] {
            assert_eq!(f(&[], 3).unwrap(), None);
            assert_eq!(f(&[1.0, 2.0, 3.0], 3).unwrap(), None);
            assert_eq!(f(&[0.1; 30], 3).unwrap(), None, "equal rows");
            assert_eq!(f(&[1.0, 2.0, f32::NAN, 0.0], 2).unwrap(), None, "one finite row");
            assert!(f(&[1.0, 2.0], 3).is_err());
        }
    }

    #[test]
    fn bad_rows_are_left_out() {
        let mut values = cross(2, 4, 1.0);
        let clean = (effective_rank(&values, 4).unwrap(), centred_cosine(&values, 4).unwrap());
        values.extend([f32::INFINITY, 0.0, 0.0, 0.0, f32::NAN, 1.0, 1.0, 1.0]);
        assert_eq!(
            (effective_rank(&values, 4).unwrap(), centred_cosine(&values, 4).unwrap()),
            clean
        );
    }
}

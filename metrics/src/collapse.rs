//! Whether features still differ from each other.

use crate::rows::FeatureRows;
use crate::{MetricError, error::check_num_rows};
use nalgebra::{DMatrix, DMatrixView};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{RngCore, SeedableRng};
use std::collections::BTreeSet;

/// Rows that are looked at, of any number.
const SAMPLE: usize = 4096;

/// How much features differ from each other: what a training watches to see a collapse.
///
/// Both numbers are about the rows minus their mean, so a part that all rows share, which hides a
/// collapse from plain cosines, does not count. Neither changes when all rows are scaled or rotated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Collapse {
    /// Rows that were looked at: all, or 4096 of them.
    pub rows: usize,
    /// In how many directions rows differ, counting weak ones less: `exp(−Σ pᵢ ln pᵢ)`, where `pᵢ`
    /// is the share of the i-th eigenvalue (singular value) of the rows' covariance.
    ///
    /// 1 for rows on a line, `min(D, rows − 1)` at most, **0 if all rows are equal**; `None` for
    /// fewer than two rows, which cannot differ.
    pub effective_rank: Option<f64>,
    /// Mean cosine between two different rows, minus their mean. Rows equal to the mean have no
    /// direction and are left out; `None` if fewer than two are left.
    ///
    /// `−1 / (rows − 1)` for directions that cancel out, near 1 if nearly all rows moved to one side
    /// of a few outliers.
    pub centred_cosine: Option<f64>,
}

/// Indicators of a collapse of these features.
///
/// Of more than 4096 rows, 4096 are drawn by the seed. The same rows give the same bits on every
/// run; the numbers are those of f64.
///
/// # Errors
/// If a row that is looked at has a value that is not finite, or cannot be read; or there are 2³² − 1
/// or more rows.
///
/// # Source
/// The entropy of the spectrum as rank: Roy and Vetterli, "The effective rank" (EUSIPCO 2007), on
/// the covariance instead of the matrix of rows.
///
/// ```
/// use scenesplat_metrics::{FeatureSlice, collapse};
///
/// // Four corners of a square: two directions, equally strong.
/// let corners = [5.0, 1.0, 5.0, -1.0, 7.0, 1.0, 7.0, -1.0];
/// let found = collapse(&FeatureSlice::new(&corners, 2)?, 0)?;
/// assert!((found.effective_rank.unwrap() - 2.0).abs() < 1e-12);
/// assert!((found.centred_cosine.unwrap() + 1.0 / 3.0).abs() < 1e-12);
/// # Ok::<(), scenesplat_metrics::MetricError>(())
/// ```
pub fn collapse(features: &dyn FeatureRows, seed: u64) -> Result<Collapse, MetricError> {
    check_num_rows("features", features.num_rows())?;
    let dim = features.dim();
    let chosen = sample(features.num_rows(), seed);
    let rows = chosen.len();
    let centred = centred_rows(features, &chosen)?;
    if rows < 2 || dim == 0 {
        return Ok(Collapse { rows, effective_rank: None, centred_cosine: None });
    }
    Ok(Collapse {
        rows,
        effective_rank: Some(effective_rank(&centred, rows, dim)),
        centred_cosine: mean_cosine(&centred, dim),
    })
}

/// Numbers of different rows, ascending.
fn sample(rows: usize, seed: u64) -> Vec<usize> {
    if rows <= SAMPLE {
        return (0..rows).collect();
    }
    // Floyd's way: each set of rows is as likely, and nothing as long as the features is needed.
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut chosen = BTreeSet::new();
    for last in rows - SAMPLE..rows {
        let below = (u128::from(rng.next_u64()) * (last + 1) as u128) >> 64;
        if !chosen.insert(below as usize) {
            chosen.insert(last);
        }
    }
    chosen.into_iter().collect()
}

/// The chosen rows minus their mean. `[rows, D]`
fn centred_rows(features: &dyn FeatureRows, chosen: &[usize]) -> Result<Vec<f64>, MetricError> {
    let dim = features.dim();
    let mut values = Vec::with_capacity(chosen.len() * dim);
    let mut scratch = Vec::new();
    for &row in chosen {
        let found = features.read(row..row + 1, &mut scratch)?;
        if let Some(channel) = found.iter().position(|v| !v.is_finite()) {
            return Err(MetricError::NonFiniteFeature { row, channel, value: found[channel] });
        }
        values.extend(found.iter().map(|v| f64::from(*v)));
    }
    if values.is_empty() {
        return Ok(values);
    }
    // Differences from the first row before their mean: equal rows then differ by exactly nothing.
    let first = values[..dim].to_vec();
    let mut mean = vec![0.0; dim];
    for row in values.chunks_exact_mut(dim) {
        for j in 0..dim {
            row[j] -= first[j];
            mean[j] += row[j] / chosen.len() as f64;
        }
    }
    for row in values.chunks_exact_mut(dim) {
        row.iter_mut().zip(&mean).for_each(|(v, m)| *v -= m);
    }
    Ok(values)
}

fn effective_rank(centred: &[f64], rows: usize, dim: usize) -> f64 {
    // Row after row here is column after column there.
    let columns = DMatrixView::from_slice(centred, dim, rows);
    // Both products have the same eigenvalues, apart from zeros.
    let product: DMatrix<f64> =
        if dim <= rows { columns * columns.transpose() } else { columns.transpose() * columns };
    let total = product.trace();
    if total == 0.0 {
        return 0.0;
    }
    // Rounding makes some of the zeros negative.
    let shares = (product / total).symmetric_eigenvalues();
    let entropy: f64 = shares.iter().filter(|p| **p > 0.0).map(|p| -p * p.ln()).sum();
    entropy.exp()
}

fn mean_cosine(centred: &[f64], dim: usize) -> Option<f64> {
    // Σ over i ≠ j of uᵢ·uⱼ is |Σ u|² − Σ |u|²: no need to look at pairs.
    let mut sum = vec![0.0; dim];
    let mut count = 0.0;
    for row in centred.chunks_exact(dim) {
        let norm = row.iter().map(|v| v * v).sum::<f64>().sqrt();
        if norm > 0.0 {
            sum.iter_mut().zip(row).for_each(|(s, v)| *s += v / norm);
            count += 1.0;
        }
    }
    (count >= 2.0)
        .then(|| (sum.iter().map(|s| s * s).sum::<f64>() - count) / (count * (count - 1.0)))
}

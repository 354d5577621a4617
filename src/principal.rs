//! Features as colors: their three strongest directions.

use crate::inference::{EncodeError, SceneFeatures};
use crate::preview::UNLABELLED_COLOR;
use scenesplat_kernels::eigenvectors::{Iteration, leading_eigenvectors};
use scenesplat_kernels::gemm::gemm_tn;

/// Rows that the directions are found from.
const SAMPLE: usize = 20_000;
/// A picture needs no more rounds, and of directions that rows do not have only rounding of the f32
/// sums is left, below 1e-7 of the whole.
const ITERATION: Iteration =
    Iteration { rounds: 40, settled: 0.0, negligible: 1e-6, orthogonalizations: 1 };

/// One color per Gaussian: the features' three principal components as red, green, blue, each
/// stretched over its 2–98 % range.
///
/// # Errors
/// If the features cannot be read.
pub fn principal_colors(features: &SceneFeatures) -> Result<Vec<[u8; 3]>, EncodeError> {
    let (slots, width) = (features.num_slots(), features.width());
    let step = sample_step(slots);
    let mut sample = Vec::with_capacity(slots.div_ceil(step) * width);
    for row in (0..slots).step_by(step) {
        sample.extend(features.slot_rows(row..row + 1)?);
    }
    let directions = PrincipalDirections::find(sample, width);
    let mut projected = Vec::with_capacity(slots);
    const BLOCK: usize = 4096;
    for start in (0..slots).step_by(BLOCK) {
        let rows = features.slot_rows(start..(start + BLOCK).min(slots))?;
        projected.extend(rows.chunks_exact(width).map(|row| Some(directions.project(row))));
    }
    let colors = stretched_colors(&projected);
    Ok(features.inverse().iter().map(|&s| colors[s as usize]).collect())
}

/// Which rows of many to find directions from: every so many.
pub fn sample_step(rows: usize) -> usize {
    rows.div_ceil(SAMPLE).max(1)
}

/// The three directions along which rows differ most, strongest first.
#[derive(Debug, Clone)]
pub struct PrincipalDirections {
    mean: Vec<f64>,
    /// At most three; the others are none.
    directions: Vec<Vec<f64>>,
}

impl PrincipalDirections {
    /// `rows`: `[n, width]`; without rows, or along directions that no row has, projections are 0.
    pub fn find(mut rows: Vec<f32>, width: usize) -> Self {
        let n = (rows.len() / width).max(1);
        let mut mean = vec![0f64; width];
        for row in rows.chunks_exact(width) {
            mean.iter_mut().zip(row).for_each(|(m, v)| *m += f64::from(*v) / n as f64);
        }
        for row in rows.chunks_exact_mut(width) {
            row.iter_mut().zip(&mean).for_each(|(v, m)| *v = (f64::from(*v) - m) as f32);
        }
        let mut covariance = vec![0f32; width * width];
        gemm_tn(&rows, width, &rows, width, None, &mut covariance);
        let found =
            leading_eigenvectors(&covariance, width, width.min(3), ITERATION, &mut |_| true);
        Self { mean, directions: found.unwrap_or_default() }
    }

    /// Coordinates of a row along the directions.
    pub fn project(&self, row: &[f32]) -> [f32; 3] {
        let along = |d: &Vec<f64>| -> f64 {
            row.iter().zip(&self.mean).zip(d).map(|((v, m), d)| (f64::from(*v) - m) * d).sum()
        };
        [0, 1, 2].map(|k: usize| self.directions.get(k).map_or(0.0, along) as f32)
    }
}

/// Coordinates as red, green, blue, each stretched over its 2–98 % range; rows without any take the
/// color of rows without a label.
pub fn stretched_colors(projected: &[Option<[f32; 3]>]) -> Vec<[u8; 3]> {
    let ranges: [(f32, f32); 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f32> = projected.iter().flatten().map(|p| p[axis]).collect();
        values.sort_by(f32::total_cmp);
        let at = |q: f64| values.get((values.len().saturating_sub(1) as f64 * q) as usize);
        (at(0.02).copied().unwrap_or(0.0), at(0.98).copied().unwrap_or(0.0))
    });
    let color = |p: &Option<[f32; 3]>| {
        p.map_or(UNLABELLED_COLOR, |p| {
            std::array::from_fn(|axis| {
                let (low, high) = ranges[axis];
                let t = if high > low { (p[axis] - low) / (high - low) } else { 0.5 };
                (t.clamp(0.0, 1.0) * 255.0) as u8
            })
        })
    };
    projected.iter().map(color).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_along_one_line_have_one_direction() {
        let width = 768;
        let at = |t: f32| (0..width).map(move |i| t * (i as f32 * 0.37).sin() + 0.3);
        let rows: Vec<f32> = [-1.0, 0.2, 0.9].into_iter().flat_map(at).collect();
        let found = PrincipalDirections::find(rows.clone(), width);
        let projected: Vec<[f32; 3]> =
            rows.chunks_exact(width).map(|row| found.project(row)).collect();
        assert!((projected[2][0] - projected[0][0]).abs() > 10.0, "{projected:?}");
        assert!(projected.iter().all(|p| p[1] == 0.0 && p[2] == 0.0), "{projected:?}");
        let colors = stretched_colors(&[Some(projected[0]), None, Some(projected[2])]);
        assert_eq!([colors[0][1], colors[0][2], colors[2][1]], [127; 3]);
        assert_eq!(colors[1], UNLABELLED_COLOR);
    }
}

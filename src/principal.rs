//! Features as colours: their three strongest directions.

use crate::inference::{EncodeError, SceneFeatures};
use scenesplat_kernels::gemm::gemm_tn;

/// Rows that the directions are found from.
const SAMPLE: usize = 20_000;
/// Rounds of the orthogonal iteration; the picture needs no more.
const ROUNDS: usize = 40;

/// One colour per Gaussian: the features' three principal components as red, green, blue, each
/// stretched over its 2–98 % range.
///
/// # Errors
/// If the features cannot be read.
pub fn principal_colors(features: &SceneFeatures) -> Result<Vec<[u8; 3]>, EncodeError> {
    let (slots, width) = (features.num_slots(), features.width());
    let step = slots.div_ceil(SAMPLE).max(1);
    let mut sample = Vec::with_capacity(slots / step * width);
    for row in (0..slots).step_by(step) {
        sample.extend(features.slot_rows(row..row + 1)?);
    }
    let n = sample.len() / width;
    let mut mean = vec![0f64; width];
    for row in sample.chunks_exact(width) {
        mean.iter_mut().zip(row).for_each(|(m, v)| *m += f64::from(*v) / n as f64);
    }
    for row in sample.chunks_exact_mut(width) {
        row.iter_mut().zip(&mean).for_each(|(v, m)| *v = (f64::from(*v) - m) as f32);
    }
    let mut covariance = vec![0f32; width * width];
    gemm_tn(&sample, width, &sample, width, None, &mut covariance);
    let directions = strongest(&covariance, width);

    let mut projected = Vec::with_capacity(slots);
    const BLOCK: usize = 4096;
    for start in (0..slots).step_by(BLOCK) {
        let rows = features.slot_rows(start..(start + BLOCK).min(slots))?;
        for row in rows.chunks_exact(width) {
            let dot = |d: &[f64]| -> f64 {
                row.iter().zip(&mean).zip(d).map(|((v, m), d)| (f64::from(*v) - m) * d).sum()
            };
            projected.push([dot(&directions[0]), dot(&directions[1]), dot(&directions[2])]);
        }
    }
    let ranges: [(f64, f64); 3] = std::array::from_fn(|axis| {
        let mut values: Vec<f64> = projected.iter().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        let at = |q: f64| values[((values.len() - 1) as f64 * q) as usize];
        (at(0.02), at(0.98))
    });
    let colors: Vec<[u8; 3]> = projected
        .iter()
        .map(|p| {
            std::array::from_fn(|axis| {
                let (low, high) = ranges[axis];
                let t = if high > low { (p[axis] - low) / (high - low) } else { 0.5 };
                (t.clamp(0.0, 1.0) * 255.0) as u8
            })
        })
        .collect();
    Ok(features.inverse().iter().map(|&s| colors[s as usize]).collect())
}

/// The three eigenvectors with the largest eigenvalues, by orthogonal iteration.
fn strongest(matrix: &[f32], width: usize) -> [Vec<f64>; 3] {
    // A fixed start that is not orthogonal to anything likely.
    let mut basis: [Vec<f64>; 3] = std::array::from_fn(|k| {
        (0..width).map(|i| ((i * (k + 2) + k) as f64 * 0.7).sin() + 0.01).collect()
    });
    for _ in 0..ROUNDS {
        for k in 0..3 {
            let mut next: Vec<f64> = matrix
                .chunks_exact(width)
                .map(|row| row.iter().zip(&basis[k]).map(|(m, b)| f64::from(*m) * b).sum())
                .collect();
            for done in basis.iter().take(k) {
                let dot: f64 = next.iter().zip(done).map(|(a, b)| a * b).sum();
                next.iter_mut().zip(done).for_each(|(a, b)| *a -= dot * b);
            }
            let norm = next.iter().map(|v| v * v).sum::<f64>().sqrt();
            if norm > 0.0 {
                next.iter_mut().for_each(|v| *v /= norm);
            }
            basis[k] = next;
        }
    }
    // A fixed sign, so that colours do not flip between machines.
    for direction in &mut basis {
        if direction.iter().sum::<f64>() < 0.0 {
            direction.iter_mut().for_each(|v| *v = -*v);
        }
    }
    basis
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_axes_of_a_diagonal_matrix() {
        let mut matrix = vec![0f32; 25];
        for (i, v) in [1.0, 9.0, 0.5, 4.0, 2.0].iter().enumerate() {
            matrix[i * 6] = *v;
        }
        let found = strongest(&matrix, 5);
        for (direction, axis) in found.iter().zip([1, 3, 4]) {
            assert!(direction[axis].abs() > 0.999, "{direction:?}");
        }
    }
}

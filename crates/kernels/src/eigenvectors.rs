//! Leading eigenvectors of a symmetric matrix: the directions along which rows differ most.

use crate::shape::elements;
use rayon::prelude::*;

/// How [`leading_eigenvectors`] iterates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// Most rounds.
    pub rounds: usize,
    /// One less the cosine by which a direction still turns when it counts as found; 0: all rounds.
    pub settled: f64,
    /// The part of the trace at and below which an eigenvalue is taken for rounding of the matrix.
    pub negligible: f64,
    /// How often a direction is made orthogonal to those before it in a round. Once leaves a
    /// remainder where directions nearly agree.
    pub orthogonalizations: usize,
}

impl Default for Iteration {
    fn default() -> Self {
        Self { rounds: 60, settled: 1e-12, negligible: 1e-9, orthogonalizations: 2 }
    }
}

/// The `count` eigenvectors with the largest eigenvalues of a positive semidefinite matrix (a
/// covariance), largest first, by orthogonal iteration from a fixed start.
///
/// Vectors have length 1 and a fixed sign: their values sum up to 0 or more. Where there are fewer
/// directions than asked for, the rest are 0. Sums have a fixed order, so results do not depend on
/// the number of threads. `progress` gets the part done and gives `false` to stop.
///
/// # Shapes
/// `matrix`: `[width, width]` · returns `count` vectors of `width`, or `None` if `progress` stopped it
///
/// # Panics
/// If the matrix has another size, or there are more vectors than its width (bugs of the caller).
pub fn leading_eigenvectors(
    matrix: &[f32],
    width: usize,
    count: usize,
    how: Iteration,
    progress: &mut dyn FnMut(f64) -> bool,
) -> Option<Vec<Vec<f64>>> {
    assert_eq!(matrix.len(), elements([width, width]), "eigenvectors: size of the matrix");
    assert!(count <= width, "eigenvectors: {count} of a matrix of width {width}");
    if count == 0 {
        return Some(Vec::new());
    }
    // A start that is not orthogonal to anything likely.
    let start = |k: usize, i: usize| ((i * (k + 2) + k) as f64 * 0.7).sin() + 0.01;
    let mut basis: Vec<Vec<f64>> =
        (0..count).map(|k| (0..width).map(|i| start(k, i)).collect()).collect();
    let trace: f64 = matrix.iter().step_by(width + 1).map(|v| f64::from(*v)).sum();
    for round in 0..how.rounds {
        if !progress(round as f64 / how.rounds as f64) {
            return None;
        }
        let mut next: Vec<Vec<f64>> = basis.par_iter().map(|v| product(matrix, v)).collect();
        for k in 0..count {
            let (done, rest) = next.split_at_mut(k);
            let vector = &mut rest[0];
            for _ in 0..how.orthogonalizations {
                for other in done.iter() {
                    let along = dot(vector, other);
                    vector.iter_mut().zip(other).for_each(|(v, o)| *v -= along * o);
                }
            }
            let norm = dot(vector, vector).sqrt();
            let counts = norm > how.negligible * trace;
            vector.iter_mut().for_each(|v| *v = if counts { *v / norm } else { 0.0 });
        }
        // How far each direction turned; later rounds would turn it less still.
        let turned = basis.iter().zip(&next).map(|(old, new)| 1.0 - dot(old, new).abs());
        // The start is of no particular length, so that the first round says nothing.
        let settled = round > 0 && turned.fold(0.0, f64::max) < how.settled;
        basis = next;
        if settled {
            break;
        }
    }
    for vector in &mut basis {
        // A fixed sign, so that what is made of it does not flip between machines.
        if vector.iter().sum::<f64>() < 0.0 {
            vector.iter_mut().for_each(|v| *v = -*v);
        }
    }
    Some(basis)
}

fn product(matrix: &[f32], vector: &[f64]) -> Vec<f64> {
    let row = |row: &[f32]| row.iter().zip(vector).map(|(m, v)| f64::from(*m) * v).sum();
    matrix.chunks_exact(vector.len()).map(row).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(matrix: &[f32], width: usize, count: usize) -> Vec<Vec<f64>> {
        leading_eigenvectors(matrix, width, count, Iteration::default(), &mut |_| true).unwrap()
    }

    #[test]
    fn finds_the_axes_of_a_diagonal_matrix() {
        let mut matrix = vec![0f32; 25];
        for (i, v) in [1.0, 9.0, 0.5, 4.0, 2.0].iter().enumerate() {
            matrix[i * 6] = *v;
        }
        for (direction, axis) in find(&matrix, 5, 3).iter().zip([1, 3, 4]) {
            assert!(direction[axis] > 0.999, "{direction:?}");
        }
    }

    #[test]
    fn vectors_are_orthonormal_and_reproduce_the_matrix() {
        // A sum of four known directions with eigenvalues far apart.
        let width = 40;
        let values = [100.0, 20.0, 3.0, 0.4];
        let mut known: Vec<Vec<f64>> = Vec::new();
        for k in 0..4 {
            let mut v: Vec<f64> = (0..width).map(|i| ((i * i * (k + 1)) as f64).sin()).collect();
            for other in &known {
                let along = dot(&v, other);
                v.iter_mut().zip(other).for_each(|(v, o)| *v -= along * o);
            }
            let norm = dot(&v, &v).sqrt();
            v.iter_mut().for_each(|v| *v /= norm);
            known.push(v);
        }
        let entry = |i: usize, j: usize| -> f64 {
            known.iter().zip(values).map(|(v, value)| value * v[i] * v[j]).sum()
        };
        let matrix: Vec<f32> =
            (0..width * width).map(|at| entry(at / width, at % width) as f32).collect();
        let found = find(&matrix, width, 4);
        for (j, v) in found.iter().enumerate() {
            assert!((dot(v, &known[j]).abs() - 1.0).abs() < 1e-4, "{j}");
            assert!(v.iter().sum::<f64>() >= 0.0, "the sign");
            for (k, other) in found.iter().enumerate() {
                let want = f64::from(u8::from(j == k));
                assert!((dot(v, other) - want).abs() < 1e-9, "{j} {k}");
            }
        }
    }

    #[test]
    fn rounding_errors_are_no_directions() {
        // Rows of two directions only, in no axis: what else the matrix seems to have is rounding.
        let (width, rows) = (7, 50);
        let row = |r: usize| -> Vec<f32> {
            let [a, b] = [(r as f32 * 0.7).sin(), (r as f32 * 1.3).cos()];
            (0..width).map(|i| a * (i as f32 + 0.3).sin() + b * (i as f32 * 2.1).cos()).collect()
        };
        let mut matrix = vec![0f32; width * width];
        for row in (0..rows).map(row) {
            for (i, to) in matrix.iter_mut().enumerate() {
                *to += row[i / width] * row[i % width];
            }
        }
        let how = Iteration { negligible: 1e-6, ..Iteration::default() };
        let found = leading_eigenvectors(&matrix, width, 4, how, &mut |_| true).unwrap();
        for vector in &found[..2] {
            assert!((dot(vector, vector) - 1.0).abs() < 1e-12, "{found:?}");
        }
        assert!(found[2..].iter().flatten().all(|v| *v == 0.0), "{found:?}");
    }

    #[test]
    fn missing_directions_are_zero_and_a_stop_is_one() {
        let mut matrix = vec![0f32; 9];
        matrix[0] = 2.0;
        let found = find(&matrix, 3, 3);
        assert!(found[0][0] > 0.999 && found[1..].iter().flatten().all(|v| *v == 0.0), "{found:?}");
        assert!(find(&[0.0; 9], 3, 2).iter().flatten().all(|v| *v == 0.0));
        assert_eq!(find(&[], 0, 0), Vec::<Vec<f64>>::new());
        let how = Iteration::default();
        assert_eq!(leading_eigenvectors(&matrix, 3, 1, how, &mut |_| false), None);
    }
}

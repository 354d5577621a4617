//! All eigenvectors of a symmetric matrix: Householder reduction to three diagonals, then implicit QL.
//!
//! [`leading_eigenvectors`](crate::eigenvectors::leading_eigenvectors) finds few vectors of a wide
//! matrix sooner; this finds many, and every eigenvalue, in a known number of operations.

use crate::shape::elements;
use rayon::prelude::*;

/// Sweeps after which an eigenvalue is taken as it is; two or three are usual.
const MOST_SWEEPS: usize = 60;
/// Columns of a panel of eigenvectors: one task turns them all.
const PANEL: usize = 32;

/// Eigenvalues and eigenvectors, the largest value first.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetricEigen {
    /// `[n]`, descending.
    pub values: Vec<f64>,
    /// Row `i` belongs to value `i`; length 1, the value of largest magnitude above 0. `[count, n]`
    pub vectors: Vec<f64>,
}

/// All eigenvalues of a symmetric matrix, and the eigenvectors of the `count` largest.
///
/// Sums have a fixed order, so results do not depend on the number of threads. Of the matrix, the
/// part on and above the diagonal counts.
///
/// # Shapes
/// `matrix`: `[n, n]`
///
/// # Panics
/// If the matrix has another size, or `count` is above `n` (bugs of the caller).
pub fn symmetric_eigen(matrix: &[f64], n: usize, count: usize) -> SymmetricEigen {
    assert_eq!(matrix.len(), elements([n, n]), "eigenvectors: size of the matrix");
    assert!(count <= n, "eigenvectors: {count} of a matrix of width {n}");
    let Reduced { mut diagonal, mut beside, reflectors } = reduce(matrix, n);
    let turns = turn(&mut diagonal, &mut beside);
    let mut by_value: Vec<usize> = (0..n).collect();
    by_value.sort_by(|&a, &b| diagonal[b].total_cmp(&diagonal[a]));
    let panels = turned_identity(n, &turns);
    let mut vectors = vec![0.0; count * n];
    vectors.par_chunks_mut(n.max(1)).zip(&by_value).for_each(|(vector, &row)| {
        for (part, panel) in vector.chunks_mut(PANEL).zip(&panels) {
            let width = part.len();
            part.copy_from_slice(&panel[row * width..(row + 1) * width]);
        }
        for (k, mirror) in reflectors.iter().enumerate().rev() {
            reflect(&mut vector[k + 1..], mirror);
        }
        let longest =
            vector.iter().copied().fold(0.0, |a: f64, v| if v.abs() > a.abs() { v } else { a });
        if longest < 0.0 {
            vector.iter_mut().for_each(|v| *v = -*v);
        }
    });
    SymmetricEigen { values: by_value.iter().map(|&i| diagonal[i]).collect(), vectors }
}

struct Reduced {
    diagonal: Vec<f64>,
    /// The element right of each diagonal one; 0 for the last.
    beside: Vec<f64>,
    /// Unit normals of the mirrors, the k-th acting on the elements behind k; empty for none.
    reflectors: Vec<Vec<f64>>,
}

/// Mirrors the matrix until only three diagonals are left.
fn reduce(matrix: &[f64], n: usize) -> Reduced {
    let mut rows: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| matrix[i.min(j) * n + i.max(j)]).collect()).collect();
    let mut beside = vec![0.0; n];
    let mut reflectors = Vec::new();
    for k in 0..n.saturating_sub(2) {
        let mut normal = rows[k][k + 1..].to_vec();
        // Scaled, so that squares neither overflow nor vanish.
        let scale = normal.iter().fold(0.0, |a: f64, v| a.max(v.abs()));
        if normal[1..].iter().all(|v| *v == 0.0) {
            beside[k] = normal[0];
            reflectors.push(Vec::new());
            continue;
        }
        normal.iter_mut().for_each(|v| *v /= scale);
        let length = dot(&normal, &normal).sqrt();
        let to = -length.copysign(normal[0]);
        normal[0] -= to;
        let norm = dot(&normal, &normal).sqrt();
        normal.iter_mut().for_each(|v| *v /= norm);
        beside[k] = to * scale;
        let behind = &mut rows[k + 1..];
        let products: Vec<f64> = behind.par_iter().map(|row| dot(&row[k + 1..], &normal)).collect();
        let along = dot(&products, &normal);
        let twice: Vec<f64> =
            products.iter().zip(&normal).map(|(p, v)| 2.0 * (p - along * v)).collect();
        behind.par_iter_mut().enumerate().for_each(|(i, row)| {
            let (v, w) = (normal[i], twice[i]);
            for ((to, a), b) in row[k + 1..].iter_mut().zip(&twice).zip(&normal) {
                *to -= v * a + w * b;
            }
        });
        reflectors.push(normal);
    }
    if n > 1 {
        beside[n - 2] = rows[n - 2][n - 1];
    }
    Reduced { diagonal: (0..n).map(|i| rows[i][i]).collect(), beside, reflectors }
}

/// A turn of rows `row` and `row + 1`.
struct Turn {
    row: u32,
    cos: f64,
    sin: f64,
}

/// Turns the three diagonals into one, which holds the eigenvalues then; gives the turns in their
/// order.
fn turn(d: &mut [f64], e: &mut [f64]) -> Vec<Turn> {
    let n = d.len();
    let mut turns = Vec::new();
    for l in 0..n {
        for _ in 0..MOST_SWEEPS {
            let small = |m: usize| e[m].abs() <= f64::EPSILON * (d[m].abs() + d[m + 1].abs());
            let m = (l..n - 1).find(|&m| small(m)).unwrap_or(n - 1);
            if m == l {
                break;
            }
            let mut g = (d[l + 1] - d[l]) / (2.0 * e[l]);
            g = d[m] - d[l] + e[l] / (g + g.hypot(1.0).copysign(g));
            let (mut s, mut c, mut p) = (1.0, 1.0, 0.0);
            let mut whole = true;
            for i in (l..m).rev() {
                let (f, b) = (s * e[i], c * e[i]);
                let r = f.hypot(g);
                e[i + 1] = r;
                if r == 0.0 {
                    d[i + 1] -= p;
                    e[m] = 0.0;
                    whole = false;
                    break;
                }
                (s, c) = (f / r, g / r);
                g = d[i + 1] - p;
                let r = (d[i] - g) * s + 2.0 * c * b;
                p = s * r;
                d[i + 1] = g + p;
                g = c * r - b;
                turns.push(Turn { row: i as u32, cos: c, sin: s });
            }
            if whole {
                d[l] -= p;
                e[l] = g;
                e[m] = 0.0;
            }
        }
    }
    turns
}

/// The rows of the unit matrix after all turns, in panels of [`PANEL`] columns: `[n, width]` each.
fn turned_identity(n: usize, turns: &[Turn]) -> Vec<Vec<f64>> {
    (0..n.div_ceil(PANEL))
        .into_par_iter()
        .map(|panel| {
            let first = panel * PANEL;
            let width = PANEL.min(n - first);
            let mut rows = vec![0.0; n * width];
            (0..width).for_each(|column| rows[(first + column) * width + column] = 1.0);
            for &Turn { row, cos, sin } in turns {
                let two = &mut rows[row as usize * width..][..2 * width];
                let (upper, lower) = two.split_at_mut(width);
                for (a, b) in upper.iter_mut().zip(lower) {
                    (*a, *b) = (cos * *a - sin * *b, sin * *a + cos * *b);
                }
            }
            rows
        })
        .collect()
}

/// Mirrors a vector at the plane with this unit normal; no normal leaves it.
fn reflect(vector: &mut [f64], normal: &[f64]) {
    let along = 2.0 * dot(&vector[..normal.len()], normal);
    vector.iter_mut().zip(normal).for_each(|(v, n)| *v -= along * n);
}

/// Eight sums side by side, so that they fill registers; always in the same order.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a8.remainder().iter().zip(b8.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a8.zip(b8) {
        (0..8).for_each(|i| sums[i] += a[i] * b[i]);
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    fn symmetric(n: usize, seed: u64, scale: f64) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut matrix = vec![0.0; n * n];
        for i in 0..n {
            for j in i..n {
                let v = scale * rng.random_range(-1.0..1.0);
                (matrix[i * n + j], matrix[j * n + i]) = (v, v);
            }
        }
        matrix
    }

    /// What makes it one: `A v = λ v`, orthonormal vectors, falling values whose sum is the trace.
    fn check(matrix: &[f64], n: usize) {
        let found = symmetric_eigen(matrix, n, n);
        let scale = matrix.iter().fold(f64::MIN_POSITIVE, |a, v| a.max(v.abs())) * n as f64;
        let row = |i: usize| &found.vectors[i * n..(i + 1) * n];
        for i in 0..n {
            for j in 0..n {
                let product = dot(&matrix[j * n..(j + 1) * n], row(i));
                let off = (product - found.values[i] * row(i)[j]).abs();
                assert!(off <= 1e-13 * scale, "{n}: {i} {j}: {off}");
                let want = f64::from(u8::from(i == j));
                assert!((dot(row(i), row(j)) - want).abs() < 1e-12, "{n}: {i} {j}");
            }
            let longest =
                row(i).iter().copied().fold(0.0f64, |a, v| if v.abs() > a.abs() { v } else { a });
            assert!(longest > 0.0);
        }
        assert!(found.values.is_sorted_by(|a, b| a >= b));
        let trace: f64 = (0..n).map(|i| matrix[i * n + i]).sum();
        assert!((found.values.iter().sum::<f64>() - trace).abs() <= 1e-12 * scale);
        let some = symmetric_eigen(matrix, n, n / 2);
        assert_eq!(some.values, found.values);
        assert_eq!(some.vectors, found.vectors[..n / 2 * n]);
    }

    #[test]
    fn it_is_what_an_eigendecomposition_is() {
        for (n, seed) in [(1, 1), (2, 2), (3, 3), (7, 4), (33, 5), (64, 6), (70, 7)] {
            for scale in [1.0, 1e150, 1e-150] {
                check(&symmetric(n, seed, scale), n);
            }
        }
    }

    #[test]
    fn hard_matrices() {
        for n in [1, 2, 5, 40] {
            check(&vec![0.0; n * n], n);
            check(&vec![1.0; n * n], n);
            let diagonal: Vec<f64> =
                (0..n * n).map(|i| if i % (n + 1) == 0 { (i % 3) as f64 } else { 0.0 }).collect();
            check(&diagonal, n);
            // Values over twenty orders.
            let graded: Vec<f64> =
                (0..n * n).map(|i| 10f64.powi(-((i / n + i % n) as i32) / 4)).collect();
            check(&graded, n);
        }
        assert!(symmetric_eigen(&[], 0, 0).values.is_empty());
    }

    #[test]
    fn known_values_come_out() {
        // 2 on the diagonal, -1 beside it: 2 - 2 cos(k π / (n + 1)).
        let n = 20;
        let entry = |i: usize, j: usize| match i.abs_diff(j) {
            0 => 2.0,
            1 => -1.0,
            _ => 0.0,
        };
        let matrix: Vec<f64> = (0..n * n).map(|at| entry(at / n, at % n)).collect();
        let found = symmetric_eigen(&matrix, n, 0);
        for (k, value) in found.values.iter().rev().enumerate() {
            let angle = (k + 1) as f64 * std::f64::consts::PI / (n + 1) as f64;
            assert!((value - (2.0 - 2.0 * angle.cos())).abs() < 1e-13, "{k}: {value}");
        }
    }

    #[test]
    fn threads_change_no_bit() {
        let matrix = symmetric(150, 9, 1.0);
        let run = |threads| crate::tests::on_threads(threads, || symmetric_eigen(&matrix, 150, 60));
        assert_eq!(run(1), run(3));
    }
}

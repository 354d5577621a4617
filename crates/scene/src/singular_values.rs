//! Singular values of a 3×3 matrix.

use crate::frame::{Matrix3, transposed};
use crate::vector::{cross, dot};

/// Sweeps after which even hard matrices have converged.
const MAX_SWEEPS: usize = 30;

/// Columns whose cosine is below this are at right angles.
const ORTHOGONAL: f64 = 1e-15;

/// `m = u · diag(s) · vᵀ` with orthogonal `u` and `v`, and `s` descending and not negative.
///
/// Pairs of columns are turned until all are at right angles (the method of Jacobi, one-sided).
/// Small singular values keep their digits when columns of `m` differ by many orders of magnitude,
/// which an eigendecomposition of `mᵀm` would lose. Deterministic; equal values keep their order.
pub(crate) fn singular_values(m: &Matrix3) -> (Matrix3, [f64; 3], Matrix3) {
    // Columns as rows, for easier handling.
    let mut columns = transposed(m);
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..MAX_SWEEPS {
        let mut turned = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (alpha, beta) = (dot(columns[p], columns[p]), dot(columns[q], columns[q]));
            let gamma = dot(columns[p], columns[q]);
            // Products of roots: the product of two squares could underflow.
            if gamma.is_nan() || gamma.abs() <= ORTHOGONAL * (alpha.sqrt() * beta.sqrt()) {
                continue;
            }
            turned = true;
            let zeta = (beta - alpha) / (2.0 * gamma);
            let t = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
            let c = 1.0 / t.hypot(1.0);
            turn(&mut columns, p, q, c, c * t);
            turn(&mut v, p, q, c, c * t);
        }
        if !turned {
            break;
        }
    }
    let norm = columns.map(|c| dot(c, c).sqrt());
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| norm[b].total_cmp(&norm[a]));
    let s = order.map(|i| norm[i]);
    let mut u = order.map(|i| columns[i].map(|x| x / norm[i]));
    complete(&mut u, &s);
    let v = order.map(|i| v[i]);
    (transposed(&u), s, transposed(&v))
}

/// Turns two rows in their plane.
fn turn(rows: &mut Matrix3, p: usize, q: usize, c: f64, s: f64) {
    let (a, b) = (rows[p], rows[q]);
    rows[p] = [0, 1, 2].map(|i| c * a[i] - s * b[i]);
    rows[q] = [0, 1, 2].map(|i| s * a[i] + c * b[i]);
}

/// Gives the directions of singular values 0, which may be any at right angles to the others.
fn complete(u: &mut Matrix3, s: &[f64; 3]) {
    if s[0] == 0.0 {
        *u = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        return;
    }
    if s[1] == 0.0 {
        let a = u[0];
        // The axis furthest from the direction there is.
        let least = (0..3).fold(0, |best, i| if a[i].abs() < a[best].abs() { i } else { best });
        let mut axis = [0.0; 3];
        axis[least] = 1.0;
        let across = cross(a, axis);
        let norm = dot(across, across).sqrt();
        u[1] = across.map(|x| x / norm);
    }
    if s[2] == 0.0 {
        u[2] = cross(u[0], u[1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::product;

    fn check(m: Matrix3) -> [f64; 3] {
        let (u, s, v) = singular_values(&m);
        let transposed = |m: &Matrix3| [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
        for orthogonal in [u, v] {
            let square = product(&orthogonal, &transposed(&orthogonal));
            for i in 0..3 {
                for j in 0..3 {
                    let due = f64::from(u8::from(i == j));
                    assert!((square[i][j] - due).abs() < 1e-12, "{m:?}: {orthogonal:?}");
                }
            }
        }
        assert!(s[0] >= s[1] && s[1] >= s[2] && s[2] >= 0.0, "{m:?}: {s:?}");
        let back =
            product(&u.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]), &transposed(&v));
        for i in 0..3 {
            for j in 0..3 {
                assert!((back[i][j] - m[i][j]).abs() <= 1e-14 * s[0], "{m:?}: {back:?}");
            }
        }
        s
    }

    #[test]
    fn known_values() {
        assert_eq!(check([[0.0, -2.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), [3.0, 2.0, 1.0]);
        assert_eq!(check([[0.0; 3]; 3]), [0.0; 3]);
        // A product of a column and a row has one singular value, the product of their norms.
        let s = check([[2.0, 4.0, 4.0], [1.0, 2.0, 2.0], [2.0, 4.0, 4.0]]);
        assert!((s[0] - 9.0).abs() < 1e-14 && s[1] < 1e-14, "{s:?}");
        check([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]);
    }

    #[test]
    fn small_values_keep_their_digits() {
        // Columns 1, 1e-8 and 1e-16 of lengths, at angles: the product of the values is |det|.
        let m = [[1.0, 0.6e-8, 0.0], [0.0, 0.8e-8, 0.6e-16], [0.0, 0.0, 0.8e-16]];
        let s = check(m);
        let product = s[0] * s[1] * s[2];
        assert!((product / 0.64e-24 - 1.0).abs() < 1e-12, "{s:?}");
        assert!((s[2] / 0.8e-16 - 1.0).abs() < 1e-7, "{s:?}");
    }
}

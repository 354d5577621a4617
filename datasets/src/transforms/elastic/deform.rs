//! A Gaussian under a linear map.

use crate::transforms::quaternion::{matrix, of_matrix, unit, with_positive_w};
use scenesplat_scene::vector::{cross, dot};

/// Rows first.
pub(super) type Matrix = [[f64; 3]; 3];

/// Sizes of 0 are computed with as this part of the largest, so that their axes keep a direction.
const STAND_IN: f64 = 1e-25;

/// Orientation and sizes of the Gaussian whose covariance is `J Σ Jᵀ`.
///
/// The columns of `J R S` are made orthogonal by rotations of pairs (the one-sided Jacobi method):
/// then their lengths are the new sizes and their directions the new axes. It is exact relative to
/// each column, so that thin Gaussians stay thin, and each axis stays the one it was nearly.
pub(super) fn deform_gaussian(
    gradient: &Matrix,
    quat: [f32; 4],
    scale: [f32; 3],
) -> ([f32; 4], [f32; 3]) {
    let axes = matrix(unit(quat.map(f64::from)));
    let largest = scale.iter().fold(0.0, |max: f32, s| max.max(*s));
    if !(scale.iter().all(|s| s.is_finite() && *s >= 0.0)) {
        // Nothing can be computed of it; it is found before it reaches the network.
        return (quat, scale);
    }
    let stand_in = if largest > 0.0 { f64::from(largest) * STAND_IN } else { 1.0 };
    let size = scale.map(|s| if s > 0.0 { f64::from(s) } else { stand_in });
    // Column `k` of J R S.
    let mut columns: [[f64; 3]; 3] = std::array::from_fn(|k| {
        std::array::from_fn(|i| (0..3).map(|j| gradient[i][j] * axes[j][k]).sum::<f64>() * size[k])
    });
    orthogonalise(&mut columns);
    let length = columns.map(|c| dot(c, c).sqrt());
    let size = std::array::from_fn(|k| if scale[k] > 0.0 { length[k] as f32 } else { 0.0 });
    if length.iter().any(|&l| !(l.is_finite() && l > 0.0)) {
        // The map flattens space to a plane: such a turn is not defined.
        return (quat, size);
    }
    let mut direction: [[f64; 3]; 3] = std::array::from_fn(|k| columns[k].map(|v| v / length[k]));
    if dot(cross(direction[0], direction[1]), direction[2]) < 0.0 {
        direction[2] = direction[2].map(|v| -v);
    }
    let rotation = std::array::from_fn(|i| std::array::from_fn(|k| direction[k][i]));
    (with_positive_w(of_matrix(rotation)).map(|v| v as f32), size)
}

/// The direction of a surface normal on the moved surface: `det(J) J⁻ᵀ n`, normalized; a normal of
/// length 0 stays.
pub(super) fn deform_normal(gradient: &Matrix, normal: [f32; 3]) -> [f32; 3] {
    let n = normal.map(f64::from);
    let [a, b, c] = *gradient;
    // The rows of the cofactor matrix.
    let cofactors = [cross(b, c), cross(c, a), cross(a, b)];
    let sign = if dot(a, cofactors[0]) < 0.0 { -1.0 } else { 1.0 };
    let moved = cofactors.map(|row| sign * dot(row, n));
    let norm = dot(moved, moved).sqrt();
    if norm.is_finite() && norm > 0.0 { moved.map(|v| (v / norm) as f32) } else { normal }
}

/// Turns pairs of columns until all are at right angles.
fn orthogonalise(columns: &mut [[f64; 3]; 3]) {
    /// Three columns need about five; the rest is for luck.
    const MAX_SWEEPS: usize = 12;
    const RIGHT_ANGLE: f64 = 1e-15;
    for _ in 0..MAX_SWEEPS {
        let mut turned = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (columns[p], columns[q]);
            let (aa, bb, ab) = (dot(a, a), dot(b, b), dot(a, b));
            if ab == 0.0 || ab.abs() <= RIGHT_ANGLE * (aa.sqrt() * bb.sqrt()) {
                continue;
            }
            turned = true;
            let zeta = (bb - aa) / (2.0 * ab);
            // The smaller of the two angles, so that no axis takes the place of another.
            let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            let cos = 1.0 / (1.0 + t * t).sqrt();
            let sin = cos * t;
            columns[p] = std::array::from_fn(|i| cos * a[i] - sin * b[i]);
            columns[q] = std::array::from_fn(|i| sin * a[i] + cos * b[i]);
        }
        if !turned {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::normals;
    use crate::sample_rng;
    use crate::transforms::testing::{congruent, covariance, difference};

    fn random(seed: u64, spread: f64) -> (Matrix, [f32; 4]) {
        let mut values = [0.0; 13];
        normals(&mut sample_rng(seed, 0, 0), 13, |i, x| values[i] = x);
        let gradient = std::array::from_fn(|i| {
            std::array::from_fn(|j| f64::from(u8::from(i == j)) + spread * values[i * 3 + j])
        });
        let quat = unit([values[9], values[10], values[11], values[12]]);
        (gradient, with_positive_w(quat).map(|v| v as f32))
    }

    #[test]
    fn covariances_are_mapped() {
        let shapes: [[f32; 3]; 5] = [
            [0.1, 0.1, 0.1],
            [0.3, 0.02, 0.1],
            [1.0, 1.0, 1e-6],
            [2.0, 1e-5, 1e-5],
            [0.0, 0.2, 0.1],
        ];
        for seed in 0..300 {
            let (gradient, quat) = random(seed, 0.3);
            for scale in shapes {
                let (q, s) = deform_gaussian(&gradient, quat, scale);
                let expected = congruent(gradient, covariance(quat, scale));
                let size = expected.iter().flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
                let error = difference(expected, covariance(q, s)) / size;
                assert!(error < 1e-6, "{seed} {scale:?}: {error}");
                assert!(q[0] >= 0.0 && (q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn thin_axes_keep_their_size() {
        // A rotation changes no size, however small.
        let turn = matrix(unit([1.0, 0.3, -0.2, 0.5]));
        let (q, s) = deform_gaussian(&turn, [0.5; 4], [1.0, 1e-9, 3e-4]);
        for (got, expected) in s.iter().zip([1.0, 1e-9, 3e-4]) {
            assert!((got / expected - 1.0).abs() < 1e-5, "{s:?}");
        }
        assert!(q.iter().all(|v| v.is_finite()));
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (q, s) = deform_gaussian(&identity, [0.5; 4], [0.3, 0.1, 0.2]);
        assert_eq!(s, [0.3, 0.1, 0.2]);
        assert!(q.iter().all(|v| (v - 0.5).abs() < 1e-7));
    }

    #[test]
    fn odd_gaussians_and_maps() {
        let (gradient, quat) = random(1, 0.3);
        assert_eq!(deform_gaussian(&gradient, quat, [0.0; 3]).1, [0.0; 3]);
        let nan = deform_gaussian(&gradient, quat, [f32::NAN, 1.0, 1.0]).1;
        assert!(nan[0].is_nan());
        let huge = deform_gaussian(&gradient, quat, [1e30, 1e-30, 1.0]);
        assert!(huge.0.iter().chain(&huge.1).all(|v| v.is_finite()));
        let flat = deform_gaussian(&[[0.0; 3]; 3], quat, [0.1; 3]);
        assert_eq!(flat, (quat, [0.0; 3]));
        let mirror = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let (q, s) = deform_gaussian(&mirror, quat, [0.1, 0.2, 0.3]);
        let expected = congruent(mirror, covariance(quat, [0.1, 0.2, 0.3]));
        assert!(difference(expected, covariance(q, s)) < 1e-7);
    }

    #[test]
    fn normals_stay_at_right_angles_to_the_surface() {
        for seed in 0..100 {
            let (gradient, quat) = random(seed, 0.3);
            let axes = matrix(unit(quat.map(f64::from)));
            let column = |k: usize| [axes[0][k], axes[1][k], axes[2][k]];
            let normal = deform_normal(&gradient, column(2).map(|v| v as f32)).map(f64::from);
            for k in 0..2 {
                let tangent = gradient.map(|row| dot(row, column(k)));
                assert!(dot(tangent, normal).abs() < 1e-5);
            }
            assert!((dot(normal, normal) - 1.0).abs() < 1e-6);
            // It stays on its side: what lay above the surface lies above the moved one.
            let above = gradient.map(|row| dot(row, column(2)));
            assert!(dot(above, normal) > 0.0, "{seed}");
        }
        assert_eq!(deform_normal(&[[0.0; 3]; 3], [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]);
    }
}

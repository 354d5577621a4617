//! Quaternions `w, x, y, z`, in f64.

pub(crate) use scenesplat_scene::vector::rotation as matrix;

/// A unit quaternion; no rotation for zero, NaN and infinite ones, which turn nothing.
pub(crate) fn unit(quat: [f64; 4]) -> [f64; 4] {
    // Scaled first, so that no square over- or underflows.
    let largest = quat.iter().fold(0.0, |max: f64, v| max.max(v.abs()));
    if !(quat.iter().all(|v| v.is_finite()) && largest > 0.0) {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let quat = quat.map(|v| v / largest);
    let norm = quat.iter().map(|v| v * v).sum::<f64>().sqrt();
    quat.map(|v| v / norm)
}

/// The rotation `b`, then `a`.
pub(crate) fn product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let ([w, x, y, z], [p, q, r, s]) = (a, b);
    [
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    ]
}

/// The same rotation with `w ≥ 0`.
pub(crate) fn with_positive_w(quat: [f64; 4]) -> [f64; 4] {
    if quat[0] < 0.0 { quat.map(|v| -v) } else { quat }
}

/// The unit quaternion of a rotation matrix, its largest component positive (Shepperd's method).
pub(crate) fn of_matrix(m: [[f64; 3]; 3]) -> [f64; 4] {
    let trace = m[0][0] + m[1][1] + m[2][2];
    let squares = [trace, m[0][0], m[1][1], m[2][2]];
    let larger = |best: usize, i: usize| if squares[i] > squares[best] { i } else { best };
    let quat = match (1..4).fold(0, larger) {
        0 => [1.0 + trace, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]],
        i => {
            let (i, j, k) = (i - 1, i % 3, (i + 1) % 3);
            let mut quat = [0.0; 4];
            quat[0] = m[k][j] - m[j][k];
            quat[i + 1] = 1.0 + 2.0 * m[i][i] - trace;
            quat[j + 1] = m[j][i] + m[i][j];
            quat[k + 1] = m[k][i] + m[i][k];
            quat
        }
    };
    unit(quat)
}

/// A matrix times a column.
pub(crate) fn times(m: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::normals;
    use crate::sample_rng;

    fn random(seed: u64) -> [f64; 4] {
        let mut quat = [0.0; 4];
        normals(&mut sample_rng(seed, 0, 0), 4, |i, x| quat[i] = x);
        unit(quat)
    }

    #[test]
    fn products_are_products_of_matrices() {
        for seed in 0..50 {
            let (a, b) = (random(seed), random(seed + 1000));
            let v = [1.0, -2.0, 0.5];
            let one = times(matrix(product(a, b)), v);
            let two = times(matrix(a), times(matrix(b), v));
            assert!((0..3).all(|i| (one[i] - two[i]).abs() < 1e-12));
        }
    }

    #[test]
    fn matrices_give_their_quaternion_back() {
        let exact: [[f64; 4]; 5] = [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.5; 4],
        ];
        for quat in exact.into_iter().chain((0..200).map(random)) {
            let back = of_matrix(matrix(quat));
            let dot: f64 = (0..4).map(|i| quat[i] * back[i]).sum();
            assert!((dot.abs() - 1.0).abs() < 1e-12, "{quat:?} {back:?}");
        }
    }

    #[test]
    fn odd_quaternions_turn_nothing_or_are_scaled() {
        let none = [1.0, 0.0, 0.0, 0.0];
        assert_eq!(unit([0.0; 4]), none);
        assert_eq!(unit([f64::NAN, 1.0, 0.0, 0.0]), none);
        assert_eq!(unit([f64::INFINITY, 1.0, 0.0, 0.0]), none);
        for size in [1e-300, 1e-30, 1.0, 1e30, 1e300] {
            let quat = unit([0.0, 3.0 * size, 0.0, -4.0 * size]);
            assert!((quat[1] - 0.6).abs() < 1e-15 && (quat[3] + 0.8).abs() < 1e-15);
            assert_eq!((quat[0], quat[2]), (0.0, 0.0));
        }
    }
}

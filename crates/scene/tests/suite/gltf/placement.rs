//! Where Gaussians are, and what they look like, after a matrix.

use crate::common::check_unit;
use scenesplat_scene::GaussianScene;
use scenesplat_scene::spherical_harmonics::rest_basis;

pub(crate) type Matrix4 = [[f64; 4]; 4];

pub(crate) fn times(a: &Matrix4, b: &Matrix4) -> Matrix4 {
    let cell = |i: usize, j: usize| (0..4).map(|k| a[i][k] * b[k][j]).sum();
    std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j)))
}

/// From right-handed y-up with +z toward the viewer's front to right, down, forward.
pub(crate) const TO_CANONICAL: Matrix4 =
    [[-1., 0., 0., 0.], [0., -1., 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]];

pub(crate) fn covariance(scene: &GaussianScene, row: usize) -> [[f64; 3]; 3] {
    let [w, x, y, z] = scene.quat[row].map(f64::from);
    let norm = w * w + x * x + y * y + z * z;
    // Of a quaternion of any length.
    let r = [
        [norm - 2. * (y * y + z * z), 2. * (x * y - w * z), 2. * (x * z + w * y)],
        [2. * (x * y + w * z), norm - 2. * (x * x + z * z), 2. * (y * z - w * x)],
        [2. * (x * z - w * y), 2. * (y * z + w * x), norm - 2. * (x * x + y * y)],
    ]
    .map(|row| row.map(|v| v / norm));
    let variance = scene.log_scale[row].map(|s| (2.0 * f64::from(s)).exp());
    std::array::from_fn(|i| {
        std::array::from_fn(|j| (0..3).map(|k| r[i][k] * variance[k] * r[j][k]).sum())
    })
}

/// Positions and covariances of `after` are those of `before` under the matrix.
pub(crate) fn check_moved(before: &GaussianScene, after: &GaussianScene, by: &Matrix4) {
    assert_eq!(before.len(), after.len());
    for row in 0..before.len() {
        let p = before.coord[row].map(f64::from);
        let sigma = covariance(before, row);
        let got = covariance(after, row);
        let size = (0..3).map(|i| got[i][i]).sum::<f64>();
        for i in 0..3 {
            let due = (0..3).map(|k| by[i][k] * p[k]).sum::<f64>() + by[i][3];
            let is = f64::from(after.coord[row][i]);
            assert!((is - due).abs() <= 1e-6 * (1.0 + due.abs()), "row {row}: {is} {due}");
            for j in 0..3 {
                let terms = (0..9).map(|n| by[i][n / 3] * sigma[n / 3][n % 3] * by[j][n % 3]);
                let due: f64 = terms.sum();
                assert!((got[i][j] - due).abs() <= 2e-6 * size, "row {row}: {got:?}");
            }
        }
    }
    check_unit(after);
}

/// The harmonics of one color channel in direction `d`.
pub(crate) fn shine(scene: &GaussianScene, row: usize, channel: usize, d: [f64; 3]) -> f64 {
    let width = scene.sh_rest_len() * 3;
    let rest = &scene.sh_rest[row * width..(row + 1) * width];
    let values = rest.iter().skip(channel).step_by(3);
    values.zip(rest_basis(d)).map(|(&v, y)| f64::from(v) * y).sum()
}

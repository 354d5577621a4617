//! Moving, turning, mirroring and resizing a whole scene.

use crate::GaussianScene;
use crate::frame::{Frame, Matrix3, determinant, matrix};
use crate::place::{NO_ORIGIN, origin_of};
use crate::spherical_harmonics::ShRotation;
use glam::DVec3;
use rayon::prelude::*;

/// `p ↦ scale · rotation · p + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// An orthogonal matrix; determinant −1 mirrors.
    pub rotation: Matrix3,
    /// Above 0.
    pub scale: f64,
    /// In units of the result.
    pub translation: [f64; 3],
}

impl Similarity {
    /// Leaves everything as it is.
    pub const IDENTITY: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        scale: 1.0,
        translation: [0.0; 3],
    };

    /// From one frame to another, in the same units and about the same origin.
    pub fn between(from: Frame, to: Frame) -> Self {
        Self { rotation: from.matrix_to(to), scale: 1.0, translation: [0.0; 3] }
    }

    /// Where a point comes to lie.
    pub(crate) fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let turned = matrix(&self.rotation) * DVec3::from(p);
        (self.scale * turned + DVec3::from(self.translation)).to_array()
    }

    /// Whether only signs of axes change.
    fn axis_signs(&self) -> Option<[f32; 3]> {
        let m = &self.rotation;
        let diagonal = (0..3)
            .all(|i| (0..3).all(|j| if i == j { m[i][j].abs() == 1.0 } else { m[i][j] == 0.0 }));
        diagonal.then(|| [m[0][0] as f32, m[1][1] as f32, m[2][2] as f32])
    }
}

impl GaussianScene {
    /// Transforms positions, sizes, orientations, normals, harmonics and labeled points.
    ///
    /// Where only signs of axes change, every number keeps its magnitude bit for bit: the scene can
    /// be taken there and back without loss. Rows with NaN stay NaN.
    ///
    /// The similarity is one of the coordinates of the file, so the origin is transformed too, and
    /// takes up the translation. It becomes zero where the scene is near 0 afterwards. A scene
    /// without an origin gets none.
    pub fn transform(&mut self, by: &Similarity) {
        let turn = matrix(&by.rotation);
        let turned = |v: &[f32; 3]| turn * DVec3::from(v.map(f64::from));
        self.transform_positions(by);
        if let Some(normal) = &mut self.normal {
            normal.par_iter_mut().for_each(|n| *n = turned(n).as_vec3().to_array());
        }
        if by.scale != 1.0 {
            let add = by.scale.ln();
            let grow = |s: &mut f32| *s = (f64::from(*s) + add) as f32;
            self.log_scale.par_iter_mut().for_each(|s| s.iter_mut().for_each(grow));
        }
        if let Some([x, y, z]) = by.axis_signs() {
            // Conjugation by the flip: both ends of every principal axis are the same to a Gaussian.
            let signs = [y * z, x * z, x * y];
            self.quat.par_iter_mut().for_each(|q| {
                for (v, sign) in q[1..].iter_mut().zip(signs) {
                    *v *= sign;
                }
            });
        } else {
            // A mirrored ellipsoid is the one turned by the negative matrix, which is a rotation.
            let sign = if determinant(&by.rotation) < 0.0 { -1.0 } else { 1.0 };
            let turn = matrix_to_quat(&by.rotation.map(|row| row.map(|v| v * sign)));
            self.quat.par_iter_mut().for_each(|q| *q = quat_product(turn, *q));
        }
        let width = self.sh_rest_len() * 3;
        if width > 0 {
            let rotate = ShRotation::new(&by.rotation);
            self.sh_rest.par_chunks_exact_mut(width).for_each(|rest| rotate.apply(rest));
        }
    }

    fn transform_positions(&mut self, by: &Similarity) {
        if !self.has_origin() {
            self.map_positions(NO_ORIGIN, |p| by.apply(p.map(f64::from)));
            return;
        }
        let origin = by.apply(self.origin);
        let is_near = origin_of(self.sample_positions().map(|p| by.apply(p))) == NO_ORIGIN;
        let translation = if is_near { origin } else { NO_ORIGIN };
        let about = Similarity { translation, ..*by };
        self.map_positions(NO_ORIGIN, |p| about.apply(p.map(f64::from)));
        self.origin = if is_near { NO_ORIGIN } else { origin };
    }

    /// Moves the scene from one frame to another.
    pub fn change_frame(&mut self, from: Frame, to: Frame) {
        if from != to {
            self.transform(&Similarity::between(from, to));
        }
    }
}

/// The unit quaternion `w, x, y, z` of a rotation matrix.
pub fn matrix_to_quat(m: &Matrix3) -> [f64; 4] {
    let trace = [
        m[0][0] + m[1][1] + m[2][2],
        m[0][0] - m[1][1] - m[2][2],
        m[1][1] - m[0][0] - m[2][2],
        m[2][2] - m[0][0] - m[1][1],
    ];
    // The largest of the four is at least 1/2, so nothing is divided by a small number.
    let largest = (0..4).fold(0, |best, i| if trace[i] > trace[best] { i } else { best });
    let root = (1.0 + trace[largest]).sqrt() / 2.0;
    let f = 0.25 / root;
    let (a, b, c) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (d, e, g) = (m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]);
    match largest {
        0 => [root, a * f, b * f, c * f],
        1 => [a * f, root, d * f, e * f],
        2 => [b * f, d * f, root, g * f],
        _ => [c * f, e * f, g * f, root],
    }
}

/// The product `a · b` of quaternions `w, x, y, z`, normalized, with `w ≥ 0`.
pub fn quat_product(a: [f64; 4], b: [f32; 4]) -> [f32; 4] {
    let b = b.map(f64::from);
    let q = [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ];
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let norm = if q[0] < 0.0 { -norm } else { norm };
    q.map(|v| (v / norm) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::product;
    use crate::vector::rotation;

    fn covariance(scene: &GaussianScene) -> Matrix3 {
        let r = rotation(scene.quat[0].map(f64::from));
        let s = scene.log_scale[0].map(|s| f64::from(s).exp());
        let rs = r.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]);
        let t = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rs[j][i]));
        product(&rs, &t)
    }

    fn scene() -> GaussianScene {
        let q = [0.4f32, -0.2, 0.8, 0.4];
        let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        GaussianScene {
            coord: vec![[1.0, -2.0, 3.5]],
            log_scale: vec![[-1.0, -2.0, 0.3]],
            quat: vec![q.map(|v| v / norm)],
            opacity_logit: vec![0.5],
            sh_dc: vec![[0.1, 0.2, 0.3]],
            sh_rest: (0..45).map(|i| (i as f32).sin()).collect(),
            sh_degree: 3,
            normal: Some(vec![[0.0, 0.6, 0.8]]),
            ..GaussianScene::default()
        }
    }

    #[test]
    fn the_covariance_follows_the_frame() {
        for to in ["RUB", "LUF", "FRU", "BLD", "LDF", "URF"] {
            let to: Frame = to.parse().unwrap();
            let m = Frame::CANONICAL.matrix_to(to);
            let before = scene();
            let mut after = before.clone();
            after.change_frame(Frame::CANONICAL, to);
            let transposed = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
            let due = product(&product(&m, &covariance(&before)), &transposed);
            let got = covariance(&after);
            for i in 0..3 {
                for j in 0..3 {
                    assert!((due[i][j] - got[i][j]).abs() < 1e-6, "{to}: {due:?} {got:?}");
                }
            }
            after.change_frame(to, Frame::CANONICAL);
            assert_eq!(after.coord, before.coord);
            assert_eq!(after.normal, before.normal);
            let close = |a: &f32, b: &f32| (a - b).abs() < 1e-6;
            assert!(after.sh_rest.iter().zip(&before.sh_rest).all(|(a, b)| close(a, b)));
        }
    }

    #[test]
    fn axis_flips_lose_nothing() {
        let before = scene();
        let mut scene = before.clone();
        scene.change_frame(Frame::CANONICAL, Frame::RUB);
        assert_ne!(scene, before);
        scene.change_frame(Frame::RUB, Frame::CANONICAL);
        assert_eq!(scene, before);
    }

    #[test]
    fn scale_and_translation() {
        let mut scene = scene();
        let rotation = Frame::CANONICAL.matrix_to("FRU".parse().unwrap());
        scene.transform(&Similarity { rotation, scale: 0.001, translation: [1.0, 0.0, 0.0] });
        let close = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-6;
        let p = scene.coord[0];
        assert!(close(p[0], 1.0035) && close(p[1], 0.001) && close(p[2], 0.002), "{p:?}");
        assert!(close(scene.log_scale[0][0], -1.0 - 1000f64.ln()));
    }
}

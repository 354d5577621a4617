//! Where a picture was taken from, and with which lens.

use crate::frame::{Matrix3, apply, determinant, matrix, product, transposed};
use crate::{SceneError, Similarity};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::path::Path;

/// How far `RᵀR` may be from the identity in a file: poses are written with few digits.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Rotations closer than this are left as they are, so that reading what was written changes no bit.
const ROTATION_EXACT: f64 = 4e-15;

/// The farthest that a camera, or its principal point in pixels, is from 0: squares of larger numbers do not fit f32.
pub const FARTHEST: f64 = 1e12;
/// Focal lengths along a side of a picture, in that side: far beyond any lens, and within f32 when squared.
const FOCAL: RangeInclusive<f64> = 1e-4..=1e6;

/// A camera with its pose.
///
/// # Conventions (stated here once)
/// - camera axes are x right, y down, z forward; a point of the world is at
///   `rotation · p + translation` in them, in the units of the scene;
/// - a pixel is a square: the picture spans 0 to `width` and 0 to `height`, the *center* of the first
///   pixel is at (0.5, 0.5), and `cx`, `cy` are in these coordinates;
/// - the world is the one of the file: nothing is turned, centered or scaled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Of its picture, as the file says it; may have folders, may be empty.
    pub name: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, pixels from the left edge.
    pub cx: f64,
    /// Principal point, pixels from the upper edge.
    pub cy: f64,
    /// What the lens does before `fx`, `fy`, `cx`, `cy` apply.
    pub distortion: Distortion,
    /// World to camera, row by row; orthonormal, determinant 1.
    pub rotation: Matrix3,
    /// World to camera.
    pub translation: [f64; 3],
}

/// A lens: where the direction `(x/z, y/z)` ends up in the plane at distance 1.
///
/// With `r² = x² + y²`, tangential terms are `2 p₁xy + p₂(r² + 2x²)` and `p₁(r² + 2y²) + 2 p₂xy`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// A pinhole.
    #[default]
    None,
    /// Radial `(1 + k₁r² + k₂r⁴ + k₃r⁶) / (1 + k₄r² + k₅r⁴ + k₆r⁶)`, and tangential.
    OpenCv {
        /// `k₁` to `k₆`.
        k: [f64; 6],
        /// `p₁`, `p₂`.
        p: [f64; 2],
    },
    /// Radial `1 + k₁r² + k₂r⁴ + k₃r⁶ + k₄r⁸`, and tangential.
    Polynomial {
        /// `k₁` to `k₄`.
        k: [f64; 4],
        /// `p₁`, `p₂`.
        p: [f64; 2],
    },
    /// Equidistant: radius `θ (1 + k₁θ² + k₂θ⁴ + k₃θ⁶ + k₄θ⁸)`, θ the angle to the axis in radians.
    Fisheye {
        /// `k₁` to `k₄`.
        k: [f64; 4],
    },
}

impl Distortion {
    /// Radial coefficients `k₁` to `k₆` and tangential ones; [`None`](Self::None) if all are 0.
    pub(crate) fn open_cv(k: [f64; 6], p: [f64; 2]) -> Self {
        let none = k.iter().chain(&p).all(|&v| v == 0.0);
        if none { Self::None } else { Self::OpenCv { k, p } }
    }

    /// The distorted direction; `None` where the model folds back, so that nothing is seen there.
    pub fn apply(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let rr = x * x + y * y;
        // Factor of the radius, and slope of the distorted radius over the radius.
        let (factor, slope, p) = match self {
            Self::None => return Some([x, y]),
            Self::OpenCv { k, p } => {
                let (above, da) = polynomial(&k[..3], rr);
                let (below, db) = polynomial(&k[3..], rr);
                let factor = above / below;
                (factor, factor + 2.0 * rr * (da - factor * db) / below, *p)
            }
            Self::Polynomial { k, p } => {
                let (factor, d) = polynomial(k, rr);
                (factor, factor + 2.0 * rr * d, *p)
            }
            Self::Fisheye { k } => {
                let r = rr.sqrt();
                let theta = r.atan();
                let (factor, d) = polynomial(k, theta * theta);
                let slope = factor + 2.0 * theta * theta * d;
                let ratio = if r > 0.0 { theta / r } else { 1.0 };
                (ratio * factor, slope, [0.0; 2])
            }
        };
        let out = [
            x * factor + 2.0 * p[0] * x * y + p[1] * (rr + 2.0 * x * x),
            y * factor + p[0] * (rr + 2.0 * y * y) + 2.0 * p[1] * x * y,
        ];
        (factor > 0.0 && slope > 0.0 && out.iter().all(|v| v.is_finite())).then_some(out)
    }

    fn numbers(&self) -> Vec<f64> {
        match self {
            Self::None => Vec::new(),
            Self::OpenCv { k, p } => [&k[..], p].concat(),
            Self::Polynomial { k, p } => [&k[..], p].concat(),
            Self::Fisheye { k } => k.to_vec(),
        }
    }
}

/// `1 + k₁t + k₂t² + …` and its derivative.
fn polynomial(k: &[f64], t: f64) -> (f64, f64) {
    let (mut value, mut slope) = (0.0, 0.0);
    for &k in k.iter().rev() {
        slope = slope * t + value;
        value = value * t + k;
    }
    (1.0 + t * value, value + t * slope)
}

impl Camera {
    /// Where the camera is in the world: `−Rᵀ t`.
    pub fn centre(&self) -> [f64; 3] {
        apply(&transposed(&self.rotation), self.translation).map(|v| -v)
    }

    /// The point in the camera's axes.
    pub fn to_camera(&self, point: [f64; 3]) -> [f64; 3] {
        let turned = DVec3::from(apply(&self.rotation, point));
        (turned + DVec3::from(self.translation)).to_array()
    }

    /// The pixel coordinates of a point of the world, inside the picture or not; `None` behind the
    /// camera and where the model of the lens folds back.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = self.to_camera(point);
        if z.is_nan() || z <= 0.0 {
            return None;
        }
        let [x, y] = self.distortion.apply([x / z, y / z])?;
        let pixel = [self.fx * x + self.cx, self.fy * y + self.cy];
        pixel.iter().all(|v| v.is_finite()).then_some(pixel)
    }

    /// Whether pixel coordinates are inside the picture.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        x >= 0.0 && y >= 0.0 && x < f64::from(self.width) && y < f64::from(self.height)
    }

    /// The same camera with a picture of another size, in pixels.
    pub fn resized(&self, [width, height]: [u32; 2]) -> Self {
        let x = f64::from(width) / f64::from(self.width);
        let y = f64::from(height) / f64::from(self.height);
        Self {
            width,
            height,
            fx: self.fx * x,
            fy: self.fy * y,
            cx: self.cx * x,
            cy: self.cy * y,
            ..self.clone()
        }
    }

    /// The matrix that takes points in the camera's axes to the world, row by row.
    pub fn camera_to_world(&self) -> [[f64; 4]; 4] {
        let (r, c) = (&self.rotation, self.centre());
        let row = |i: usize| [r[0][i], r[1][i], r[2][i], c[i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    /// A camera's rotation and translation from the axes and the position it has in the world.
    ///
    /// The columns of `axes` are the camera's x, y and z.
    pub(crate) fn pose_from_world(axes: &Matrix3, centre: [f64; 3]) -> (Matrix3, [f64; 3]) {
        let rotation = transposed(axes);
        (rotation, apply(&rotation, centre).map(|v| -v))
    }

    /// The camera that sees the transformed scene as this one sees the scene; depths grow with the
    /// scale. `None` if the scene is mirrored: no camera sees it the same.
    pub fn transformed(&self, by: &Similarity) -> Option<Self> {
        if determinant(&by.rotation) < 0.0 {
            return None;
        }
        let rotation = product(&self.rotation, &transposed(&by.rotation));
        let moved = DVec3::from(apply(&rotation, by.translation));
        let translation = (DVec3::from(self.translation) * by.scale - moved).to_array();
        Some(Self { rotation, translation, ..self.clone() })
    }

    /// The same camera in a world from whose positions `origin` is subtracted: that of the
    /// coordinates of a scene with this [`origin`](crate::GaussianScene::origin), for cameras of the
    /// same capture. Computed in f64.
    pub fn relative_to(&self, origin: [f64; 3]) -> Self {
        if origin == [0.0; 3] {
            return self.clone();
        }
        Self { translation: self.to_camera(origin), ..self.clone() }
    }

    /// Checks that everything is finite, that sizes are above 0, that focal lengths are 1e-4 to 1e6 sides of the
    /// picture, that nothing is farther than [`FARTHEST`] from 0, and that the rotation is one, within 1e-3; and makes
    /// it orthonormal to the last digits.
    ///
    /// # Errors
    /// Names the camera and what is wrong with it; `path` is for the message.
    pub fn check(&mut self, path: &Path) -> Result<(), SceneError> {
        let bad = |problem: String| {
            let problem = format!("camera {:?} {problem}", self.name);
            SceneError::format(path, problem, "export the cameras again")
        };
        if self.width == 0 || self.height == 0 {
            return Err(bad(format!("has a picture of {} × {} pixels", self.width, self.height)));
        }
        let numbers = [self.fx, self.fy, self.cx, self.cy];
        // False for NaN too.
        let near = |v: &f64| v.abs() <= FARTHEST;
        let sides = [self.fx / f64::from(self.width), self.fy / f64::from(self.height)];
        let focal = sides.iter().all(|f| FOCAL.contains(f));
        if !focal || ![self.cx, self.cy].iter().all(near) {
            let limits = format!("focal lengths are {} to {} sides", FOCAL.start(), FOCAL.end());
            return Err(bad(format!("has fx, fy, cx, cy = {numbers:?} ({limits})")));
        }
        let distortion = self.distortion.numbers();
        if !distortion.iter().all(|v| v.is_finite()) {
            return Err(bad(format!("has the distortion {distortion:?}")));
        }
        if !self.translation.iter().all(near) {
            let problem = format!("has the translation {:?}", self.translation);
            return Err(bad(format!("{problem} (at most {FARTHEST:e} from 0)")));
        }
        let off = off_orthonormal(&self.rotation);
        if off.is_nan() || off > ROTATION_TOLERANCE || determinant(&self.rotation) < 0.0 {
            return Err(bad(format!("has a matrix that is no rotation: {:?}", self.rotation)));
        }
        if off > ROTATION_EXACT {
            self.rotation = nearest_rotation(&self.rotation);
        }
        Ok(())
    }
}

/// The largest entry of `MᵀM − 1`; NaN if any is.
fn off_orthonormal(m: &Matrix3) -> f64 {
    let square = matrix(&product(&transposed(m), m)) - DMat3::IDENTITY;
    let entries = square.to_cols_array().into_iter();
    if square.is_nan() { f64::NAN } else { entries.fold(0.0, |worst, v| worst.max(v.abs())) }
}

/// The nearest rotation to a matrix that almost is one.
fn nearest_rotation(m: &Matrix3) -> Matrix3 {
    let mut m = *m;
    // Newton's iteration for the polar factor: the error is squared each time.
    for _ in 0..5 {
        let det = determinant(&m);
        let cofactor = |i: usize, j: usize| {
            let (a, b) = ((i + 1) % 3, (i + 2) % 3);
            let (c, d) = ((j + 1) % 3, (j + 2) % 3);
            m[a][c] * m[b][d] - m[a][d] * m[b][c]
        };
        m = std::array::from_fn(|i| {
            std::array::from_fn(|j| (m[i][j] + cofactor(i, j) / det) / 2.0)
        });
    }
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            name: "a.jpg".to_owned(),
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 600.0,
            cx: 320.0,
            cy: 240.0,
            distortion: Distortion::None,
            // Looks along +x of the world, with −z up.
            rotation: [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
            translation: [0.0, 1.0, 2.0],
        }
    }

    #[test]
    fn a_point_by_hand() {
        let camera = camera();
        // R p + t = (−2 + 0, −3 + 1, 4 + 2).
        assert_eq!(
            camera.project([4.0, 2.0, 3.0]),
            Some([320.0 - 1000.0 / 6.0, 240.0 - 1200.0 / 6.0])
        );
        assert_eq!(camera.project([-2.0, 2.0, 3.0]), None);
        assert_eq!(camera.project([f64::NAN, 2.0, 3.0]), None);
        assert_eq!(camera.centre(), [-2.0, 0.0, 1.0]);
        assert_eq!(camera.camera_to_world()[0], [0.0, 0.0, 1.0, -2.0]);
    }

    #[test]
    fn distortions_by_hand() {
        let open_cv = Distortion::open_cv([0.1, 0.01, 0.001, 0.2, 0.0, 0.0], [0.01, 0.02]);
        // x = 1, y = 0: r² = 1, factor 1.111 / 1.2, tangential 0.02 · 3 and 0.01 · 1.
        let [x, y] = open_cv.apply([1.0, 0.0]).unwrap();
        assert!((x - (1.111 / 1.2 + 0.06)).abs() < 1e-15 && (y - 0.01).abs() < 1e-15);
        let fisheye = Distortion::Fisheye { k: [0.0, 0.0, 0.0, 0.0] };
        let [x, _] = fisheye.apply([1.0, 0.0]).unwrap();
        assert!((x - std::f64::consts::FRAC_PI_4).abs() < 1e-15);
        assert_eq!(fisheye.apply([0.0, 0.0]), Some([0.0, 0.0]));
        assert_eq!(Distortion::open_cv([0.0; 6], [0.0; 2]), Distortion::None);
        // 1 − r²: the radius is largest at r² = 1/3, beyond it points would come back.
        let folds = Distortion::Polynomial { k: [-1.0, 0.0, 0.0, 0.0], p: [0.0; 2] };
        assert!(folds.apply([0.57, 0.0]).is_some());
        assert_eq!(folds.apply([0.58, 0.0]), None);
    }

    #[test]
    fn a_moved_scene_is_seen_the_same() {
        let by = Similarity {
            rotation: [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            scale: 2.0,
            translation: [1.0, -2.0, 3.0],
        };
        let camera = camera();
        let moved = camera.transformed(&by).unwrap();
        // (4, 2, 3) goes to 2 · (3, 4, 2) + (1, −2, 3).
        assert_eq!(camera.project([4.0, 2.0, 3.0]), moved.project([7.0, 6.0, 7.0]));
        let mirror = Similarity { rotation: [[-1., 0., 0.], [0., 1., 0.], [0., 0., 1.]], ..by };
        assert_eq!(camera.transformed(&mirror), None);
    }

    #[test]
    fn bad_cameras_are_refused_and_near_rotations_made_exact() {
        let path = Path::new("c.json");
        let spoil: [fn(&mut Camera); 9] = [
            |c| c.fy = f64::NAN,
            |c| c.fx = 1e-30,
            |c| c.fy = 1e38,
            |c| c.cx = 1e38,
            |c| c.translation[1] = 1e38,
            |c| c.translation[2] = f64::NEG_INFINITY,
            |c| c.rotation[1][2] = f64::NAN,
            |c| c.rotation[2][0] = 1.01,
            |c| c.rotation[2][0] = -1.0,
        ];
        for spoil in spoil {
            let mut camera = camera();
            spoil(&mut camera);
            let error = camera.check(path).unwrap_err().to_string();
            assert!(error.contains("a.jpg"), "{error}");
        }
        let mut camera = camera();
        camera.check(path).unwrap();
        assert_eq!(camera, self::camera(), "an exact rotation stays as it is");
        camera.rotation[0] = [4e-4, -1.0003, 2e-4];
        camera.check(path).unwrap();
        assert!(off_orthonormal(&camera.rotation) < 1e-15);
        assert!((camera.rotation[0][1] + 1.0).abs() < 1e-7);
    }
}

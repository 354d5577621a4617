//! A pinhole camera in the numbers the loops use.

use crate::RasterError;
use scenesplat_scene::{Camera, Distortion, LookAt, Up};

/// How far `RRᵀ` may be from the identity.
const ROTATION_TOLERANCE: f32 = 1e-4;
/// Longest side: tile and pixel numbers of a row fit 16 bits.
pub const MAX_SIDE: u32 = 65_535;
/// Most pixels of a picture; 1 GiB per channel.
pub const MAX_PIXELS: u64 = 1 << 28;

/// A pinhole camera with its pose and picture size.
///
/// Conventions are those of [`Camera`]: x right, y down, z forward; the center of the first pixel
/// is (0.5, 0.5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// World to camera, row by row: `[R | t]`, `R` orthonormal with determinant 1.
    pub world_to_camera: [[f32; 4]; 3],
    /// Focal length along x, pixels, above 0.
    pub fx: f32,
    /// Focal length along y, pixels, above 0.
    pub fy: f32,
    /// Principal point, pixels from the left edge.
    pub cx: f32,
    /// Principal point, pixels from the upper edge.
    pub cy: f32,
    /// Pixels, 1 to 65,535.
    pub width: u32,
    /// Pixels, 1 to 65,535.
    pub height: u32,
}

impl View {
    /// The view of a camera.
    ///
    /// # Errors
    /// Lens distortion, refused by name; and what [`check`](Self::check) refuses.
    pub fn from_camera(camera: &Camera) -> Result<Self, RasterError> {
        let model = match camera.distortion {
            Distortion::None => None,
            Distortion::OpenCv { .. } => Some("OpenCV"),
            Distortion::Polynomial { .. } => Some("polynomial"),
            Distortion::Fisheye { .. } => Some("fisheye"),
        };
        if let Some(model) = model {
            return Err(RasterError::Distortion { camera: camera.name.clone(), model });
        }
        let (r, t) = (&camera.rotation, &camera.translation);
        let row = |i: usize| [r[i][0] as f32, r[i][1] as f32, r[i][2] as f32, t[i] as f32];
        let view = Self {
            world_to_camera: [row(0), row(1), row(2)],
            fx: camera.fx as f32,
            fy: camera.fy as f32,
            cx: camera.cx as f32,
            cy: camera.cy as f32,
            width: camera.width,
            height: camera.height,
        };
        view.check()?;
        Ok(view)
    }

    /// The view of a camera that stands somewhere and looks somewhere; `size`: width and height, pixels.
    ///
    /// # Errors
    /// If the target is where the eye is or the angle of view is none; and what [`check`](Self::check) refuses.
    pub fn look_at(look: &LookAt, up: Up, size: [u32; 2]) -> Result<Self, RasterError> {
        let LookAt { eye, target, fov } = *look;
        let (width, height) = (size[0], size[1]);
        if width == 0 || height == 0 {
            return Err(RasterError::Picture { width, height });
        }
        let camera = look.camera("view", up, size);
        Self::from_camera(&camera.ok_or(RasterError::LookAt { eye, target, fov })?)
    }

    /// Checks size, intrinsics and pose.
    ///
    /// # Errors
    /// Names what is out of its range.
    pub fn check(&self) -> Result<(), RasterError> {
        let (width, height) = (self.width, self.height);
        let sides = width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE;
        if sides || u64::from(width) * u64::from(height) > MAX_PIXELS {
            return Err(RasterError::Picture { width, height });
        }
        let number = |field, value: f32, positive: bool| {
            let range = if positive { "finite and above 0" } else { "finite" };
            let good = value.is_finite() && (!positive || value > 0.0);
            if good {
                Ok(())
            } else {
                Err(RasterError::Number { field, value: value.into(), range })
            }
        };
        number("fx", self.fx, true)?;
        number("fy", self.fy, true)?;
        number("cx", self.cx, false)?;
        number("cy", self.cy, false)?;
        for row in &self.world_to_camera {
            number("world_to_camera translation", row[3], false)?;
        }
        let off = self.off_rotation();
        if off <= ROTATION_TOLERANCE { Ok(()) } else { Err(RasterError::Pose { off }) }
    }

    /// Largest entry of `RRᵀ − 1`, 2 if mirrored, NaN if any entry is.
    fn off_rotation(&self) -> f32 {
        let m = &self.world_to_camera;
        let dot = |i: usize, j: usize| (0..3).map(|k| m[i][k] * m[j][k]).sum::<f32>();
        let mut off = 0.0f32;
        for i in 0..3 {
            for j in 0..3 {
                let entry = (dot(i, j) - if i == j { 1.0 } else { 0.0 }).abs();
                if entry.is_nan() {
                    return entry;
                }
                off = off.max(entry);
            }
        }
        let cross = |a: usize, b: usize| m[0][a] * m[1][b] - m[0][b] * m[1][a];
        let det = cross(1, 2) * m[2][0] + cross(2, 0) * m[2][1] + cross(0, 1) * m[2][2];
        if det < 0.0 { 2.0 } else { off }
    }

    /// Where the camera is in the world: `−Rᵀt`.
    pub fn centre(&self) -> [f32; 3] {
        let m = &self.world_to_camera;
        let along = |k: usize| (0..3).map(|i| f64::from(m[i][k]) * f64::from(m[i][3])).sum::<f64>();
        [0, 1, 2].map(|k| -along(k) as f32)
    }

    /// The point in the camera's axes; summed in f64, since near the camera most digits cancel.
    #[inline(always)]
    pub fn to_camera(&self, p: [f32; 3]) -> [f32; 3] {
        let p = p.map(f64::from);
        self.world_to_camera.map(|r| {
            let r = r.map(f64::from);
            (r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]) as f32
        })
    }

    /// Pixels of the picture.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Tiles across and down.
    pub fn tiles(&self) -> (usize, usize) {
        ((self.width as usize).div_ceil(crate::TILE), (self.height as usize).div_ceil(crate::TILE))
    }
}

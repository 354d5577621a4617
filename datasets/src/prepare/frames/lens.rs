//! Pinhole lenses as benchmarks write them, and camera-to-world matrices.

use scenesplat_scene::{Camera, Distortion};

/// Camera to world, row by row; camera axes right, down, forward.
pub(super) type Pose = [[f64; 4]; 4];

/// A pinhole. Pixels are counted from the corner of the first one, as in [`Camera`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lens {
    pub(super) focal: [f64; 2],
    pub(super) centre: [f64; 2],
    /// Width and height of its pictures, where the file says so.
    pub(super) size: Option<[u32; 2]>,
    /// The second coordinate of the principal point counts from the lower edge.
    pub(super) from_below: bool,
}

impl Lens {
    /// Of numbers that count from the corner of the first pixel.
    pub(super) fn of_corner([fx, fy, cx, cy]: [f64; 4], size: Option<[u32; 2]>) -> Self {
        Self { focal: [fx, fy], centre: [cx, cy], size, from_below: false }
    }

    /// Of numbers that count from the center of the first pixel.
    pub(super) fn of_centre([fx, fy, cx, cy]: [f64; 4], size: Option<[u32; 2]>) -> Self {
        Self::of_corner([fx, fy, cx + 0.5, cy + 0.5], size)
    }

    /// Of a matrix of 3 × 3 or 4 × 4 values that counts from the center of the first pixel; `None` if it is none.
    pub(super) fn of_matrix(values: &[f64], size: Option<[u32; 2]>) -> Option<Self> {
        let width = match values.len() {
            9 => 3,
            16 => 4,
            _ => return None,
        };
        let at = |row: usize, column: usize| values[row * width + column];
        Some(Self::of_centre([at(0, 0), at(1, 1), at(0, 2), at(1, 2)], size))
    }

    /// For pictures of a size, principal point from the upper edge.
    pub(super) fn upright(mut self, size: [u32; 2]) -> Self {
        if std::mem::take(&mut self.from_below) {
            self.centre[1] = f64::from(size[1]) - self.centre[1];
        }
        Self { size: Some(size), ..self }
    }

    /// The same lens for pictures of another size.
    pub(super) fn resized(self, from: [u32; 2], to: [u32; 2]) -> Self {
        let scale = [0, 1].map(|k| f64::from(to[k]) / f64::from(from[k]));
        let scaled = |v: [f64; 2]| [v[0] * scale[0], v[1] * scale[1]];
        let (focal, centre) = (scaled(self.focal), scaled(self.centre));
        Self { focal, centre, size: Some(to), ..self }
    }

    /// Where a place in a picture of this lens is in one of another, which stands at the same place.
    pub(super) fn place_in(&self, other: &Self, place: [f64; 2]) -> [f64; 2] {
        [0, 1]
            .map(|k| (place[k] - self.centre[k]) / self.focal[k] * other.focal[k] + other.centre[k])
    }

    /// The camera of a picture of this size.
    pub(super) fn camera(self, name: String, size: [u32; 2], pose: &Pose) -> Camera {
        let Self { focal: [fx, fy], centre: [cx, cy], .. } = self.upright(size);
        let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| pose[j][i]));
        let translation = rotation.map(|row| -(0..3).map(|k| row[k] * pose[k][3]).sum::<f64>());
        let [width, height] = size;
        let distortion = Distortion::None;
        Camera { name, width, height, fx, fy, cx, cy, distortion, rotation, translation }
    }
}

/// A camera at 0 that looks along +z.
pub(super) const IDENTITY: Pose =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

/// The pose of 16 numbers, row by row.
pub(super) fn pose_of(values: &[f64]) -> Option<Pose> {
    let rows: &[[f64; 4]; 4] = values.as_chunks::<4>().0.try_into().ok()?;
    (values.len() == 16).then_some(*rows)
}

/// The pose of a camera with axes right, up, back (OpenGL), in ours.
pub(super) fn of_opengl(pose: Pose) -> Pose {
    pose.map(|row| [row[0], -row[1], -row[2], row[3]])
}

/// The inverse of a rigid motion.
pub(super) fn inverse(pose: &Pose) -> Pose {
    let mut out = IDENTITY;
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = pose[j][i];
        }
        out[i][3] = -(0..3).map(|k| pose[k][i] * pose[k][3]).sum::<f64>();
    }
    out
}

/// One motion after another: `a · b`.
pub(super) fn product(a: &Pose, b: &Pose) -> Pose {
    [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

/// Whether all of it is finite.
pub(super) fn is_finite(pose: &Pose) -> bool {
    pose.as_flattened().iter().all(|v| v.is_finite())
}

/// Pixels of a picture; neither side is above 2³², so the product fits.
pub(super) fn pixels(width: u32, height: u32) -> u64 {
    u64::from(width) * u64::from(height)
}

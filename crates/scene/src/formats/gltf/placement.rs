//! Moving Gaussians by any invertible matrix.

use super::nodes::Affine;
use crate::formats::unit_f64;
use crate::frame::{Matrix3, determinant, product, transposed};
use crate::similarity::matrix_to_quat;
use crate::singular_values::singular_values;
use crate::spherical_harmonics::ShRotation;
use crate::vector::rotation;
use crate::{GaussianScene, Similarity};
use rayon::prelude::*;

/// How far the factors along three directions may differ, relatively, to count as one.
///
/// Matrices are written with the seven digits of f32; a larger tolerance would deform scenes.
const ONE_SCALE: f64 = 1e-6;

/// How far from −1, 0 or 1 the entry of a rotation may be to be that: the rounding of f32.
const WHOLE: f64 = 1e-7;

/// Matrices that flatten more than this are treated as singular.
const SINGULAR: f64 = 1e-9;

/// What a matrix does to Gaussians.
pub(in crate::formats) enum Placement {
    /// They keep their shape.
    Similar(Similarity),
    /// They are stretched.
    Stretched {
        by: Affine,
        /// The orthogonal matrix nearest to `by.linear`; it turns the harmonics.
        rotation: Matrix3,
    },
}

impl Placement {
    /// `None` if the matrix has no inverse or is not finite.
    pub(in crate::formats) fn new(by: &Affine) -> Option<Self> {
        let entries = by.linear.iter().flatten().chain(&by.translation);
        if !entries.copied().all(f64::is_finite) {
            return None;
        }
        let (u, s, v) = singular_values(&by.linear);
        if s[2] <= s[0] * SINGULAR {
            return None;
        }
        let rotation = product(&u, &transposed(&v)).map(|row| {
            row.map(|entry| {
                let whole = entry.round();
                if (entry - whole).abs() < WHOLE { whole } else { entry }
            })
        });
        if s[0] - s[2] > s[0] * ONE_SCALE {
            return Some(Self::Stretched { by: *by, rotation });
        }
        let scale = (s[0] + s[1] + s[2]) / 3.0;
        let scale = if (scale - 1.0).abs() < WHOLE { 1.0 } else { scale };
        Some(Self::Similar(Similarity { rotation, scale, translation: by.translation }))
    }

    /// Where a point comes to lie.
    pub(in crate::formats) fn position(&self, p: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Similar(by) => by.apply(p),
            Self::Stretched { by, .. } => by.apply(p),
        }
    }

    /// What is added to every position in the end.
    pub(in crate::formats) fn translation(&mut self) -> &mut [f64; 3] {
        match self {
            Self::Similar(by) => &mut by.translation,
            Self::Stretched { by, .. } => &mut by.translation,
        }
    }

    /// Moves the Gaussians; their quaternions must have a length.
    pub(in crate::formats) fn apply(&self, scene: &mut GaussianScene) {
        let (by, rotation) = match self {
            Self::Similar(similarity) => return scene.transform(similarity),
            Self::Stretched { by, rotation } => (by, rotation),
        };
        let coord = scene.coord.par_iter_mut();
        coord.for_each(|p| *p = by.apply(p.map(f64::from)).map(|v| v as f32));
        let shapes = scene.log_scale.par_iter_mut().zip(&mut scene.quat);
        shapes.for_each(|(log_scale, quat)| {
            if let Some(stretched) = stretch(&by.linear, *log_scale, *quat) {
                (*log_scale, *quat) = stretched;
            }
        });
        let width = scene.sh_rest_len() * 3;
        if width > 0 {
            let rotate = ShRotation::new(rotation);
            scene.sh_rest.par_chunks_exact_mut(width).for_each(|rest| rotate.apply(rest));
        }
    }

    /// Whether quaternions are multiplied by another one, so that they need a length.
    pub(in crate::formats) fn turns(&self) -> bool {
        let Self::Similar(similarity) = self else { return true };
        (0..3).any(|i| (0..3).any(|j| i != j && similarity.rotation[i][j] != 0.0))
    }
}

/// Logarithms of the standard deviations and orientation after a linear map.
///
/// The covariance is `B·Bᵀ` with `B = linear · R · diag(σ)`, so its eigenvectors and the roots of
/// its eigenvalues are the left singular vectors and singular values of `B`. Not forming `B·Bᵀ`
/// keeps the thickness of flat Gaussians. `None` where a size is NaN or infinite; such rows are
/// left out later.
fn stretch(linear: &Matrix3, log_scale: [f32; 3], quat: [f32; 4]) -> Option<([f32; 3], [f32; 4])> {
    if log_scale.iter().any(|s| s.is_nan() || *s == f32::INFINITY) {
        return None;
    }
    // A common factor is taken out so that no size over- or underflows.
    let largest = log_scale.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if largest == f32::NEG_INFINITY {
        return None;
    }
    let sigma = log_scale.map(|s| (f64::from(s) - f64::from(largest)).exp());
    let axes = product(linear, &rotation(unit_f64(quat)));
    let b = axes.map(|row| [row[0] * sigma[0], row[1] * sigma[1], row[2] * sigma[2]]);
    let (mut u, s, _) = singular_values(&b);
    if determinant(&u) < 0.0 {
        // Both ends of an axis are the same to a Gaussian.
        u.iter_mut().for_each(|row| row[2] = -row[2]);
    }
    let quat = matrix_to_quat(&u);
    let sign = if quat[0] < 0.0 { -1.0 } else { 1.0 };
    let log_scale = s.map(|s| (s.ln() + f64::from(largest)) as f32);
    Some((log_scale, quat.map(|v| (v * sign) as f32)))
}

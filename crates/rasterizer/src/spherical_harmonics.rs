//! Colors of Gaussians as a camera sees them.

use crate::{Gaussians, Projected, View};
use rayon::prelude::*;

/// Gaussians per task.
const CHUNK: usize = 4096;

/// Color of each visible Gaussian: `max(0, ½ + Σ Bₖ(d) cₖ)`, `d` the unit vector from the camera to
/// the center. `[visible, 3]`
///
/// Bands above `degree` are left out, bands that the Gaussians lack are not there to add. A
/// Gaussian exactly at the camera's center has no direction and takes its DC color. Coefficients
/// that are not finite make a color that is not.
///
/// # Source
/// `spherical_harmonics` of gsplat 1.6.0 (90d7b4b).
pub fn colors(
    gaussians: &Gaussians,
    view: &View,
    projected: &Projected,
    degree: u8,
) -> Vec<[f32; 3]> {
    let mut out = Vec::new();
    colors_into(gaussians, view, projected, degree, &mut out);
    out
}

/// [`colors`] into memory that is used again.
pub(crate) fn colors_into(
    gaussians: &Gaussians,
    view: &View,
    projected: &Projected,
    degree: u8,
    out: &mut Vec<[f32; 3]>,
) {
    let degree = degree.min(gaussians.sh_degree);
    match degree {
        0 => at_degree::<1>(gaussians, view, projected, out),
        1 => at_degree::<4>(gaussians, view, projected, out),
        2 => at_degree::<9>(gaussians, view, projected, out),
        _ => at_degree::<16>(gaussians, view, projected, out),
    }
}

/// [`colors`] from the first `K` coefficients.
fn at_degree<const K: usize>(
    gaussians: &Gaussians,
    view: &View,
    projected: &Projected,
    out: &mut Vec<[f32; 3]>,
) {
    let centre = view.centre();
    let stride = 3 * gaussians.sh_len();
    let color = |&index: &u32| {
        let i = index as usize;
        let coefficients = &gaussians.sh[i * stride..i * stride + 3 * K];
        let m = gaussians.means[i];
        let basis = basis::<K>([m[0] - centre[0], m[1] - centre[1], m[2] - centre[2]]);
        let mut sum = [0.5f32; 3];
        for (b, c) in basis.iter().zip(coefficients.chunks_exact(3)) {
            for k in 0..3 {
                sum[k] += b * c[k];
            }
        }
        // Not `max`, which would turn NaN and −∞ into 0 and hide them.
        sum.map(|v| if v < 0.0 && v.is_finite() { 0.0 } else { v })
    };
    projected.index.par_iter().with_min_len(CHUNK).map(color).collect_into_vec(out);
}

/// The first `K` real spherical harmonics of a direction, any length; 0 beyond the first for a
/// vector without one.
#[inline(always)]
pub fn basis<const K: usize>(d: [f32; 3]) -> [f32; K] {
    let mut b = [0.0; K];
    b[0] = 0.282_094_79;
    if K == 1 {
        return b;
    }
    let norm = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    if !(norm > 0.0) {
        return b;
    }
    let [x, y, z] = d.map(|v| v / norm);
    b[1] = -0.488_602_52 * y;
    b[2] = 0.488_602_52 * z;
    b[3] = -0.488_602_52 * x;
    if K == 4 {
        return b;
    }
    let (zz, c1, s1) = (z * z, x * x - y * y, 2.0 * x * y);
    b[4] = 0.546_274_24 * s1;
    b[5] = -1.092_548_5 * z * y;
    b[6] = 0.946_174_7 * zz - 0.315_391_57;
    b[7] = -1.092_548_5 * z * x;
    b[8] = 0.546_274_24 * c1;
    if K == 9 {
        return b;
    }
    let (c2, s2) = (x * c1 - y * s1, x * s1 + y * c1);
    let k = 0.457_045_8 - 2.285_229 * zz;
    b[9] = -0.590_043_6 * s2;
    b[10] = 1.445_305_7 * z * s1;
    b[11] = k * y;
    b[12] = z * (1.865_881_7 * zz - 1.119_529);
    b[13] = k * x;
    b[14] = 1.445_305_7 * z * c1;
    b[15] = -0.590_043_6 * c2;
    b
}

//! The direction of a level surface to a hundredth of a degree: by where it lies, not by its normals.

use super::surface::{Piece, Surface};
use glam::{DMat3, DVec3};

/// Degrees within which a piece faces the direction.
const FACING: f64 = 8.0;

/// Thickness of the slab in which the plane is looked for, and of the plane, in units of the size.
const SLAB: f64 = 0.04;
const PLANE: f64 = 0.008;

/// The mean of the normals is off by at most twice their spread about it, within these degrees: a plane farther off
/// joins surfaces of different heights, or follows the crests of waves.
const OFF: [f64; 2] = [0.3, 3.0];

/// Degrees within which the spread of normals is measured.
const SPREAD: f64 = 4.0;

/// Fewest pieces of a plane, and its least extent in both directions (standard deviations), in units of
/// the size: a narrow one does not say how it is tilted.
const LEAST_PIECES: usize = 30;
const LEAST_SPREAD: f64 = 0.05;

/// Times that plane and slab are found anew.
const ROUNDS: usize = 6;

/// The plane that faces a direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// Unit, on the side of the direction.
    pub(super) normal: DVec3,
    /// Standard error of its tilt, degrees.
    pub(super) error: f64,
    height: f64,
}

/// The fullest plane that faces `up`; `None` without one, or if it is not where normals are about `up`.
pub(super) fn fullest_plane(surface: &Surface, up: DVec3) -> Option<Plane> {
    let least = FACING.to_radians().cos();
    let level: Vec<&Piece> = surface.flat().filter(|p| p.normal.dot(up).abs() >= least).collect();
    let height = fullest_slab(&level, up, SLAB * surface.size)?;
    let mut plane = Plane { normal: up, error: f64::INFINITY, height };
    for round in 0..ROUNDS {
        let share = (ROUNDS - 1 - round) as f64 / (ROUNDS - 1) as f64;
        let half = surface.size * (PLANE + (SLAB - PLANE) * share) / 2.0;
        let near = |p: &&&Piece| (p.place.dot(plane.normal) - plane.height).abs() <= half;
        let on: Vec<&Piece> = level.iter().filter(near).copied().collect();
        plane = fitted(&on, plane.normal, surface.size)?;
    }
    let most = (2.0 * spread(&level, up)).clamp(OFF[0], OFF[1]);
    (plane.normal.angle_between(up).to_degrees() <= most).then_some(plane)
}

/// Root mean square angle of the normals about a direction, degrees.
fn spread(level: &[&Piece], up: DVec3) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for piece in level {
        let angle = piece.normal.dot(up).abs().min(1.0).acos().to_degrees();
        if angle <= SPREAD {
            sum += piece.area * angle * angle;
            total += piece.area;
        }
    }
    if total > 0.0 { (sum / total).sqrt() } else { 0.0 }
}

/// The middle of the slab that holds most.
fn fullest_slab(level: &[&Piece], up: DVec3, slab: f64) -> Option<f64> {
    let mut heights: Vec<(f64, f64)> = level.iter().map(|p| (p.place.dot(up), p.area)).collect();
    heights.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut end, mut held, mut best) = (0, 0.0, (0.0, None));
    for start in 0..heights.len() {
        while end < heights.len() && heights[end].0 <= heights[start].0 + slab {
            held += heights[end].1;
            end += 1;
        }
        if held > best.0 {
            best = (held, Some((heights[start].0 + heights[end - 1].0) / 2.0));
        }
        held -= heights[start].1;
    }
    best.1
}

/// The plane through pieces, by least squares along `up`.
fn fitted(on: &[&Piece], up: DVec3, size: f64) -> Option<Plane> {
    if on.len() < LEAST_PIECES {
        return None;
    }
    let (u, v) = up.any_orthonormal_pair();
    let total: f64 = on.iter().map(|p| p.area).sum();
    let mean = on.iter().map(|p| p.place * p.area).sum::<DVec3>() / total;
    // Moments in the frame of u, v and up.
    let mut moments = DMat3::ZERO;
    for piece in on {
        let d = piece.place - mean;
        let d = DVec3::new(d.dot(u), d.dot(v), d.dot(up));
        moments += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (piece.area / total);
    }
    let (uu, uv, vv) = (moments.x_axis.x, moments.x_axis.y, moments.y_axis.y);
    let (uz, vz, zz) = (moments.x_axis.z, moments.y_axis.z, moments.z_axis.z);
    let determinant = uu * vv - uv * uv;
    // The smaller of the two variances across.
    let across = ((uu + vv) - ((uu - vv).powi(2) + 4.0 * uv * uv).sqrt()) / 2.0;
    if across.is_nan() || across < (LEAST_SPREAD * size).powi(2) || determinant <= 0.0 {
        return None;
    }
    let a = (uz * vv - vz * uv) / determinant;
    let b = (vz * uu - uz * uv) / determinant;
    let normal = (up - u * a - v * b).try_normalize()?;
    // As many pieces of one area would say as much.
    let count = total * total / on.iter().map(|p| p.area * p.area).sum::<f64>();
    let off = (zz - a * uz - b * vz).max(0.0);
    let error = (off / (across * count)).sqrt().to_degrees();
    Some(Plane { normal, error, height: mean.dot(normal) })
}

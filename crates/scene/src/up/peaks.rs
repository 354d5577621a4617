//! Directions that much of a scene's surface faces.

use super::surface::Surface;
use glam::DVec3;

/// Cells per side of each of the three faces of the half cube onto which normals are counted.
const CELLS: usize = 24;

/// Degrees about a direction within which surface faces it, in the first look.
const FACING: f64 = 8.0;

/// Degrees that two peaks are apart at least.
const APART: f64 = 20.0;

/// Most peaks, and the least share of the surface that one has.
const MOST: usize = 6;
const LEAST_SHARE: f64 = 0.03;

/// Degrees about the direction so far within which normals are averaged anew; the last is repeated.
const CONES: [f64; 3] = [10.0, 6.0, 4.0];
const ROUNDS: usize = 4;

/// Normals of one sign, summed in cells of about four degrees.
struct Cells(Vec<(DVec3, f64)>);

impl Cells {
    fn of(surface: &Surface) -> Self {
        let mut cells = vec![(DVec3::ZERO, 0.0); 3 * CELLS * CELLS];
        for piece in surface.flat() {
            let size = piece.normal.abs();
            let face = if size.x >= size.y && size.x >= size.z {
                0
            } else {
                1 + usize::from(size.z > size.y)
            };
            let n = piece.normal * piece.normal[face].signum();
            let at = |axis: usize| {
                let share = (n[axis] / n[face] + 1.0) / 2.0;
                ((share * CELLS as f64) as usize).min(CELLS - 1)
            };
            let cell = (face * CELLS + at((face + 1) % 3)) * CELLS + at((face + 2) % 3);
            cells[cell].0 += n * piece.area;
            cells[cell].1 += piece.area;
        }
        cells.retain(|c| c.1 > 0.0 && c.0.length() > 0.0);
        cells.iter_mut().for_each(|c| c.0 = c.0.normalize());
        Self(cells)
    }

    /// Surface about a direction.
    fn about(&self, direction: DVec3) -> f64 {
        let least = FACING.to_radians().cos();
        self.0.iter().filter(|c| c.0.dot(direction).abs() >= least).map(|c| c.1).sum()
    }
}

/// Directions that surface faces, from either side, the one with most surface first; unit, of either sign.
pub(super) fn peaks(surface: &Surface) -> Vec<DVec3> {
    let cells = Cells::of(surface);
    let total: f64 = cells.0.iter().map(|c| c.1).sum();
    let mut held: Vec<(DVec3, f64)> = cells.0.iter().map(|c| (c.0, cells.about(c.0))).collect();
    // Stable: of equals the first cell wins.
    held.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut found: Vec<DVec3> = Vec::new();
    let apart = APART.to_radians().cos();
    for (direction, surface_about) in held {
        if surface_about < LEAST_SHARE * total || found.len() == MOST {
            break;
        }
        if found.iter().any(|p| p.dot(direction).abs() > apart) {
            continue;
        }
        let normal = sharpened(surface, direction);
        if found.iter().all(|p| p.dot(normal).abs() <= apart) {
            found.push(normal);
        }
    }
    found
}

/// The mean of the normals about a direction, again and again in a narrower cone.
pub(super) fn sharpened(surface: &Surface, direction: DVec3) -> DVec3 {
    let last = CONES[CONES.len() - 1];
    let mut normal = direction;
    for cone in CONES.into_iter().chain([last; ROUNDS]) {
        let least = cone.to_radians().cos();
        let mut sum = DVec3::ZERO;
        for piece in surface.flat() {
            let along = piece.normal.dot(normal);
            if along.abs() >= least {
                sum += piece.normal * (along.signum() * piece.area);
            }
        }
        normal = sum.try_normalize().unwrap_or(normal);
    }
    normal
}

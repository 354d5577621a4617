//! How much a scene is built like a room: its surface is level, or parallel to walls at right angles.

use super::surface::Surface;
use super::walls::fullest_quarter;
use crate::GaussianScene;
use crate::frame::Matrix3;

/// Within so many degrees a surface is level, plumb, or parallel to a wall.
const WITHIN: f64 = 10.0;

/// Where so small a share of the rows has a normal, the share of surfaces that face anywhere says little:
/// this share, of which a third is square, is added.
const RARE: f64 = 0.03;

/// The share of a scene's surface that is level or parallel to one of two walls at right angles, 0..=1: most of
/// it in rooms, 0.06 where normals point anywhere. The walls are those that hold most surface.
///
/// `turn`: the rotation that brings +z up, and walls along the axes, if it is known: planes are looked for in cells
/// along the turned axes, so every pose of a scene has one figure.
///
/// By planes through neighbors: Gaussians of generated things often lie along the axes, whatever they show. Where
/// hardly any row lies on a plane the figure tends to a third. The same for any number of threads.
pub fn squareness(scene: &GaussianScene, turn: &Matrix3) -> f64 {
    let surface = Surface::of_planes(scene, turn);
    let (level_from, plumb_below) = (WITHIN.to_radians().cos(), WITHIN.to_radians().sin());
    let (mut all, mut level, mut plumb) = (0.0, 0.0, Vec::new());
    for piece in surface.flat() {
        all += piece.area;
        let height = piece.normal.z.abs();
        if height > level_from {
            level += piece.area;
        } else if height < plumb_below {
            let turn = piece.normal.y.atan2(piece.normal.x);
            plumb.push((turn, piece.area));
        }
    }
    let (_, walls) = fullest_quarter(plumb.into_iter());
    let square = if all > 0.0 { (level + walls) / all } else { 0.0 };
    let flat = surface.flat().count() as f64 / surface.pieces.len().max(1) as f64;
    (flat * square + RARE / 3.0) / (flat + RARE)
}

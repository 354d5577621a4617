//! How much a scene is built like a room: its surface is level, or parallel to walls at right angles.

use super::surface::Surface;
use crate::GaussianScene;
use crate::frame::Matrix3;
use glam::DVec3;

/// Within so many degrees a surface is level, plumb, or parallel to a wall.
const WITHIN: f64 = 10.0;

/// Bins of 3 degrees in which the quarter turn of plumb surfaces is counted, and how many of them are within
/// [`WITHIN`] of one direction.
const BINS: usize = 30;
const WINDOW: usize = 7;

/// Where so small a share of the rows has a normal, the share of surfaces that face anywhere says little:
/// this share, of which a third is square, is added.
const RARE: f64 = 0.03;

/// The share of a scene's surface that is level or parallel to one of two walls at right angles, 0..=1: most of
/// it in rooms, 0.06 where normals point anywhere. The walls are those that hold most surface.
///
/// `turn`: the rotation that brings +z up.
///
/// By planes through neighbors: Gaussians of generated things often lie along the axes, whatever they show. Where
/// hardly any row lies on a plane the figure tends to a third. The same for any number of threads.
pub fn squareness(scene: &GaussianScene, turn: &Matrix3) -> f64 {
    let surface = Surface::of_planes(scene);
    let [east, north, up] = turn.map(DVec3::from);
    let (level_from, plumb_below) = (WITHIN.to_radians().cos(), WITHIN.to_radians().sin());
    let (mut all, mut level, mut plumb) = (0.0, 0.0, [0.0; BINS]);
    for piece in surface.flat() {
        all += piece.area;
        let height = piece.normal.dot(up).abs();
        if height > level_from {
            level += piece.area;
        } else if height < plumb_below {
            let turn = piece.normal.dot(north).atan2(piece.normal.dot(east));
            let quarter =
                turn.rem_euclid(std::f64::consts::FRAC_PI_2) / std::f64::consts::FRAC_PI_2;
            plumb[((quarter * BINS as f64) as usize).min(BINS - 1)] += piece.area;
        }
    }
    let walls = (0..BINS)
        .map(|first| (first..first + WINDOW).map(|bin| plumb[bin % BINS]).sum::<f64>())
        .fold(0.0, f64::max);
    let square = if all > 0.0 { (level + walls) / all } else { 0.0 };
    let flat = surface.flat().count() as f64 / surface.pieces.len().max(1) as f64;
    (flat * square + RARE / 3.0) / (flat + RARE)
}

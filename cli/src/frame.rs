//! How a scene lies: which way is up, what a unit is.

use crate::flags::Inference;
use crate::session::Session;
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::Up;
use scenesplat::scene::frame::Matrix3;

/// How a scene lies, for the boxes of its objects.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    /// The direction that is up.
    pub up: Up,
    /// The rotation that brings +z up and the floor level.
    pub upright: Matrix3,
    /// The same, with walls along the axes if the network reads them so: cells lie along it.
    pub turn: Matrix3,
    /// What one unit of the scene is, meters.
    pub metres_per_unit: f64,
    /// Height of the floor along up, meters, if --floor says it.
    pub floor: Option<f64>,
}

/// Which way is up and what a unit is, as a network would read the scene.
pub fn frame(session: &Session<'_>, opened: &OpenedScene, inference: &Inference) -> Frame {
    let alignment = session.alignment(opened, inference);
    // A network that reads the scene as it is changes nothing about which way is up.
    let given = inference.up.filter(|_| inference.as_is);
    Frame {
        up: inference.up.unwrap_or(alignment.turned_from),
        upright: given.map_or_else(|| alignment.upright(), Up::upright),
        turn: given.map_or_else(|| alignment.rotation(), Up::upright),
        metres_per_unit: alignment.scale,
        // Relative to the origin of the scene, as its positions are.
        floor: inference.floor.map(|_| alignment.floors.heights[0]),
    }
}

//! How a scene lies: which way is up, what a unit is.

use crate::flags::Inference;
use scenesplat::alignment::{Alignment, AlignmentSettings};
use scenesplat::outputs::OpenedScene;
use scenesplat::scene::UpAxis;
use scenesplat::scene::frame::Matrix3;

/// How a scene lies, for the boxes of its objects.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    /// The axis that is next to up.
    pub up: UpAxis,
    /// The rotation that brings +z up and the floor level.
    pub upright: Matrix3,
    /// What one unit of the scene is, meters.
    pub metres_per_unit: f64,
    /// Height of the floor along up, meters, if --floor says it.
    pub floor: Option<f64>,
}

/// Which way is up and what a unit is, as a network would read the scene.
pub fn frame(opened: &OpenedScene, inference: &Inference) -> Frame {
    let scene = &opened.loaded.scene;
    let alignment = Alignment::of(
        scene,
        &AlignmentSettings {
            up: inference.up,
            metres_per_unit: inference.unit,
            floor: inference.floor,
            as_is: inference.as_is,
            ..AlignmentSettings::default()
        },
    );
    // A network that reads the scene as it is changes nothing about which way is up.
    let given = inference.up.filter(|_| inference.as_is);
    Frame {
        up: inference.up.unwrap_or(alignment.turned_from),
        upright: given.map_or_else(|| alignment.rotation(), UpAxis::upright),
        metres_per_unit: alignment.scale,
        floor: inference.floor.map(|floor| floor * alignment.scale),
    }
}

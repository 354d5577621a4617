//! What tests of several files make.

use crate::catalogue::Object;
use crate::{Catalogue, Floor, ObjectInput, UprightBox};
use scenesplat_scene::GaussianScene;
use std::ops::Range;

/// An object of a class, with these Gaussians.
pub(crate) fn object(label: usize, rows: Range<u32>) -> Object {
    let bounds = UprightBox { center: [0.0; 3], size: [1.0; 3], yaw: 0.0 };
    Object {
        id: 0,
        class: label.to_string(),
        label,
        score: None,
        count: rows.len(),
        bounds,
        position: [0.0; 3],
        corners: bounds.corners(),
        volume: 1.0,
        above_floor: 0.0,
        wall_distance: None,
        rows: rows.collect(),
    }
}

/// The objects of a scene of so many Gaussians.
pub(crate) fn catalogue(objects: Vec<Object>, gaussians: usize) -> Catalogue {
    Catalogue {
        objects,
        floor: Floor { height: 0.0, is_labelled: true, is_given: false },
        left_over: 0,
        small_instances: 0,
        nameless_instances: 0,
        gaussians,
        is_carried: false,
    }
}

/// An upright scene in meters.
pub(crate) fn input<'a>(
    scene: &'a GaussianScene,
    labels: &'a [i32],
    names: &'a [String],
) -> ObjectInput<'a> {
    ObjectInput {
        scene,
        labels,
        scores: None,
        instances: None,
        features: None,
        names,
        upright: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        metres_per_unit: 1.0,
        floor: None,
    }
}

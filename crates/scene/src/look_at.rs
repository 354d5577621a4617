//! Cameras that stand somewhere and look somewhere.

use crate::frame::{apply, transposed};
use crate::{Camera, Distortion, Up};
use glam::DVec3;

/// Where a camera stands, and what it looks at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LookAt {
    /// Its center, in the coordinates of the scene.
    pub eye: [f64; 3],
    /// A point in the middle of its picture.
    pub target: [f64; 3],
    /// Angle of view across the shorter side of the picture, degrees, above 0 and below 180.
    pub fov: f64,
}

impl LookAt {
    /// The camera; up in the scene is up in the picture. Straight up or down there is no such
    /// direction: then the first level axis points to the right.
    ///
    /// `None` if the target is where the eye is, or a number makes no sense.
    pub fn camera(&self, name: &str, up: Up, [width, height]: [u32; 2]) -> Option<Camera> {
        let turn_back = |axis: [f64; 3]| DVec3::from(apply(&transposed(&up.upright()), axis));
        let eye = DVec3::from(self.eye);
        let to = DVec3::from(self.target) - eye;
        let distance = to.length();
        let is_angle = self.fov > 0.0 && self.fov < 180.0;
        if !(distance.is_finite() && distance > 0.0 && is_angle && width > 0 && height > 0) {
            return None;
        }
        let forward = to / distance;
        let right = forward.cross(turn_back([0.0, 0.0, 1.0]));
        let length = right.length();
        let right = if length > 1e-6 { right / length } else { turn_back([1.0, 0.0, 0.0]) };
        let rotation = [right, forward.cross(right), forward];
        Some(Camera::pinhole(name.to_owned(), [width, height], self.fov, eye, rotation))
    }
}

impl Camera {
    /// A camera without distortion. `fov`: angle of view across the shorter side, degrees; `rotation`: directions of
    /// right, down and forward.
    pub fn pinhole(
        name: String,
        [width, height]: [u32; 2],
        fov: f64,
        eye: DVec3,
        rotation: [DVec3; 3],
    ) -> Self {
        let focal = f64::from(width.min(height)) / (2.0 * (fov / 2.0).to_radians().tan());
        Self {
            name,
            width,
            height,
            fx: focal,
            fy: focal,
            cx: f64::from(width) / 2.0,
            cy: f64::from(height) / 2.0,
            distortion: Distortion::None,
            rotation: rotation.map(Into::into),
            translation: rotation.map(|axis| -axis.dot(eye)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_is_in_the_middle_and_up_is_up() {
        let look = LookAt { eye: [1.0, 2.0, 3.0], target: [4.0, -1.0, 2.0], fov: 60.0 };
        for (up, axis, sign) in [
            (Up::PLUS_Z, 2, 1.0),
            (Up::MINUS_Y, 1, -1.0),
            (Up::PLUS_X, 0, 1.0),
            (Up::MINUS_Z, 2, -1.0),
        ] {
            let mut camera = look.camera("a", up, [200, 100]).unwrap();
            camera.check(std::path::Path::new("flags")).unwrap();
            let [x, y] = camera.project(look.target).unwrap();
            assert!((x - 100.0).abs() < 1e-9 && (y - 50.0).abs() < 1e-9, "{x} {y}");
            assert!((0..3).all(|a| (camera.centre()[a] - look.eye[a]).abs() < 1e-12));
            let mut above = look.target;
            above[axis] += 0.1 * sign;
            assert!(camera.project(above).unwrap()[1] < 50.0, "{up:?}");
            // Half of 60° across the shorter side: the edge is at tan 30°.
            assert!((camera.fy - 50.0 / 30f64.to_radians().tan()).abs() < 1e-9);
        }
    }

    #[test]
    fn straight_down_and_nowhere() {
        let down = LookAt { eye: [0.0, 0.0, 5.0], target: [0.0; 3], fov: 90.0 };
        let mut camera = down.camera("a", Up::PLUS_Z, [64, 64]).unwrap();
        camera.check(std::path::Path::new("flags")).unwrap();
        assert!(camera.project([1.0, 0.0, 0.0]).unwrap()[0] > 32.0);
        for (target, fov) in [([0.0, 0.0, 5.0], 90.0), ([f64::NAN; 3], 90.0), ([0.0; 3], 180.0)] {
            assert!(LookAt { target, fov, ..down }.camera("a", Up::PLUS_Z, [64, 64]).is_none());
        }
    }
}

//! How a camera moves while a picture is taken.

use crate::transforms::quaternion;
use scenesplat_scene::Camera;
use scenesplat_scene::frame::Matrix3;
use scenesplat_scene::vector::{cross, dot};

/// Most poses that one exposure is made of.
pub const MOST_POSES: usize = 16;

/// A rotation, then a translation: `R p + t`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigidMotion {
    /// `R`, row by row.
    pub rotation: Matrix3,
    /// `t`
    pub translation: [f64; 3],
}

/// The velocity of a motion with constant speed: turn `omega` (radians) and shift `v` in the time 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Twist {
    /// Axis times angle, radians.
    pub omega: [f64; 3],
    /// Velocity of the point at the origin, units of the scene.
    pub v: [f64; 3],
}

/// `(1 − cos θ) / θ²` and `(θ − sin θ) / θ³`, also for θ near 0.
fn coefficients(theta: f64) -> [f64; 2] {
    let square = theta * theta;
    if theta < 1e-2 {
        // The series: what is left out is below 1e-16.
        return [
            0.5 - square / 24.0 + square * square / 720.0,
            1.0 / 6.0 - square / 120.0 + square * square / 5040.0,
        ];
    }
    [(1.0 - theta.cos()) / square, (theta - theta.sin()) / (square * theta)]
}

impl Twist {
    /// Where the motion arrives at time 1 (the exponential of the twist).
    pub fn exp(&self) -> RigidMotion {
        let (w, v) = (self.omega, self.v);
        let theta = dot(w, w).sqrt();
        let (half, [a, b]) = (0.5 * theta, coefficients(theta));
        let ratio = if theta > 0.0 { half.sin() / theta } else { 0.5 };
        let rotation = quaternion::matrix([half.cos(), ratio * w[0], ratio * w[1], ratio * w[2]]);
        let (once, twice) = (cross(w, v), cross(w, cross(w, v)));
        let translation = std::array::from_fn(|i| v[i] + a * once[i] + b * twice[i]);
        RigidMotion { rotation, translation }
    }

    /// The same motion over a part of the time.
    pub fn times(&self, part: f64) -> Self {
        Self { omega: self.omega.map(|x| part * x), v: self.v.map(|x| part * x) }
    }
}

impl RigidMotion {
    /// The motion of constant speed that arrives here at time 1: turns of at most half a turn.
    pub fn log(&self) -> Twist {
        let [w, x, y, z] = quaternion::with_positive_w(quaternion::of_matrix(self.rotation));
        let sine = dot([x, y, z], [x, y, z]).sqrt();
        let theta = 2.0 * sine.atan2(w);
        let ratio = if sine > 1e-12 { theta / sine } else { 2.0 };
        let omega = [x, y, z].map(|q| ratio * q);
        // 1/θ² − cot(θ/2) / 2θ, by its series near 0.
        let square = theta * theta;
        let c = if theta < 1e-2 {
            1.0 / 12.0 + square / 720.0 + square * square / 30240.0
        } else {
            (1.0 - 0.5 * theta / (0.5 * theta).tan()) / square
        };
        let t = self.translation;
        let (once, twice) = (cross(omega, t), cross(omega, cross(omega, t)));
        Twist { omega, v: std::array::from_fn(|i| t[i] - 0.5 * once[i] + c * twice[i]) }
    }

    /// `first`, then this.
    pub fn after(&self, first: &Self) -> Self {
        let column = |j: usize| [0, 1, 2].map(|i| first.rotation[i][j]);
        let turned = quaternion::times(self.rotation, first.translation);
        Self {
            rotation: self.rotation.map(|row| [0, 1, 2].map(|j| dot(row, column(j)))),
            translation: std::array::from_fn(|i| turned[i] + self.translation[i]),
        }
    }

    /// The motion back.
    pub fn inverse(&self) -> Self {
        let rotation = [0, 1, 2].map(|i| [0, 1, 2].map(|j| self.rotation[j][i]));
        let translation = quaternion::times(rotation, self.translation).map(|x| -x);
        Self { rotation, translation }
    }

    /// The pose of a camera, world to camera.
    pub fn of_camera(camera: &Camera) -> Self {
        Self { rotation: camera.rotation, translation: camera.translation }
    }

    /// The camera at this pose.
    pub fn place(&self, camera: &Camera) -> Camera {
        let (rotation, translation) = (self.rotation, self.translation);
        Camera { rotation, translation, ..camera.clone() }
    }
}

/// The pose at a part of the way between two, along the screw that joins them at constant speed:
/// `exp(part · log(end · start⁻¹)) · start`.
pub fn interpolate(start: &RigidMotion, end: &RigidMotion, part: f64) -> RigidMotion {
    end.after(&start.inverse()).log().times(part).exp().after(start)
}

/// The poses of an exposure: `count` moments in the middles of equal parts of the time in which a camera
/// goes through a motion, half of it before its own pose and half after it. One pose is the
/// camera's own, bit for bit.
pub fn exposure_poses(camera: &Camera, motion: &Twist, count: usize) -> Vec<Camera> {
    if count <= 1 {
        return vec![camera.clone()];
    }
    let own = RigidMotion::of_camera(camera);
    let [start, end] = [-0.5, 0.5].map(|part| motion.times(part).exp().after(&own));
    let at = |k: usize| interpolate(&start, &end, (k as f64 + 0.5) / count as f64);
    (0..count).map(|k| at(k).place(camera)).collect()
}

/// How far the point `distance` in front of a camera moves across the picture in a motion, pixels.
pub fn blur_pixels(camera: &Camera, motion: &Twist, distance: f64) -> f64 {
    let seen = |part: f64| {
        let moved = motion.times(part).exp();
        let point = quaternion::times(moved.rotation, [0.0, 0.0, distance]);
        let [x, y, z]: [f64; 3] = std::array::from_fn(|i| point[i] + moved.translation[i]);
        [camera.fx * x / z, camera.fy * y / z]
    };
    let [[ax, ay], [bx, by]] = [seen(-0.5), seen(0.5)];
    (bx - ax).hypot(by - ay)
}

/// Poses that a blur of so many pixels takes: one each pixel, at least 1, at most [`MOST_POSES`].
pub fn poses_of_blur(pixels: f64) -> usize {
    (pixels.ceil() as usize).clamp(1, MOST_POSES)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::normals;
    use crate::sample_rng;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    fn apply(m: &RigidMotion, p: [f64; 3]) -> [f64; 3] {
        let turned = quaternion::times(m.rotation, p);
        std::array::from_fn(|i| turned[i] + m.translation[i])
    }

    #[test]
    fn a_screw_by_hand() {
        // A quarter turn about the vertical line through (1, 0, 0), climbing by 2: the origin goes to
        // (1, −1, 2), halfway to (1 − √½, −√½, 1).
        let end = RigidMotion {
            rotation: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [1.0, -1.0, 2.0],
        };
        let twist = end.log();
        assert!(near(twist.omega, [0.0, 0.0, FRAC_PI_2]), "{twist:?}");
        // The point at the origin circles (1, 0, 0): ω × (0 − center) = (0, −π/2, 0).
        assert!(near(twist.v, [0.0, -FRAC_PI_2, 2.0]), "{twist:?}");
        let none = Twist::default().exp();
        let half = interpolate(&none, &end, 0.5);
        let root = FRAC_PI_4.sin();
        assert!(near(apply(&half, [0.0; 3]), [1.0 - root, -root, 1.0]), "{half:?}");
        assert!(near(apply(&interpolate(&none, &end, 1.0), [0.0; 3]), [1.0, -1.0, 2.0]));
        assert!(near(apply(&interpolate(&end, &none, 0.0), [1.0, 0.0, 0.0]), [1.0, 0.0, 2.0]));
    }

    #[test]
    fn logarithms_undo_exponentials_of_all_sizes() {
        for size in [0.0, 1e-13, 1e-9, 1e-4, 0.0099, 0.0101, 0.5, 3.0, PI - 1e-7] {
            for seed in 0..20 {
                let mut x = [0.0; 6];
                normals(&mut sample_rng(seed, 0, 0), 6, |i, v| x[i] = v);
                let norm = dot([x[0], x[1], x[2]], [x[0], x[1], x[2]]).sqrt();
                let omega = [x[0], x[1], x[2]].map(|v| v * size / norm);
                let twist = Twist { omega, v: [x[3], x[4], x[5]] };
                let back = twist.exp().log();
                for i in 0..3 {
                    assert!((back.omega[i] - omega[i]).abs() < 1e-8, "{size} {back:?}");
                    assert!((back.v[i] - twist.v[i]).abs() < 1e-7, "{size} {back:?} {twist:?}");
                }
                let there = twist.exp();
                assert!(near(
                    apply(&there.inverse(), apply(&there, [1.0, 2.0, 3.0])),
                    [1.0, 2.0, 3.0]
                ));
            }
        }
    }

    #[test]
    fn exposures_are_centred_and_counted_by_pixels() {
        let camera = super::super::tests::camera();
        let motion = Twist { omega: [0.01, -0.02, 0.0], v: [0.03, 0.0, 0.01] };
        assert_eq!(exposure_poses(&camera, &motion, 1), std::slice::from_ref(&camera));
        let poses = exposure_poses(&camera, &motion, 5);
        let middle = RigidMotion::of_camera(&poses[2]);
        assert!(near(middle.translation, camera.translation));
        // The first is two fifths of the motion before the own pose.
        let want = motion.times(-0.4).exp().after(&RigidMotion::of_camera(&camera));
        assert!(near(poses[0].translation, want.translation));
        assert!((0..3).all(|i| near(poses[0].rotation[i], want.rotation[i])));
        // A turn of 0.01 rad with a focal length of 100 is a pixel.
        let turn = Twist { omega: [0.0, 0.01, 0.0], v: [0.0; 3] };
        assert!((blur_pixels(&camera, &turn, 2.0) - 1.0).abs() < 1e-3);
        let found: Vec<usize> =
            [0.0, 0.3, 1.0, 1.01, 7.2, 99.0, f64::NAN].map(poses_of_blur).to_vec();
        assert_eq!(found, [1, 1, 1, 2, 8, 16, 1]);
    }
}

//! [`RandomRotate`] and [`RandomRotateTargetAngle`]

use super::quaternion::{matrix, product, times, unit, with_positive_w};
use crate::error::{check_probability, check_range, require};
use crate::rng::{below, between, happens};
use crate::{DataError, Sample, SampleRng, Transform};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// An axis of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// The first one.
    X,
    /// The second one.
    Y,
    /// The third one; up, in the data files of the benchmarks.
    #[default]
    Z,
}

/// What stays in place in a rotation.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RotationCenter {
    /// The point 0, 0, 0.
    #[default]
    Origin,
    /// The middle of the bounding box.
    BoundingBox,
    /// A given point, meters.
    Point([f32; 3]),
}

scenesplat_kernels::settings! {
    /// With `probability`, turns the scene by a uniform angle: positions, orientations, normals,
    /// labeled points.
    ///
    /// # Source
    /// `RandomRotate` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: quaternions are
    /// given with `w ≥ 0` unless `exact`, and one that is zero counts as no rotation (an error there).
    pub struct RandomRotate {
        /// Lowest and highest angle, in units of π.
        pub angle: [f64; 2] = [-1.0, 1.0],
        /// The axis to turn about.
        pub axis: Axis = Axis::Z,
        /// What stays in place.
        pub center: RotationCenter = RotationCenter::Origin,
        /// How often it happens.
        pub probability: f64 = 0.5,
        /// Leaves quaternions with the sign that the product gives.
        pub exact: bool = false,
    }
}

impl Transform for RandomRotate {
    fn check(&self) -> Result<(), DataError> {
        check_range("random_rotate.angle", self.angle)?;
        check_probability("random_rotate.probability", self.probability)?;
        check_center(self.center)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if happens(rng, self.probability) {
            let angle = between(rng, self.angle);
            rotate(sample, angle, self.axis, self.center, self.exact);
        }
        Ok(())
    }
}

scenesplat_kernels::settings! {
    /// With `probability`, turns the scene by one of the given angles; as [`RandomRotate`] otherwise.
    ///
    /// # Source
    /// `RandomRotateTargetAngle`, as above.
    pub struct RandomRotateTargetAngle {
        /// The angles, in units of π, equally likely.
        pub angles: Vec<f64> = vec![0.5, 1.0, 1.5],
        /// The axis to turn about.
        pub axis: Axis = Axis::Z,
        /// What stays in place.
        pub center: RotationCenter = RotationCenter::Origin,
        /// How often it happens.
        pub probability: f64 = 0.75,
        /// Leaves quaternions with the sign that the product gives.
        pub exact: bool = false,
    }
}

impl Transform for RandomRotateTargetAngle {
    fn check(&self) -> Result<(), DataError> {
        let ok = !self.angles.is_empty() && self.angles.iter().all(|a| a.is_finite());
        let (setting, value) = ("random_rotate_target_angle.angles", format!("{:?}", self.angles));
        require(ok, setting, value, "one or more finite numbers")?;
        check_probability("random_rotate_target_angle.probability", self.probability)?;
        check_center(self.center)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if happens(rng, self.probability) {
            let angle = self.angles[below(rng, self.angles.len() as u32) as usize];
            rotate(sample, angle, self.axis, self.center, self.exact);
        }
        Ok(())
    }
}

fn check_center(center: RotationCenter) -> Result<(), DataError> {
    let RotationCenter::Point(p) = center else { return Ok(()) };
    require(p.iter().all(|v| v.is_finite()), "center", format!("{p:?}"), "three finite numbers")
}

/// Turns everything by `angle · π`, in f64.
fn rotate(sample: &mut Sample, angle: f64, axis: Axis, center: RotationCenter, exact: bool) {
    let Some([low, high]) = sample.bounds() else { return };
    let (sin, cos) = (angle * PI / 2.0).sin_cos();
    let mut turn = [cos, 0.0, 0.0, 0.0];
    turn[axis as usize + 1] = sin;
    let turn_matrix = matrix(turn);
    let center: [f64; 3] = match center {
        RotationCenter::Origin => [0.0; 3],
        RotationCenter::Point(point) => point.map(f64::from),
        RotationCenter::BoundingBox => {
            std::array::from_fn(|a| f64::midpoint(f64::from(low[a]), f64::from(high[a])))
        }
    };
    for coord in sample.places_mut() {
        let moved = times(turn_matrix, std::array::from_fn(|a| f64::from(coord[a]) - center[a]));
        *coord = std::array::from_fn(|a| (moved[a] + center[a]) as f32);
    }
    for normal in sample.normal.iter_mut().flatten() {
        *normal = times(turn_matrix, normal.map(f64::from)).map(|v| v as f32);
    }
    for quat in &mut sample.quat {
        let turned = unit(product(turn, unit(quat.map(f64::from))));
        let turned = if exact { turned } else { with_positive_w(turned) };
        *quat = turned.map(|v| v as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, congruent, covariance, difference, room};

    fn by(angle: f64, axis: Axis, center: RotationCenter, exact: bool) -> RandomRotate {
        RandomRotate { angle: [angle, angle], axis, center, probability: 1.0, exact }
    }

    #[test]
    fn a_quarter_turn_by_hand() {
        let mut sample = at(&[[1.0, 2.0, 3.0]]);
        sample.quat = vec![[0.5; 4]];
        sample.normal = Some(vec![[1.0, 0.0, 0.0]]);
        let turned = applied(&by(0.5, Axis::Z, RotationCenter::Origin, true), &sample, 0);
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(&turned.coord[0], &[-2.0, 1.0, 3.0]), "{:?}", turned.coord);
        // As the original's code gives it.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert!(near(&turned.quat[0], &[0.0, 0.0, half, half]), "{:?}", turned.quat);
        assert!(near(&turned.normal.unwrap()[0], &[0.0, 1.0, 0.0]));
        let about = by(0.5, Axis::X, RotationCenter::Point([0.0, 2.0, 0.0]), false);
        assert!(near(&applied(&about, &sample, 0).coord[0], &[1.0, -1.0, 0.0]));
    }

    #[test]
    fn everything_turns_together() {
        let sample = room(500);
        for (axis, angle) in [(Axis::X, 0.3), (Axis::Y, -1.7), (Axis::Z, 0.9)] {
            let turned = applied(&by(angle, axis, RotationCenter::BoundingBox, false), &sample, 0);
            let mut quat = [(angle * PI / 2.0).cos(), 0.0, 0.0, 0.0];
            quat[axis as usize + 1] = (angle * PI / 2.0).sin();
            let m = matrix(quat);
            for row in 0..sample.len() {
                let expected = congruent(m, covariance(sample.quat[row], sample.scale[row]));
                let got = covariance(turned.quat[row], turned.scale[row]);
                assert!(difference(expected, got) < 1e-6 * sample.scale[row][0].max(1.0) as f64);
                assert!(turned.quat[row][0] >= 0.0);
            }
            let [a, b] = [sample.bounds().unwrap(), turned.bounds().unwrap()];
            let axis = axis as usize;
            assert!((a[0][axis] - b[0][axis]).abs() < 1e-5, "the axis of the turn is unchanged");
            let points = turned.labelled_points.unwrap().coord;
            assert!(points.iter().zip(turned.coord.iter().step_by(7)).all(|(p, c)| p == c));
        }
    }

    #[test]
    fn zero_quaternions_and_centers_nowhere() {
        let mut sample = at(&[[1.0, 0.0, 0.0]]);
        sample.quat = vec![[0.0; 4]];
        let turned = applied(&by(1.0, Axis::Z, RotationCenter::Origin, false), &sample, 0);
        assert!((turned.quat[0][3] - 1.0).abs() < 1e-6, "{:?}", turned.quat);
        let nowhere = RotationCenter::Point([f32::NAN; 3]);
        assert!(by(0.0, Axis::X, nowhere, false).check().is_err());
    }

    #[test]
    fn half_of_the_scenes_turn_by_any_angle() {
        let sample = at(&[[1.0, 0.0, 0.0]]);
        let mut turned = 0;
        for seed in 0..400 {
            let [x, y, _] = applied(&RandomRotate::default(), &sample, seed).coord[0];
            assert!((x.hypot(y) - 1.0).abs() < 1e-6);
            turned += usize::from([x, y] != [1.0, 0.0]);
        }
        assert!((150..250).contains(&turned), "{turned} of 400: five standard deviations are 50");
        let quarter = RandomRotateTargetAngle { probability: 1.0, ..<_>::default() };
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..50 {
            let coord = applied(&quarter, &sample, seed).coord[0];
            seen.insert(coord.map(|v| v.round() as i32));
        }
        assert_eq!(seen.len(), 3, "{seen:?}");
    }
}

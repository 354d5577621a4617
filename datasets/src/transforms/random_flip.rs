//! [`RandomFlip`]

use super::quaternion::{unit, with_positive_w};
use crate::error::check_probability;
use crate::rng::happens;
use crate::{DataError, Sample, SampleRng, Transform};

scenesplat_kernels::settings! {
    /// Mirrors x, and mirrors y, each with `probability`: positions, orientations, normals, labeled
    /// points.
    ///
    /// A Gaussian's mirror image has its covariance conjugated by the mirror; as a quaternion that is
    /// `(w, x, −y, −z)` for x and `(w, −x, y, −z)` for y, sizes unchanged.
    ///
    /// # Source
    /// `RandomFlip` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: quaternions have
    /// `w ≥ 0` unless `exact`; there, their largest component becomes positive.
    pub struct RandomFlip {
        /// How often x is mirrored, and how often y.
        pub probability: f64 = 0.5,
        /// Gives the largest component of a quaternion a positive sign.
        pub exact: bool = false,
    }
}

impl Transform for RandomFlip {
    fn check(&self) -> Result<(), DataError> {
        check_probability("random_flip.probability", self.probability)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        for axis in 0..2 {
            if happens(rng, self.probability) {
                mirror(sample, axis, self.exact);
            }
        }
        Ok(())
    }
}

fn mirror(sample: &mut Sample, axis: usize, exact: bool) {
    let flip = |values: &mut [f32; 3]| values[axis] = -values[axis];
    sample.places_mut().for_each(flip);
    sample.normal.iter_mut().flatten().for_each(flip);
    for quat in &mut sample.quat {
        for other in (0..3).filter(|&other| other != axis) {
            quat[other + 1] = -quat[other + 1];
        }
        let turned = quat.map(f64::from);
        let turned = if exact { largest_positive(unit(turned)) } else { with_positive_w(turned) };
        *quat = turned.map(|v| v as f32);
    }
}

/// The sign that a conversion from a matrix gives: of equally large ones, x before y, z and w.
fn largest_positive(quat: [f64; 4]) -> [f64; 4] {
    let larger = |best: usize, i: usize| if quat[i].abs() > quat[best].abs() { i } else { best };
    if quat[[2, 3, 0].into_iter().fold(1, larger)] < 0.0 { quat.map(|v| -v) } else { quat }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transforms::testing::{applied, at, congruent, covariance, difference, room};

    fn mirrored(quat: [f32; 4], axis: usize, exact: bool) -> [f32; 4] {
        let mut sample = at(&[[1.0, 2.0, 3.0]]);
        sample.quat = vec![quat];
        mirror(&mut sample, axis, exact);
        sample.quat[0]
    }

    #[test]
    fn examples_of_the_original() {
        assert_eq!(mirrored([0.5; 4], 0, true), [0.5, 0.5, -0.5, -0.5]);
        assert_eq!(mirrored([0.5; 4], 1, true), [-0.5, 0.5, -0.5, 0.5]);
        assert_eq!(mirrored([0.5; 4], 1, false), [0.5, -0.5, 0.5, -0.5]);
        let near = |a: [f32; 4], b: [f32; 4]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
        let flipped = mirrored([0.9234, 0.1026, -0.2052, 0.3078], 0, true);
        assert!(near(flipped, [0.9234, 0.1026, 0.2052, -0.3078]), "{flipped:?}");
    }

    #[test]
    fn covariances_are_mirrored() {
        let sample = room(300);
        for exact in [false, true] {
            for axis in 0..2 {
                let mut flipped = sample.clone();
                mirror(&mut flipped, axis, exact);
                let mut m = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
                m[axis][axis] = -1.0;
                for row in 0..sample.len() {
                    let expected = congruent(m, covariance(sample.quat[row], sample.scale[row]));
                    let got = covariance(flipped.quat[row], flipped.scale[row]);
                    assert!(difference(expected, got) < 1e-7);
                    assert_eq!(flipped.coord[row][axis], -sample.coord[row][axis]);
                    if !exact {
                        assert!(flipped.quat[row][0] >= 0.0);
                    }
                }
                let points = &flipped.labelled_points.as_ref().unwrap().coord;
                assert_eq!(points[0], flipped.coord[0]);
                mirror(&mut flipped, axis, exact);
                assert_eq!(flipped.coord, sample.coord);
            }
        }
    }

    #[test]
    fn both_axes_are_tossed_for() {
        let sample = at(&[[1.0, 2.0, 3.0]]);
        let mut seen = [0; 4];
        for seed in 0..400 {
            let [x, y, z] = applied(&RandomFlip::default(), &sample, seed).coord[0];
            assert_eq!(z, 3.0);
            seen[usize::from(x < 0.0) + 2 * usize::from(y < 0.0)] += 1;
        }
        // 100 expected; five standard deviations are 43.
        assert!(seen.iter().all(|n| (57..143).contains(n)), "{seen:?}");
        assert_eq!(mirrored([0.0; 4], 0, false), [0.0; 4], "a zero quaternion is left to others");
    }
}

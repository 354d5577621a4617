//! [`ElasticDistortion`]

mod deform;
mod field;

use crate::error::{check_finite, check_positive, check_probability, require};
use crate::rng::happens;
use crate::{DataError, Sample, SampleRng, Transform};
use deform::{Matrix, deform_gaussian, deform_normal};
use field::Field;
use rayon::prelude::*;

scenesplat_kernels::settings! {
    /// With `probability`, bends the scene by smooth random displacement fields, one after the other.
    ///
    /// A field is normal noise on a grid, smoothed twice by a mean of three along each axis (with zeros
    /// beyond the grid), interpolated linearly and multiplied by its magnitude. Gaussians are stretched
    /// and turned, and normals turned, by the gradient `J = 1 + ∂displacement/∂position` where they are:
    /// a covariance becomes `J Σ Jᵀ`. Labeled points move along; beyond the grid they move as its edge.
    ///
    /// # Errors
    /// If the scene is so wide for the granularity that the grid would not fit into memory.
    ///
    /// # Source
    /// `ElasticDistortion` in `pointcept/datasets/transform.py`, SceneSplat be9d5e1. Differs: there only
    /// centers move; `exact` does that.
    pub struct ElasticDistortion {
        /// Granularity and magnitude of each field, meters.
        pub fields: Vec<[f64; 2]> = vec![[0.2, 0.4], [0.8, 1.6]],
        /// How often it happens.
        pub probability: f64 = 0.95,
        /// Moves centers only.
        pub exact: bool = false,
    }
}

/// Rows of one parallel task.
const ROWS_PER_TASK: usize = 4096;

impl Transform for ElasticDistortion {
    fn check(&self) -> Result<(), DataError> {
        for &[granularity, magnitude] in &self.fields {
            check_positive("elastic_distortion.granularity", granularity)?;
            let ok = magnitude.is_finite() && magnitude >= 0.0;
            let expected = "a finite number of 0 or more";
            require(ok, "elastic_distortion.magnitude", magnitude, expected)?;
        }
        check_probability("elastic_distortion.probability", self.probability)
    }

    fn apply(&self, sample: &mut Sample, rng: &mut SampleRng) -> Result<(), DataError> {
        self.check()?;
        if !happens(rng, self.probability) {
            return Ok(());
        }
        check_finite("coord", &sample.coord)?;
        let mut gradients = if self.exact { Vec::new() } else { vec![IDENTITY; sample.len()] };
        for &[granularity, magnitude] in &self.fields {
            let Some(bounds) = sample.bounds() else { return Ok(()) };
            let field = Field::random(bounds, granularity, magnitude, rng)?;
            if self.exact {
                sample.coord.par_iter_mut().with_min_len(ROWS_PER_TASK).for_each(|c| {
                    *c = moved(*c, field.at(*c).0);
                });
                continue;
            }
            let rows = sample.coord.par_iter_mut().zip(&mut gradients);
            rows.with_min_len(ROWS_PER_TASK).for_each(|(c, total)| {
                let (displacement, gradient) = field.at(*c);
                *c = moved(*c, displacement);
                *total = after(gradient, total);
            });
            for c in sample.labelled_points.iter_mut().flat_map(|points| &mut points.coord) {
                *c = moved(*c, field.at(*c).0);
            }
        }
        if !self.exact {
            deform(sample, &gradients);
        }
        Ok(())
    }
}

const IDENTITY: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn moved(coord: [f32; 3], by: [f64; 3]) -> [f32; 3] {
    std::array::from_fn(|a| (f64::from(coord[a]) + by[a]) as f32)
}

/// The gradient of a second displacement after a first map: `(1 + gradient) · total`.
fn after(gradient: Matrix, total: &Matrix) -> Matrix {
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            total[i][j] + (0..3).map(|k| gradient[i][k] * total[k][j]).sum::<f64>()
        })
    })
}

fn deform(sample: &mut Sample, gradients: &[Matrix]) {
    let gaussians = sample.quat.par_iter_mut().zip(&mut sample.scale).zip(gradients);
    gaussians.with_min_len(ROWS_PER_TASK).for_each(|((quat, scale), gradient)| {
        (*quat, *scale) = deform_gaussian(gradient, *quat, *scale);
    });
    let normals = sample.normal.iter_mut().flatten();
    normals.zip(gradients).for_each(|(n, gradient)| *n = deform_normal(gradient, *n));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample_rng;
    use crate::transforms::testing::{
        applied, at, congruent, covariance, difference, on_threads, room,
    };

    fn always(exact: bool) -> ElasticDistortion {
        ElasticDistortion { probability: 1.0, exact, ..<_>::default() }
    }

    #[test]
    fn exact_moves_centres_only_and_as_the_other() {
        let sample = room(2000);
        let (exact, bent) =
            (applied(&always(true), &sample, 3), applied(&always(false), &sample, 3));
        assert_eq!(exact.coord, bent.coord);
        assert_ne!(exact.coord, sample.coord);
        assert_eq!((&exact.quat, &exact.scale), (&sample.quat, &sample.scale));
        assert_eq!(
            (&exact.normal, &exact.labelled_points),
            (&sample.normal, &sample.labelled_points)
        );
        assert_ne!(bent.scale, sample.scale);
        let points = bent.labelled_points.unwrap().coord;
        assert!(points.iter().zip(bent.coord.iter().step_by(7)).all(|(p, c)| p == c));
        assert!(bent.quat.iter().all(|q| q[0] >= 0.0));
        for q in &bent.quat {
            assert!((q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
        }
        for n in bent.normal.unwrap() {
            assert!((n.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn gaussians_follow_the_movement_of_their_neighbourhood() {
        // A tiny Gaussian's covariance against that of points drawn at its ± axes ends.
        let step = ElasticDistortion { fields: vec![[0.5, 1.0]], ..always(false) };
        let (h, n) = (1e-2_f32, 40);
        let mut coords = vec![[0.0; 3], [4.0; 3]];
        for i in 0..n {
            let t = i as f32;
            // Off the borders of cells, where the gradient jumps.
            let c = [0.11 + 0.09 * t, 3.9 - 0.083 * t, 0.3 + 0.071 * t];
            coords.push(c);
            for axis in 0..3 {
                for sign in [-1.0, 1.0] {
                    let mut end = c;
                    end[axis] += sign * h;
                    coords.push(end);
                }
            }
        }
        let mut sample = at(&coords);
        sample.scale = vec![[h; 3]; coords.len()];
        let bent = applied(&step, &sample, 5);
        let mut close = 0;
        for i in 0..n {
            let first = 2 + i * 7;
            let end = |k: usize| bent.coord[first + 1 + k].map(f64::from);
            let j: Matrix = std::array::from_fn(|row| {
                std::array::from_fn(|axis| {
                    (end(2 * axis + 1)[row] - end(2 * axis)[row]) / (2.0 * f64::from(h))
                })
            });
            let expected = congruent(j, covariance([1.0, 0.0, 0.0, 0.0], [h; 3]));
            let got = covariance(bent.quat[first], bent.scale[first]);
            // Positions in f32 limit the difference quotient to 1e-4.
            close += usize::from(difference(expected, got) < 2e-3 * f64::from(h * h));
        }
        // Where an end lies in the next cell, the quotient mixes two gradients.
        assert!(close >= n * 2 / 3, "{close} of {n}");
    }

    #[test]
    fn hard_inputs() {
        let mut flat = at(&[[0.0; 3], [1.0; 3]]);
        flat.scale = vec![[0.0, 0.1, 0.2], [0.0; 3]];
        flat.quat[1] = [0.0; 4];
        flat.normal = Some(vec![[0.0; 3], [0.0, 0.0, 1.0]]);
        let bent = applied(&always(false), &flat, 2);
        assert_eq!((bent.scale[0][0], bent.scale[1]), (0.0, [0.0; 3]));
        assert_eq!(bent.normal.unwrap()[0], [0.0; 3]);
        let apply = |coord: &[[f32; 3]]| {
            always(true).apply(&mut at(coord), &mut sample_rng(0, 0, 0)).unwrap_err()
        };
        let error = apply(&[[0.0; 3], [1e6; 3]]).to_string();
        assert!(error.contains("granularity") && error.contains("outliers"), "{error}");
        assert!(matches!(apply(&[[f32::INFINITY; 3]]), DataError::NotFinite { .. }));
    }

    #[test]
    fn the_same_for_any_number_of_threads() {
        let sample = room(20_000);
        on_threads([1, 3], || applied(&always(false), &sample, 7));
    }
}

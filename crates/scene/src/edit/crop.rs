//! Cutting a box out of a scene.

use super::EditError;
use crate::bounds::bounding_box;
use crate::place::{NO_ORIGIN, plus};
use crate::{GaussianScene, LabelledPoints};
use rayon::prelude::*;
use std::str::FromStr;

/// A box along the axes, in the coordinates of the file; both ends belong to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CropBox {
    /// Lowest corner.
    pub min: [f64; 3],
    /// Highest corner.
    pub max: [f64; 3],
}

impl CropBox {
    /// Whether a position relative to `origin` is inside.
    fn contains(&self, p: &[f32; 3], origin: [f64; 3]) -> bool {
        if origin == NO_ORIGIN {
            // As numbers of f32, so that 0.1 as a user writes it is the 0.1 of a file.
            return (0..3).all(|i| (self.min[i] as f32..=self.max[i] as f32).contains(&p[i]));
        }
        let p = plus(*p, origin);
        (0..3).all(|i| (self.min[i]..=self.max[i]).contains(&p[i]))
    }

    /// Rows with their center inside, ascending.
    pub(super) fn rows(&self, scene: &GaussianScene) -> Result<Vec<usize>, EditError> {
        let inside = |row: &usize| self.contains(&scene.coord[*row], scene.origin);
        let kept: Vec<usize> = (0..scene.len()).into_par_iter().filter(inside).collect();
        if kept.is_empty() {
            let (min, max) = bounding_box(scene.coord.iter().copied());
            let place = |p: [f32; 3]| [0, 1, 2].map(|i| decimal(p[i]) + scene.origin[i]);
            let (min, max) = (place(min), place(max));
            return Err(EditError::EmptyCrop { min, max });
        }
        Ok(kept)
    }

    /// Keeps the labeled points in the box: others would be judged by Gaussians that are not there.
    pub(super) fn cut_points(&self, points: &mut LabelledPoints, origin: [f64; 3]) {
        let inside: Vec<bool> = points.coord.iter().map(|p| self.contains(p, origin)).collect();
        points.retain(&inside);
    }
}

/// The number as it is printed, without the digits that f64 adds: 0.1 for the f32 of 0.1.
fn decimal(v: f32) -> f64 {
    v.to_string().parse().unwrap_or(f64::from(v))
}

impl FromStr for CropBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad =
            || format!("{text:?} is no box; write X0,Y0,Z0,X1,Y1,Z1 with the lower end first");
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| bad()))
            .collect::<Result<_, _>>()?;
        let [a, b, c, d, e, f] = numbers[..] else { return Err(bad()) };
        let (min, max) = ([a, b, c], [d, e, f]);
        // NaN is not below anything.
        if (0..3).all(|i| min[i] <= max[i]) { Ok(Self { min, max }) } else { Err(bad()) }
    }
}

//! Cutting a box out of a scene.

use super::EditError;
use crate::bounds::bounding_box;
use crate::{GaussianScene, LabelledPoints};
use rayon::prelude::*;
use std::str::FromStr;

/// A box along the axes; both ends belong to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CropBox {
    /// Lowest corner.
    pub min: [f32; 3],
    /// Highest corner.
    pub max: [f32; 3],
}

impl CropBox {
    fn contains(&self, p: &[f32; 3]) -> bool {
        (0..3).all(|i| (self.min[i]..=self.max[i]).contains(&p[i]))
    }

    /// Rows with their center inside, ascending.
    pub(super) fn rows(&self, scene: &GaussianScene) -> Result<Vec<usize>, EditError> {
        let inside = |row: &usize| self.contains(&scene.coord[*row]);
        let kept: Vec<usize> = (0..scene.len()).into_par_iter().filter(inside).collect();
        if kept.is_empty() {
            let (min, max) = bounding_box(scene.coord.iter().copied());
            return Err(EditError::EmptyCrop { min, max });
        }
        Ok(kept)
    }

    /// Keeps the labeled points in the box: others would be judged by Gaussians that are not there.
    pub(super) fn cut_points(&self, points: &mut LabelledPoints) {
        let inside: Vec<bool> = points.coord.iter().map(|p| self.contains(p)).collect();
        points.retain(&inside);
    }
}

impl FromStr for CropBox {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad =
            || format!("{text:?} is no box; write X0,Y0,Z0,X1,Y1,Z1 with the lower end first");
        let numbers: Vec<f32> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| bad()))
            .collect::<Result<_, _>>()?;
        let [a, b, c, d, e, f] = numbers[..] else { return Err(bad()) };
        let (min, max) = ([a, b, c], [d, e, f]);
        // NaN is not below anything.
        if (0..3).all(|i| min[i] <= max[i]) { Ok(Self { min, max }) } else { Err(bad()) }
    }
}

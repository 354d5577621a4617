//! Gaussians that belong to nothing, and which ones are left without them.

use super::checks::is_giant;
use super::neighbourhood::{Distances, FEWEST_ROWS};
use scenesplat_scene::GaussianScene;
use scenesplat_scene::bounds::robust_bounds;
use serde::Serialize;
use std::fmt;

/// What [`find_floaters`] found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Floaters {
    /// Rows that are not floaters, ascending.
    #[serde(skip)]
    pub kept: Vec<usize>,
    /// Gaussians whose fourth neighbor is 2.5 times farther away than for 90 % of all, and farther
    /// than they reach themselves.
    pub isolated: usize,
    /// Gaussians whose three standard deviations exceed three quarters of the scene's diagonal, the
    /// isolated ones not counted.
    pub giants: usize,
}

impl Floaters {
    /// Rows that are floaters.
    pub fn removed(&self) -> usize {
        self.isolated + self.giants
    }
}

impl fmt::Display for Floaters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = self.kept.len() + self.removed();
        let (isolated, giants) = (self.isolated, self.giants);
        write!(f, "{isolated} isolated and {giants} giant Gaussians of {all}")
    }
}

/// Finds floaters by the rules of `inspect`'s findings `floaters` (wherever they are, so that what
/// lies far outside counts too) and `giant_splats`.
///
/// A scene of fewer than 100 Gaussians has none: nothing is usual there. The same for any number of
/// threads.
pub fn find_floaters(scene: &GaussianScene) -> Floaters {
    let robust = robust_bounds(&scene.coord);
    let distances = Distances::of(scene).filter(|_| scene.len() >= FEWEST_ROWS);
    let can_be_giant = scene.len() >= FEWEST_ROWS && robust.diagonal() > 0.0;
    let mut found = Floaters { kept: Vec::with_capacity(scene.len()), isolated: 0, giants: 0 };
    for row in 0..scene.len() {
        if distances.as_ref().is_some_and(|d| d.is_isolated(scene, row)) {
            found.isolated += 1;
        } else if can_be_giant && is_giant(scene, row, &robust) {
            found.giants += 1;
        } else {
            found.kept.push(row);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slab of 20 × 20 × 3 small Gaussians, a tenth of a meter apart.
    fn slab() -> GaussianScene {
        let coord: Vec<[f32; 3]> = (0..1200u16)
            .map(|i| [i % 20, i / 20 % 20, i / 400].map(|v| 0.1 * f32::from(v)))
            .collect();
        let n = coord.len();
        GaussianScene {
            coord,
            log_scale: vec![[0.05f32.ln(); 3]; n],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logit: vec![2.0; n],
            sh_dc: vec![[0.0; 3]; n],
            ..GaussianScene::default()
        }
    }

    #[test]
    fn planted_floaters_and_giants_are_found_and_nothing_else() {
        let clean = slab();
        let found = find_floaters(&clean);
        assert_eq!((found.kept.len(), found.removed()), (clean.len(), 0));
        let mut scene = clean;
        // Near, far away, and a pair that keeps itself company.
        scene.coord[7] = [1.0, 1.0, 2.5];
        scene.coord[500] = [400.0, 0.0, 0.0];
        (scene.coord[900], scene.coord[901]) = ([-3.0, 5.0, 1.0], [-3.0, 5.0, 1.01]);
        scene.log_scale[1000] = [4.0f32.ln(); 3];
        let found = find_floaters(&scene);
        let gone: Vec<usize> = (0..scene.len()).filter(|r| !found.kept.contains(r)).collect();
        assert_eq!(gone, [7, 500, 900, 901, 1000]);
        assert_eq!((found.isolated, found.giants), (4, 1));
        assert_eq!(found.to_string(), "4 isolated and 1 giant Gaussians of 1200");
        let few = scene.select_rows(&[7, 500, 1000, 1, 2, 3]).unwrap();
        assert_eq!(find_floaters(&few).removed(), 0);
        assert_eq!(find_floaters(&GaussianScene::default()).kept.len(), 0);
    }
}

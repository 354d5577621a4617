//! How near the neighbors of each Gaussian are, and which Gaussians have none.

use super::statistics::{Counted, count_rows, largest};
use scenesplat_datasets::effects::profile::isolation::Isolation;
pub(super) use scenesplat_datasets::effects::profile::isolation::{FEWEST_ROWS, NEIGHBOUR, reach};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::{Bounds, GaussianScene};

/// What the distances say.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Neighbourhood {
    /// Median distance to the fourth neighbor, meters.
    pub(super) spacing: Option<f64>,
    /// Gaussians with no others around, the stray ones outside `zone` not counted.
    pub(super) isolated: Counted,
    /// The most isolated one and the distance of its fourth neighbor, meters.
    pub(super) most_isolated: Option<(usize, f64)>,
}

/// Distances to the fourth neighbors, and what is far among them.
pub(super) struct Distances {
    distance: Vec<f32>,
    isolation: Isolation,
}

impl Distances {
    /// `None` where there are too few rows. Coordinates are finite.
    pub(super) fn of(scene: &GaussianScene) -> Option<Self> {
        let coord = &scene.coord;
        if coord.len() <= NEIGHBOUR {
            return None;
        }
        // Cannot fail for finite coordinates; without a tree nothing is said.
        let tree = KdTree::new(coord).ok()?;
        let distance = to_fourth(&tree, coord);
        drop(tree);
        let isolation = Isolation::of(&distance, |row| reach(scene, row));
        Some(Self { distance, isolation })
    }

    /// Whether a Gaussian has no others around.
    pub(super) fn is_isolated(&self, scene: &GaussianScene, row: usize) -> bool {
        self.isolation.is_isolated(self.distance[row], reach(scene, row))
    }
}

/// Distance of each place, itself a row of the tree, to its fourth neighbor.
pub(super) fn to_fourth(tree: &KdTree, places: &[[f32; 3]]) -> Vec<f32> {
    tree.map_nearest(
        places,
        NEIGHBOUR + 1,
        || (),
        |(), _, near| near.last().map_or(0.0, |n| n.distance_squared.sqrt() as f32),
    )
}

/// Measures distances; `zone` is where rows count as part of the scene. Coordinates are finite.
pub(super) fn neighbourhood(scene: &GaussianScene, zone: &Bounds) -> Neighbourhood {
    let Some(distances) = Distances::of(scene) else { return Neighbourhood::default() };
    let is_isolated =
        |row: usize| distances.is_isolated(scene, row) && zone.distance(scene.coord[row]) == 0.0;
    Neighbourhood {
        spacing: distances.isolation.spacing,
        isolated: count_rows(scene.len(), is_isolated),
        most_isolated: largest(scene.len(), |row| {
            is_isolated(row).then(|| f64::from(distances.distance[row]))
        }),
    }
}

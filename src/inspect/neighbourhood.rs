//! How near the neighbours of each Gaussian are, and which Gaussians have none.

use super::statistics::{Counted, count_rows, largest};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::quantile::quantile;
use scenesplat_scene::{Bounds, GaussianScene};

/// The neighbour whose distance is looked at: the fourth, so that a pair or triple of stray
/// Gaussians is not its own company.
pub(super) const NEIGHBOUR: usize = 4;

/// A Gaussian is isolated when its neighbour is so many times farther than for 90 % of all …
const FAR: f64 = 2.5;

/// … and so many times farther than its own reach of three standard deviations: large Gaussians of
/// sparse places fill the space up to their neighbours. In twelve real scenes at most 0.03 % are.
const UNSUPPORTED: f64 = 2.0;

/// Where all sizes are small for the spacing, as when only positions were rescaled, a Gaussian must
/// stand out by so much from the usual ratio. At 2 this begins to count above a ratio of 0.3, as
/// trained scenes have.
const UNUSUAL: f64 = 7.0;

/// Beyond so many times the distance of 90 %, size does not excuse. Real scenes: at most 0.12 %.
const VERY_FAR: f64 = 5.0;

/// Fewer rows have no usual spacing.
pub(super) const FEWEST_ROWS: usize = 100;

/// What the distances say.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Neighbourhood {
    /// Median distance to the fourth neighbour, metres.
    pub(super) spacing: Option<f64>,
    /// Gaussians with no others around, the stray ones outside `zone` not counted.
    pub(super) isolated: Counted,
    /// The most isolated one and the distance of its fourth neighbour, metres.
    pub(super) most_isolated: Option<(usize, f64)>,
}

/// Distances to the fourth neighbours, and what is usual among them.
pub(super) struct Distances {
    distance: Vec<f32>,
    /// The median.
    spacing: Option<f64>,
    /// That of 90 %; 0 where there are too few rows, or too many in one place, to tell.
    usual: f64,
    unsupported: f64,
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
        let distance: Vec<f32> = tree.map_nearest(
            coord,
            NEIGHBOUR + 1,
            || (),
            |(), _, near| near.last().map_or(0.0, |n| n.distance_squared.sqrt() as f32),
        );
        drop(tree);
        let mut sorted = distance.clone();
        let spacing = quantile(&mut sorted, 0.5).map(f64::from);
        let usual = quantile(&mut sorted, 0.9).map_or(0.0, f64::from);
        if coord.len() < FEWEST_ROWS || usual <= 0.0 {
            return Some(Self { distance, spacing, usual: 0.0, unsupported: 0.0 });
        }
        let ratio = |row: usize| (f64::from(distance[row]) / reach(scene, row)) as f32;
        let mut ratios: Vec<f32> = (0..coord.len()).map(ratio).collect();
        let usual_ratio = quantile(&mut ratios, 0.5).map_or(0.0, f64::from);
        let unsupported = UNSUPPORTED.max(UNUSUAL * usual_ratio);
        Some(Self { distance, spacing, usual, unsupported })
    }

    /// Whether a Gaussian has no others around.
    pub(super) fn is_isolated(&self, scene: &GaussianScene, row: usize) -> bool {
        let d = f64::from(self.distance[row]);
        self.usual > 0.0
            && d > FAR * self.usual
            && (d > VERY_FAR * self.usual || d > self.unsupported * reach(scene, row))
    }
}

/// Measures distances; `zone` is where rows count as part of the scene. Coordinates are finite.
pub(super) fn neighbourhood(scene: &GaussianScene, zone: &Bounds) -> Neighbourhood {
    let Some(distances) = Distances::of(scene) else { return Neighbourhood::default() };
    let is_isolated =
        |row: usize| distances.is_isolated(scene, row) && zone.distance(scene.coord[row]) == 0.0;
    Neighbourhood {
        spacing: distances.spacing,
        isolated: count_rows(scene.len(), is_isolated),
        most_isolated: largest(scene.len(), |row| {
            is_isolated(row).then(|| f64::from(distances.distance[row]))
        }),
    }
}

/// Three times the largest standard deviation, metres.
pub(super) fn reach(scene: &GaussianScene, row: usize) -> f64 {
    let log_scale = scene.log_scale[row].into_iter().fold(f32::NEG_INFINITY, f32::max);
    3.0 * f64::from(log_scale).exp()
}

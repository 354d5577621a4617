//! When a Gaussian belongs to nothing: the one rule of the profile, of `inspect` and of `convert`.

use scenesplat_scene::GaussianScene;
use scenesplat_scene::quantile::quantile;

/// The neighbor whose distance is looked at: the fourth, so that a pair or triple of stray
/// Gaussians is not its own company.
pub const NEIGHBOUR: usize = 4;

/// Fewer rows have no usual spacing.
pub const FEWEST_ROWS: usize = 100;

/// A Gaussian is isolated when its neighbor is so many times farther than for 90 % of all …
const FAR: f64 = 2.5;

/// … and so many times farther than its own reach of three standard deviations: large Gaussians of
/// sparse places fill the space up to their neighbors. In twelve real scenes at most 0.03 % are.
const UNSUPPORTED: f64 = 2.0;

/// Where all sizes are small for the spacing, as when only positions were rescaled, a Gaussian must
/// stand out by so much from the usual ratio. At 2 this begins to count above a ratio of 0.3, as
/// trained scenes have.
const UNUSUAL: f64 = 7.0;

/// Beyond so many times the distance of 90 %, size does not excuse. Real scenes: at most 0.12 %.
const VERY_FAR: f64 = 5.0;

/// What is far for a neighbor in a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Isolation {
    /// Median distance to the fourth neighbor, in units of the scene.
    pub spacing: Option<f64>,
    /// That of 90 %; 0 where there are too few rows, or too many in one place, to tell.
    usual: f64,
    unsupported: f64,
}

impl Isolation {
    /// From the distances of some Gaussians to their fourth neighbors, and their reaches.
    pub fn of(distances: &[f32], reach: impl Fn(usize) -> f64) -> Self {
        let mut sorted = distances.to_vec();
        let spacing = quantile(&mut sorted, 0.5).map(f64::from);
        let usual = quantile(&mut sorted, 0.9).map_or(0.0, f64::from);
        if distances.len() < FEWEST_ROWS || usual <= 0.0 {
            return Self { spacing, usual: 0.0, unsupported: 0.0 };
        }
        let ratio = |i: usize| (f64::from(distances[i]) / reach(i)) as f32;
        let mut ratios: Vec<f32> = (0..distances.len()).map(ratio).collect();
        let usual_ratio = quantile(&mut ratios, 0.5).map_or(0.0, f64::from);
        let unsupported = UNSUPPORTED.max(UNUSUAL * usual_ratio);
        Self { spacing, usual, unsupported }
    }

    /// Whether a Gaussian whose fourth neighbor is so far away, and that reaches so far itself, has
    /// no others around.
    pub fn is_isolated(&self, distance: f32, reach: f64) -> bool {
        let d = f64::from(distance);
        self.usual > 0.0
            && d > FAR * self.usual
            && (d > VERY_FAR * self.usual || d > self.unsupported * reach)
    }
}

/// Three times the largest standard deviation, in units of the scene.
pub fn reach(scene: &GaussianScene, row: usize) -> f64 {
    let log_scale = scene.log_scale[row].into_iter().fold(f32::NEG_INFINITY, f32::max);
    3.0 * f64::from(log_scale).exp()
}

//! Gaussians made up around coloured points, for benchmarks, tests and starts of optimisation.

use crate::{Gaussians, RasterError};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scenesplat_kernels::neighbors::{KdTree, NeighborError};

/// Standard deviation of the logarithm of a scale along one axis.
const SCALE_SPREAD: f32 = 0.35;
/// Standard deviation of the harmonics above the first.
const SH_SPREAD: f32 = 0.06;
/// The DC coefficient of a colour is `(rgb − ½) / Y₀`.
const Y0: f32 = 0.282_094_79;

impl Gaussians {
    /// One Gaussian of degree 3 per coloured point: its size is 0.8 times the root mean square
    /// distance to its three nearest other points, times `e^(0.35 n)` along each axis; its
    /// orientation is uniform; its opacity is the sigmoid of a logistic variate, that is, uniform in
    /// 0..1; harmonics above the first are `0.06 n`, `n` standard normal.
    ///
    /// Colours are in 0..=1. The same seed gives the same Gaussians, whatever the number of threads. A
    /// point without others has size 1.
    ///
    /// # Errors
    /// Counts that differ, coordinates that are not finite.
    ///
    /// # Source
    /// The recipe of the garden in the golden files of this project, whose opacities are uniform
    /// in 0.15..0.98 instead.
    pub fn around_points(
        points: &[[f32; 3]],
        colours: &[[f32; 3]],
        seed: u64,
    ) -> Result<Self, RasterError> {
        crate::gaussians::expect("colours", points.len(), colours.len())?;
        let tree = KdTree::new(points).map_err(|error| match error {
            NeighborError::NotFinite { row, value } => RasterError::Row {
                field: "points",
                row,
                value: format!("{value:?}"),
                range: "finite",
            },
            NeighborError::TooManyRows { rows, .. } => {
                RasterError::TooMany { what: "points", count: rows, limit: u32::MAX as usize - 1 }
            }
        })?;
        let size = tree.map_nearest(
            points,
            4,
            || (),
            |(), _, near| {
                let others = near.len().saturating_sub(1);
                let sum = near.iter().skip(1).map(|n| n.distance_squared).sum::<f64>();
                if others == 0 { 1.0 } else { 0.8 * (sum / others as f64).sqrt() as f32 }
            },
        );
        let row = |i: usize| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(i as u64);
            let scale = [(); 3].map(|()| size[i] * (SCALE_SPREAD * normal(&mut rng)).exp());
            let quat = [(); 4].map(|()| normal(&mut rng));
            let opacity: f32 = rng.random();
            let mut sh = [0.0; 48];
            for k in 0..3 {
                sh[k] = (colours[i][k] - 0.5) / Y0;
            }
            for value in &mut sh[3..] {
                *value = SH_SPREAD * normal(&mut rng);
            }
            (scale, quat, opacity, sh)
        };
        let rows: Vec<_> = (0..points.len()).into_par_iter().map(row).collect();
        let gaussians = Self {
            means: points.to_vec(),
            quats: rows.iter().map(|r| r.1).collect(),
            scales: rows.iter().map(|r| r.0).collect(),
            opacities: rows.iter().map(|r| r.2).collect(),
            sh: rows.iter().flat_map(|r| r.3).collect(),
            sh_degree: 3,
        };
        gaussians.check()?;
        Ok(gaussians)
    }
}

/// A standard normal variate, by Box and Muller.
fn normal(rng: &mut ChaCha8Rng) -> f32 {
    // 1 − [0, 1) is never 0, so that the logarithm is finite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    (radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()) as f32
}

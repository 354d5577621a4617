//! Gaussians made up around colored points.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_rasterizer::Gaussians;

/// Standard deviation of the logarithm of a scale along one axis.
const SCALE_SPREAD: f32 = 0.35;
/// Standard deviation of the harmonics above the first.
const SH_SPREAD: f32 = 0.06;
/// The DC coefficient of a color is `(rgb − ½) / Y₀`.
const Y0: f32 = 0.282_094_79;

/// One Gaussian of degree 3 per colored point: its size is 0.8 times the root mean square distance to
/// its three nearest other points, times `e^(0.35 n)` along each axis; its orientation is uniform; its
/// opacity is uniform in 0..1; harmonics above the first are `0.06 n`, `n` standard normal.
///
/// Colors are in 0..=1. The same seed gives the same Gaussians. A point without others has size 1.
///
/// # Source
/// The recipe of the garden in the golden files of this project, whose opacities are uniform in
/// 0.15..0.98 instead.
pub fn around_points(points: &[[f32; 3]], colors: &[[f32; 3]], seed: u64) -> Gaussians {
    let tree = KdTree::new(points).expect("finite points");
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
            sh[k] = (colors[i][k] - 0.5) / Y0;
        }
        for value in &mut sh[3..] {
            *value = SH_SPREAD * normal(&mut rng);
        }
        (scale, quat, opacity, sh)
    };
    let rows: Vec<_> = (0..points.len()).into_par_iter().map(row).collect();
    Gaussians {
        means: points.to_vec(),
        quats: rows.iter().map(|r| r.1).collect(),
        scales: rows.iter().map(|r| r.0).collect(),
        opacities: rows.iter().map(|r| r.2).collect(),
        sh: rows.iter().flat_map(|r| r.3).collect(),
        sh_degree: 3,
    }
}

/// A standard normal variate, by Box and Muller.
fn normal(rng: &mut ChaCha8Rng) -> f32 {
    // 1 − [0, 1) is never 0, so that the logarithm is finite.
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    (radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()) as f32
}

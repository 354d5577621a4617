//! Noise of the sensor: differences of neighbors' hues that depend on the light as a sensor's do.
//!
//! A sensor's noise has the variance read² + shot² · light in linear light; a display curve spreads it
//! most in the dark. Texture and the noise of training have no such dependence. So the variance of hue
//! differences between neighbors is fitted, over levels of light, by a constant and that curve (a photon
//! transfer curve), and the share of the curve is the evidence.

use super::super::strength::{NOISE_READ, NOISE_SHOT};
use super::table::{Table, quantile_of};
use super::{FEWEST_PATCHES, Figure, Measured, Outcome};
use scenesplat_scene::gaussian_scene::SH_C0;
use scenesplat_scene::linear_light::{display_slope, linear};

/// Neighbors that are compared with a Gaussian.
const PARTNERS: usize = 4;
/// Levels of light, of equally many pairs.
const LEVELS: usize = 12;
/// Darker and lighter colors are cut.
const RANGE: [f64; 2] = [0.1, 0.97];
/// The quantile of differences that is read, and the same of a normal distribution's magnitudes.
const SHARE: f64 = 0.35;
const NORMAL: f64 = 0.453_762;

/// A Gaussian's color, values of a display.
pub(super) fn color(table: &Table<'_>, row: usize) -> [f64; 3] {
    table.scene.sh_dc[row].map(|v| 0.5 + f64::from(SH_C0) * f64::from(v))
}

/// Variance of the noise of severity 1 in values of a display, at a value of a display.
fn variance(srgb: f64) -> f64 {
    let light = linear(srgb);
    let slope = display_slope(light);
    (NOISE_READ * NOISE_READ + NOISE_SHOT * NOISE_SHOT * light) * slope * slope
}

pub(super) fn measure(table: &Table<'_>) -> Outcome {
    table.has_surfaces()?;
    // (variance expected at severity 1, difference of hues), for both hues of each pair.
    let mut pairs: Vec<(f64, f64)> = Vec::new();
    for (patch, _) in table.flat() {
        let own = color(table, patch.row as usize);
        let others = patch.near.iter().filter(|&&row| row != patch.row).take(PARTNERS);
        for &row in others {
            let other = color(table, row as usize);
            let mean: [f64; 3] = std::array::from_fn(|i| 0.5 * (own[i] + other[i]));
            if !mean.iter().all(|v| (RANGE[0]..=RANGE[1]).contains(v)) {
                continue;
            }
            for (a, b) in [(0, 1), (2, 1)] {
                let difference = (own[a] - own[b]) - (other[a] - other[b]);
                pairs.push((2.0 * (variance(mean[a]) + variance(mean[b])), difference.abs()));
            }
        }
    }
    if pairs.len() < LEVELS * FEWEST_PATCHES {
        return Err("there are too few colors within the range of a display");
    }
    pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let levels: Vec<(f64, f64)> = (0..LEVELS)
        .map(|i| &pairs[i * pairs.len() / LEVELS..(i + 1) * pairs.len() / LEVELS])
        .map(|level| {
            let expected = level.iter().map(|p| p.0).sum::<f64>() / level.len() as f64;
            let seen = quantile_of(level.iter().map(|p| p.1), SHARE).unwrap_or(0.0) / NORMAL;
            (expected, seen * seen)
        })
        .collect();
    let [base, square] = fit(&levels);
    // A hue difference of two Gaussians has four times the variance of one channel of one of them.
    let bytes = |variance: f64| variance.max(0.0).sqrt() * 255.0 / 2.0;
    Ok(Measured {
        measure: Figure::new("sensor_noise", square.sqrt(), "of severity 1"),
        more: vec![
            Figure::new("other_noise", bytes(base), "levels of 255"),
            Figure::new("noise_in_the_dark", bytes(levels[LEVELS - 1].1), "levels of 255"),
            Figure::new("noise_in_the_light", bytes(levels[0].1), "levels of 255"),
            Figure::new("pairs", pairs.len() as f64, ""),
        ],
        strength: square.sqrt(),
        regions: Vec::new(),
    })
}

/// The constant and the factor, both at least 0, that explain the variances best, relative to themselves.
fn fit(levels: &[(f64, f64)]) -> [f64; 2] {
    let error = |base: f64, factor: f64| -> f64 {
        levels
            .iter()
            .map(|&(x, y)| {
                let model = base + factor * x;
                let scale = y.max(1e-7);
                ((model - y) / scale).abs()
            })
            .sum()
    };
    // Least absolute deviations pass through two of the points, or one and a zero.
    let mut best = (f64::INFINITY, [0.0, 0.0]);
    let mut look = |base: f64, factor: f64| {
        if base >= 0.0 && factor >= 0.0 && base.is_finite() && factor.is_finite() {
            let error = error(base, factor);
            if error < best.0 {
                best = (error, [base, factor]);
            }
        }
    };
    look(0.0, 0.0);
    for (i, &(x, y)) in levels.iter().enumerate() {
        look(y, 0.0);
        look(0.0, y / x);
        for &(u, v) in &levels[i + 1..] {
            let factor = (v - y) / (u - x);
            look(y - factor * x, factor);
        }
    }
    best.1
}

//! The Gaussians that optimisation begins with.

use crate::Model;
use crate::error::{OptimiseError, expect, within};
use crate::model::{Stored, logit};
use crate::random::{Counter, Purpose};
use scenesplat_kernels::neighbors::KdTree;
use scenesplat_scene::gaussian_scene::SH_C0;

/// Least squared distance to neighbors, of points that coincide.
const LEAST_SQUARE: f64 = 1e-7;

/// How first Gaussians are made of points.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialSettings {
    /// Opacity of all, between 0 and 1.
    pub opacity: f32,
    /// Standard deviation over the root mean square distance of the three nearest neighbors.
    pub scale: f32,
    /// Degree of the harmonics, 0 to 3; those above the first are 0.
    pub sh_degree: u8,
    /// Whether quaternions are random, as gsplat has them; else there is no rotation.
    pub random_quats: bool,
}

/// `ln(scale · √(mean of the squared distances to the three nearest others))`. `[N]`
///
/// A point that coincides with its neighbors counts as √1e-7 away from them, and so does a point
/// without neighbors.
///
/// # Errors
/// If a coordinate is not finite.
pub fn neighbour_log_scales(points: &[[f32; 3]], scale: f32) -> Result<Vec<f32>, OptimiseError> {
    let tree = KdTree::new(points)?;
    let log_scale = |_: &mut (), _: usize, near: &[scenesplat_kernels::neighbors::Neighbor]| {
        // The nearest is the point itself, or one at the same place.
        let others = near.get(1..).unwrap_or_default();
        let sum: f64 = others.iter().map(|n| n.distance_squared).sum();
        let mean = (sum / others.len().max(1) as f64).max(LEAST_SQUARE);
        (f64::from(scale) * mean.sqrt()).ln() as f32
    };
    Ok(tree.map_nearest(points, 4, || (), log_scale))
}

/// Gaussians at points, with their colors in 0 to 1.
///
/// # Shapes
/// `points`, `colors`: `[N, 3]`, units of the world
///
/// # Errors
/// If lengths differ, a coordinate is not finite, or a setting is out of its range.
pub fn from_points(
    points: &[[f32; 3]],
    colors: &[[f32; 3]],
    settings: &InitialSettings,
    seed: u64,
) -> Result<Model, OptimiseError> {
    expect("colors of the points", points.len(), colors.len())?;
    let inside = settings.opacity > 0.0 && settings.opacity < 1.0;
    within("initial opacity", settings.opacity.into(), inside, "between 0 and 1")?;
    let positive = settings.scale > 0.0 && settings.scale.is_finite();
    within("initial scale", settings.scale.into(), positive, "finite and above 0")?;
    within("sh_degree", settings.sh_degree.into(), settings.sh_degree <= 3, "0 to 3")?;
    let log_scales = neighbour_log_scales(points, settings.scale)?;
    let counter = Counter::new(seed, Purpose::Start, 0);
    let quat = |i: usize| {
        if settings.random_quats {
            counter.units(i).map(|v| v as f32)
        } else {
            [1.0, 0.0, 0.0, 0.0]
        }
    };
    let logit = logit(settings.opacity);
    let row =
        |i: usize| Stored { mean: points[i], log_scale: [log_scales[i]; 3], quat: quat(i), logit };
    let rows: Vec<Stored> = (0..points.len()).map(row).collect();
    let sh = flat_harmonics(colors.iter().copied(), settings.sh_degree);
    Model::from_arrays(&rows, sh, settings.sh_degree)
}

/// Harmonics of that degree of colors in 0 to 1 that are the same from all sides.
pub(crate) fn flat_harmonics(
    colors: impl ExactSizeIterator<Item = [f32; 3]>,
    degree: u8,
) -> Vec<f32> {
    let width = 3 * (usize::from(degree) + 1).pow(2);
    let mut sh = vec![0.0; width * colors.len()];
    for (sh, color) in sh.chunks_exact_mut(width).zip(colors) {
        for (sh, c) in sh.iter_mut().zip(color) {
            *sh = (c - 0.5) / SH_C0;
        }
    }
    sh
}

/// Positions and colors of points.
pub type Cloud = (Vec<[f32; 3]>, Vec<[f32; 3]>);

/// Points uniform in a box, with random colors, for captures that come without any.
///
/// # Errors
/// If the box is empty or not finite.
pub fn random_points(
    count: usize,
    [low, high]: [[f32; 3]; 2],
    seed: u64,
) -> Result<Cloud, OptimiseError> {
    for k in 0..3 {
        let good = low[k].is_finite() && high[k].is_finite() && low[k] < high[k];
        let range = "finite and above the lower one";
        within("upper corner of the box of random points", high[k].into(), good, range)?;
    }
    let counter = Counter::new(seed, Purpose::Start, 1);
    let point = |i: usize| {
        let [x, y, z, _] = counter.units(2 * i);
        let at = [x as f32, y as f32, z as f32];
        std::array::from_fn(|k| low[k] + (high[k] - low[k]) * at[k])
    };
    let color = |i: usize| {
        let [r, g, b, _] = counter.units(2 * i + 1);
        [r as f32, g as f32, b as f32]
    };
    Ok(((0..count).map(point).collect(), (0..count).map(color).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_coincide_or_are_alone() {
        let least = (1e-7f64.sqrt().ln()) as f32;
        assert!(neighbour_log_scales(&[], 1.0).unwrap().is_empty());
        assert_eq!(neighbour_log_scales(&[[1.0; 3]], 1.0).unwrap(), [least]);
        assert_eq!(neighbour_log_scales(&[[1.0; 3]; 5], 1.0).unwrap(), [least; 5]);
        assert!(neighbour_log_scales(&[[f32::NAN; 3]], 1.0).is_err());
        // One other, and two at distances 1 and 2: the mean is over those that there are.
        let pair = neighbour_log_scales(&[[0.0; 3], [3.0, 0.0, 0.0]], 1.0).unwrap();
        assert!(pair.iter().all(|s| (s - 3f32.ln()).abs() < 1e-6), "{pair:?}");
        let three: Vec<[f32; 3]> = (0..3).map(|i| [i as f32, 0.0, 0.0]).collect();
        let want = 2.5f32.sqrt().ln();
        assert!((neighbour_log_scales(&three, 1.0).unwrap()[0] - want).abs() < 1e-6);
        // Distances 1, 2 and 3 along a line: mean of squares 14 / 3.
        let line: Vec<[f32; 3]> = (0..4).map(|i| [i as f32, 0.0, 0.0]).collect();
        let want = (2.0 * (14.0f64 / 3.0).sqrt()).ln() as f32;
        assert!((neighbour_log_scales(&line, 2.0).unwrap()[0] - want).abs() < 1e-6);
    }

    #[test]
    fn colours_are_drawn_as_they_are() {
        let settings =
            InitialSettings { opacity: 0.5, scale: 1.0, sh_degree: 3, random_quats: false };
        let model = from_points(&[[0.0; 3]], &[[0.25, 0.5, 1.0]], &settings, 1).unwrap();
        let scene = model.to_scene();
        let color = scene.sh_dc[0].map(|dc| 0.5 + SH_C0 * dc);
        assert!((color[0] - 0.25).abs() < 1e-6 && (color[2] - 1.0).abs() < 1e-6);
        assert_eq!(scene.opacity(0), 0.5);
        assert_eq!(scene.sh_rest, vec![0.0; 45]);
        for bad in [0.0, 1.0, f32::NAN] {
            let settings = InitialSettings { opacity: bad, ..settings };
            assert!(from_points(&[], &[], &settings, 1).is_err());
        }
    }

    #[test]
    fn boxes_without_an_inside_are_refused() {
        let (zero, one) = ([0.0; 3], [1.0; 3]);
        for (low, high) in [
            (zero, [0.0, 1.0, 1.0]),
            ([f32::NAN, 0.0, 0.0], one),
            ([0.0, f32::NEG_INFINITY, 0.0], one),
            (zero, [1.0, 1.0, f32::INFINITY]),
            (zero, [1.0, f32::NAN, 1.0]),
            (one, zero),
        ] {
            assert!(random_points(3, [low, high], 1).is_err(), "{low:?} {high:?}");
        }
        assert_eq!(random_points(3, [zero, one], 1).unwrap().0.len(), 3);
    }

    #[test]
    fn first_gaussians_have_the_values_of_their_settings() {
        let settings =
            InitialSettings { opacity: 0.2, scale: 0.5, sh_degree: 1, random_quats: true };
        let (points, colors) =
            ([[0.0, 1.0, 2.0], [0.0, 1.0, 6.0]], [[0.1, 0.2, 0.3], [0.9, 0.7, 0.6]]);
        let model = from_points(&points, &colors, &settings, 5).unwrap();
        let counter = Counter::new(5, Purpose::Start, 0);
        for i in 0..2 {
            let row = model.row(i);
            assert_eq!(row.mean, points[i]);
            assert_eq!(row.quat, counter.units(i).map(|v| v as f32));
            // Four apart, half of it; logit(0.2) = −ln 4.
            assert!(row.log_scale.iter().all(|s| (s - 2f32.ln()).abs() < 1e-6), "{row:?}");
            assert!((row.logit + 4f32.ln()).abs() < 1e-6, "{row:?}");
            for c in 0..3 {
                let want = (colors[i][c] - 0.5) / 0.282_094_79;
                assert!((model.gaussians.sh[12 * i + c] - want).abs() < 1e-6, "{i} {c}");
            }
            assert_eq!(model.gaussians.sh[12 * i + 3..12 * (i + 1)], [0.0; 9]);
        }
        let still = InitialSettings { random_quats: false, ..settings };
        assert_eq!(
            from_points(&points, &colors, &still, 5).unwrap().row(1).quat,
            [1.0, 0.0, 0.0, 0.0]
        );
        let refused = |settings: InitialSettings| {
            from_points(&points, &colors, &settings, 1).unwrap_err().to_string()
        };
        for scale in [0.0, -1.0, f32::INFINITY, f32::NAN] {
            let error = refused(InitialSettings { scale, ..settings });
            assert!(error.starts_with("initial scale is"), "{error}");
        }
        let error = refused(InitialSettings { sh_degree: 4, ..settings });
        assert_eq!(error, "sh_degree is 4; it has to be 0 to 3");
        let error = refused(InitialSettings { opacity: 1.0, ..settings });
        assert_eq!(error, "initial opacity is 1; it has to be between 0 and 1");
        let error = from_points(&points, &colors[..1], &settings, 1).unwrap_err().to_string();
        assert_eq!(error, "colors of the points: expected 2 values, got 1");
    }

    #[test]
    fn random_points_are_uniform_in_their_box() {
        let (low, high) = ([-1.0, 2.0, 10.0], [1.0, 2.5, 40.0]);
        let (points, colors) = random_points(40, [low, high], 9).unwrap();
        let counter = Counter::new(9, Purpose::Start, 1);
        for i in 0..40 {
            let (at, color) = (counter.units(2 * i), counter.units(2 * i + 1));
            for k in 0..3 {
                let want = f64::from(low[k]) + f64::from(high[k] - low[k]) * at[k];
                assert!((f64::from(points[i][k]) - want).abs() < 1e-5, "{i} {k}");
                assert_eq!(colors[i][k], color[k] as f32, "{i} {k}");
            }
        }
    }
}

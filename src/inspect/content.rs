//! What is in a scene: distributions, harmonics, voxels, labels.

use super::statistics::{Histogram, Quantiles, count_rows, sort};
use rayon::prelude::*;
use scenesplat_datasets::plan::center_shift;
use scenesplat_kernels::grid_sample::{GridSampleError, KeyOrder, voxel_groups};
use scenesplat_scene::{Bounds, GaussianScene};
use serde::Serialize;
use std::collections::BTreeSet;

/// Distribution of one value per Gaussian.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Distribution {
    /// Quantiles; where a value is infinite, null in JSON.
    pub quantiles: Option<Quantiles>,
    /// Rows by value.
    pub histogram: Histogram,
}

/// A band of spherical harmonics.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ShBand {
    /// 1 for the first band beyond the DC term.
    pub band: u8,
    /// Rows with a coefficient that could change a color by half a byte.
    pub rows: usize,
    /// Largest absolute coefficient.
    pub largest: f64,
}

/// Smallest coefficient that counts as used: half a step of a color byte, as basis functions
/// reach about 1.
const SH_USED: f32 = 0.5 / 255.0;

/// Occupancy of the voxels that a network sees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Voxels {
    /// Their size, meters.
    pub size: f64,
    /// Number of voxels.
    pub count: usize,
    /// Gaussians per voxel.
    pub mean: f64,
    /// Most Gaussians in one voxel.
    pub largest: usize,
    /// Voxels with 1, 2, 3–4, 5–8, … Gaussians.
    pub by_gaussians: Vec<u64>,
    /// Gaussians too far away to be put on the grid; 0 unless there is a finding `grid_too_wide`.
    pub left_out: usize,
}

/// Class labels of the Gaussians.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelCounts {
    /// Classes that occur.
    pub classes: usize,
    /// Rows with a class.
    pub labelled: usize,
    /// Instances that occur.
    pub instances: usize,
}

/// Language codes of the Gaussians.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LanguageCodes {
    /// Values per Gaussian.
    pub width: usize,
    /// Width of the features that they stand for.
    pub feature_width: usize,
}

/// Histogram bins: opacity in steps of 1/40, logarithms in quarters of a decade.
const OPACITY_BINS: u16 = 40;
const SCALE_RANGE: [i32; 2] = [-7_000, 3_000];
const SCALE_BINS: u16 = 40;
const ANISOTROPY_RANGE: [i32; 2] = [0, 6_000];
const ANISOTROPY_BINS: u16 = 24;

pub(super) fn opacity(scene: &GaussianScene) -> Distribution {
    let mut values: Vec<f32> =
        (0..scene.len()).into_par_iter().map(|row| scene.opacity(row)).collect();
    let histogram = Histogram::count("opacity", &values, [0, 1000], OPACITY_BINS);
    sort(&mut values);
    Distribution { quantiles: Quantiles::of_sorted(&values, |v| v), histogram }
}

/// Largest and smallest standard deviation, and their ratio.
pub(super) fn scales(scene: &GaussianScene) -> (Distribution, Distribution, Distribution) {
    let ends: Vec<[f32; 2]> = scene
        .log_scale
        .par_iter()
        .map(|s| {
            let largest = s.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            [largest, s.iter().copied().fold(f32::INFINITY, f32::min)]
        })
        .collect();
    let [mut largest, mut smallest]: [Vec<f32>; 2] =
        [0, 1].map(|i| ends.par_iter().map(|e| e[i]).collect());
    // A point of no size at all is round.
    let mut ratio: Vec<f32> =
        ends.par_iter().map(|[l, s]| if l == s { 0.0 } else { l - s }).collect();
    drop(ends);
    let metres = |of, values: &mut Vec<f32>, range, bins| {
        values.par_iter_mut().for_each(|v| *v *= std::f32::consts::LOG10_E);
        let histogram = Histogram::count(of, values, range, bins);
        sort(values);
        // From logarithms of base 10; f64 holds them all.
        let quantiles = Quantiles::of_sorted(values, |v| 10f64.powf(v));
        Distribution { quantiles, histogram }
    };
    (
        metres("log10 of the largest scale, m", &mut largest, SCALE_RANGE, SCALE_BINS),
        metres("log10 of the smallest scale, m", &mut smallest, SCALE_RANGE, SCALE_BINS),
        metres("log10 of largest / smallest scale", &mut ratio, ANISOTROPY_RANGE, ANISOTROPY_BINS),
    )
}

pub(super) fn sh_bands(scene: &GaussianScene) -> Vec<ShBand> {
    let width = scene.sh_rest_len() * 3;
    if width == 0 || scene.is_empty() {
        return Vec::new();
    }
    (1..=scene.sh_degree)
        .map(|band| {
            // Band l holds the coefficients l² to (l + 1)² − 1, of which the DC term is number 0.
            let l = usize::from(band);
            let columns = (l * l - 1) * 3..((l + 1) * (l + 1) - 1) * 3;
            let of = |row: usize| &scene.sh_rest[row * width..][columns.clone()];
            let used = count_rows(scene.len(), |row| of(row).iter().any(|c| c.abs() > SH_USED));
            let largest = (0..scene.len())
                .into_par_iter()
                .map(|row| of(row).iter().fold(0.0f32, |a, c| a.max(c.abs())))
                .reduce(|| 0.0, f32::max);
            ShBand { band, rows: used.count, largest: f64::from(largest) }
        })
        .collect()
}

/// The row that stretches the scene beyond the grid.
pub(super) struct TooWide {
    pub(super) row: usize,
    pub(super) message: String,
}

/// Groups the Gaussians as the network's input is made. If the whole scene does not fit on the grid,
/// those inside `zone` are counted, if they do.
pub(super) fn voxels(
    scene: &GaussianScene,
    grid_size: f64,
    zone: &Bounds,
) -> (Option<Voxels>, Option<TooWide>) {
    let mut error = match occupancy(&scene.coord, grid_size) {
        Ok(voxels) => return (Some(voxels), None),
        Err(error) => error,
    };
    let row = match &mut error {
        GridSampleError::TooWide { row, axis, value, .. }
        | GridSampleError::NotFinite { row, axis, value } => {
            // As in the file, not as shifted.
            *value = scene.coord[*row][usize::from(*axis as u8 - b'x')];
            *row
        }
        _ => 0,
    };
    let inside: Vec<[f32; 3]> =
        scene.coord.par_iter().copied().filter(|&c| zone.distance(c) == 0.0).collect();
    let left_out = scene.len() - inside.len();
    let voxels = occupancy(&inside, grid_size).ok().filter(|v| v.count > 0);
    (voxels.map(|v| Voxels { left_out, ..v }), Some(TooWide { row, message: error.to_string() }))
}

fn occupancy(coord: &[[f32; 3]], grid_size: f64) -> Result<Voxels, GridSampleError> {
    let groups = voxel_groups(&center_shift(coord), grid_size, KeyOrder::Morton)?;
    let mut by_gaussians = Vec::new();
    for span in groups.offsets.windows(2) {
        let class = (span[1] - span[0]).next_power_of_two().trailing_zeros() as usize;
        if by_gaussians.len() <= class {
            by_gaussians.resize(class + 1, 0);
        }
        by_gaussians[class] += 1;
    }
    let count = groups.num_voxels();
    Ok(Voxels {
        size: grid_size,
        count,
        mean: coord.len() as f64 / count.max(1) as f64,
        largest: groups.largest_count(),
        by_gaussians,
        left_out: 0,
    })
}

pub(super) fn labels(scene: &GaussianScene) -> Option<LabelCounts> {
    let distinct = |ids: &[i32]| ids.iter().filter(|&&i| i >= 0).collect::<BTreeSet<_>>().len();
    if scene.segment.is_none() && scene.instance.is_none() {
        return None;
    }
    let segment = scene.segment.as_deref().unwrap_or_default();
    Some(LabelCounts {
        classes: distinct(segment),
        labelled: segment.iter().filter(|&&s| s >= 0).count(),
        instances: scene.instance.as_deref().map_or(0, distinct),
    })
}

pub(super) fn language_codes(scene: &GaussianScene) -> Option<LanguageCodes> {
    let codes = scene.lang_code.as_ref()?;
    Some(LanguageCodes { width: codes.width(), feature_width: codes.codebook.feature_width() })
}

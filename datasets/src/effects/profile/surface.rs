//! Surfaces that are not smooth: centers scatter across the planes of their patches.

use super::table::{Table, quantile_of};
use super::{FEWEST_PATCHES, Figure, Measured, Outcome};

/// The smoothest patches are those of walls and floors; furniture is curved and has edges.
const SHARE: f64 = 0.1;

pub(super) fn measure(table: &Table<'_>, metres: f64) -> Outcome {
    let rough: Vec<f64> =
        table.patches.iter().map(|p| metres * p.rough).filter(|r| !r.is_nan()).collect();
    let Some(scatter) = quantile_of(rough.iter().copied(), SHARE) else {
        return Err("Gaussians lie on lines, or there are too few");
    };
    if rough.len() < FEWEST_PATCHES {
        return Err("Gaussians lie on lines, or there are too few");
    }
    let middle = quantile_of(rough.iter().copied(), 0.5).unwrap_or(scatter);
    let flat = table.flat().count() as f64 / table.patches.len() as f64;
    Ok(Measured {
        measure: Figure::new("scatter", scatter, "m"),
        more: vec![
            Figure::new("scatter_median", middle, "m"),
            Figure::new("spacing", metres * table.spacing, "m"),
            Figure::new("flat_share", flat, ""),
        ],
        strength: scatter,
        regions: Vec::new(),
    })
}

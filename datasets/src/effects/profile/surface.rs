//! Surfaces that are not smooth: centres scatter across the planes of their patches.

use super::table::{Table, quantile_of};
use super::{FEWEST_PATCHES, Figure, Measured, Outcome};

/// The smoother patches are those of walls and floors; furniture is curved.
const SHARE: f64 = 0.3;

pub(super) fn measure(table: &Table<'_>, metres: f64) -> Outcome {
    let rough: Vec<f64> = table.flat().map(|(_, plane)| metres * plane.rough).collect();
    let Some(scatter) = quantile_of(rough.iter().copied(), SHARE) else {
        return Err("there are no flat patches");
    };
    if rough.len() < FEWEST_PATCHES {
        return Err("there are too few flat patches");
    }
    let middle = quantile_of(rough.iter().copied(), 0.5).unwrap_or(scatter);
    let flat = rough.len() as f64 / table.patches.len() as f64;
    Ok(Measured {
        measure: Figure::new("scatter", scatter, "m"),
        more: vec![
            Figure::new("scatter_median", middle, "m"),
            Figure::new("spacing", metres * table.spacing, "m"),
            Figure::new("flat_share", flat, ""),
        ],
        strength: scatter,
    })
}

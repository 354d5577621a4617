//! Motion blur: on a patch of a surface, every Gaussian is drawn out in one direction.
//!
//! A motion of length L adds L² / 12 to the variance of all Gaussians along it. The variance that can be taken
//! from a Gaussian along d before it is flat is 1 / (dᵀ Σ⁻¹ d); in sharp scenes some Gaussian of a patch has
//! next to none in any direction, or, as discs, as much in one as in another. So the evidence is what nearly
//! all of a patch have in the best direction of its plane, less what they have across it: the length of a
//! motion, over the size of the Gaussians, since larger ones leave more by chance.

use super::table::{Table, in_plane, quantile_of};
use super::{FEWEST_PATCHES, Figure, Measured, Outcome};
use rayon::prelude::*;

/// Directions that are tried, over half a turn.
const DIRECTIONS: usize = 12;
/// Gaussians of a patch that may be thinner than the motion is long.
const THINNER: usize = 1;
/// Median share of a motion's variance that falls into the plane of a patch, over all directions.
const IN_PLANE: f64 = 0.75;

pub(super) fn measure(table: &Table<'_>, metres: f64) -> Outcome {
    table.has_surfaces()?;
    let flat: Vec<_> = table.flat().collect();
    let excess: Vec<f64> = flat
        .par_iter()
        .map(|(patch, plane)| {
            let shapes: Vec<[f64; 3]> =
                patch.near.iter().map(|&row| in_plane(table.scene, row as usize, plane)).collect();
            // What can be taken away along a direction before nothing is left: 1 / (dᵀ Σ⁻¹ d).
            let thin = |direction: usize| {
                let angle = std::f64::consts::PI * direction as f64 / DIRECTIONS as f64;
                let (s, c) = angle.sin_cos();
                let take = |&[a, b, d]: &[f64; 3]| {
                    let across = a * s * s - 2.0 * b * s * c + d * c * c;
                    if across > 0.0 { ((a * d - b * b) / across).max(0.0) } else { 0.0 }
                };
                let mut along: Vec<f64> = shapes.iter().map(take).collect();
                let at = THINNER.min(along.len() - 1);
                *along.select_nth_unstable_by(at, f64::total_cmp).1
            };
            let widths: Vec<f64> = (0..DIRECTIONS).map(thin).collect();
            let best = (1..DIRECTIONS).fold(0, |b, i| if widths[i] > widths[b] { i } else { b });
            widths[best] - widths[(best + DIRECTIONS / 2) % DIRECTIONS]
        })
        .collect();
    let variance = quantile_of(excess.iter().copied(), 0.5).map(|v| v.max(0.0) / IN_PLANE);
    let size = table.size();
    let Some(variance) = variance.filter(|_| excess.len() >= FEWEST_PATCHES && size > 0.0) else {
        return Err("there are too few flat patches of Gaussians with an extent");
    };
    let length = (12.0 * variance).sqrt();
    Ok(Measured {
        measure: Figure::new("motion_over_size", length / size, ""),
        more: vec![
            Figure::new("motion", metres * length, "m"),
            Figure::new("size", metres * size, "m"),
            Figure::new("flat_patches", flat.len() as f64, ""),
        ],
        strength: metres * length,
        regions: Vec::new(),
    })
}

//! Floaters: Gaussians around which there is neither a surface nor company.
//!
//! Looser than [`isolation`](super::isolation), which has to be right about each Gaussian: floaters that are
//! each other's neighbors count, and so do large ones. A share of a scene is judged, not a row; and only
//! where surfaces are what there is, as in rooms: fur and leaves have neither.

use super::planes::Shell;
use super::table::{Table, quantile_of};
use super::{Figure, Measured, Outcome};

/// In the air is whose fourth neighbor is so many times farther than usual, if the patch is no piece of a
/// surface: walls are often sampled more sparsely than what stands before them.
const FAR: f64 = 2.75;

pub(super) fn measure(table: &Table<'_>, shell: &Shell) -> Outcome {
    shell.is_room()?;
    let scene = table.scene;
    if table.spacing <= 0.0 {
        return Err("most Gaussians stand where another one stands");
    }
    let far = |p: &super::table::Patch| f64::from(p.fourth) > FAR * table.spacing;
    let in_air: Vec<usize> = (table.patches.iter())
        .filter(|p| p.plane.is_none() && far(p))
        .map(|p| p.row as usize)
        .collect();
    let share = in_air.len() as f64 / table.patches.len() as f64;
    let opacity = quantile_of(in_air.iter().map(|&row| f64::from(scene.opacity(row))), 0.5);
    let mut more = vec![
        Figure::new("seen", in_air.len() as f64, "Gaussians"),
        Figure::new("looked_at", table.patches.len() as f64, "Gaussians"),
    ];
    more.extend(opacity.map(|o| Figure::new("opacity", o, "")));
    let measure = Figure::new("in_the_air", share, "");
    Ok(Measured { measure, more, strength: share, regions: Vec::new() })
}

//! Holes: gaps in the flat surfaces that bound a scene, around which the surface goes on.
//!
//! Each such plane (a wall, the floor) is covered with cells that should hold several Gaussians. Cells that are
//! empty though the surface goes on in nearly all directions are gaps. Where a surface ends (a room without a
//! ceiling) there is no gap; of curved surfaces, and of planes inside the scene, where several things of one
//! height leave gaps between them, nothing is said.

use super::planes::{BOUNDING_SHARE, Shell, Wall};
use super::{Figure, Measured, Outcome};

/// Gaps are looked for in planes with at most this share of the Gaussians behind them.
const BEHIND: f64 = 0.03;

pub(super) fn measure(shell: &Shell, metres: f64) -> Outcome {
    shell.is_room()?;
    let square = metres * metres;
    let is_bounding = |w: &&Wall| w.share_behind <= BEHIND && w.share >= BOUNDING_SHARE;
    let bounding = || shell.walls.iter().filter(is_bounding).map(|w| &w.gaps);
    let areas: Vec<[f64; 2]> = bounding().map(|gaps| gaps.areas).collect();
    let (gaps, all) = areas.iter().fold((0.0, 0.0), |(g, a), v| (g + v[0], a + v[1]));
    if all <= 0.0 {
        return Err("something stands behind every large flat surface");
    }
    let widest = areas.iter().map(|v| v[0]).fold(0.0, f64::max);
    Ok(Measured {
        measure: Figure::new("gap_share", gaps / all, ""),
        more: vec![
            Figure::new("gap_area", square * gaps, "m²"),
            Figure::new("gap_area_of_one_plane", square * widest, "m²"),
            Figure::new("area", square * all, "m²"),
            Figure::new("planes", areas.len() as f64, ""),
            Figure::new("area_over_box", shell.share_of_box, ""),
        ],
        strength: gaps / all,
        regions: bounding().flat_map(|gaps| gaps.regions(metres)).collect(),
    })
}

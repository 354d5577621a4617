//! Holes: gaps in the flat surfaces that bound a scene, around which the surface goes on.
//!
//! Each such plane (a wall, the floor) is covered with cells that should hold several Gaussians. Cells that are
//! empty though the surface goes on in nearly all directions are gaps. Where a surface ends (a room without a
//! ceiling) there is no gap; of curved surfaces, and of planes inside the scene, where several things of one
//! height leave gaps between them, nothing is said.

use super::cells::Cells;
use super::planes::{ACROSS, BOUNDING_SHARE, Large, Shell, THICK, Wall};
use super::table::quantile_of;
use super::{Figure, Measured, Outcome};
use scenesplat_scene::vector::dot;

/// Gaps are looked for in planes with at most this share of the Gaussians behind them.
const BEHIND: f64 = 0.03;
/// Gaussians that a cell should hold.
const PER_CELL: f64 = 10.0;
/// Cells along a side at most; cells are larger where that is not enough.
const MOST_CELLS: usize = 256;
/// Labels are lost up to so far from what is missing, metres (docs/effects.md).
const RIM: f64 = 0.15;

/// The gaps of a surface.
pub(super) struct Gaps {
    /// Areas of the gaps, and of the surface with them, in units of the scene.
    pub(super) areas: [f64; 2],
    /// Middles of the cells that are gaps, in units of the scene.
    cells: Vec<[f64; 3]>,
    /// Middles of the cells that are panes of glass, which are no gaps, in units of the scene.
    panes: Vec<[f64; 3]>,
    /// Side of a cell, in units of the scene.
    edge: f64,
}

impl Gaps {
    /// The panes of glass as a share of the surface.
    pub(super) fn pane_share(&self) -> f64 {
        let area = self.panes.len() as f64 * self.edge * self.edge;
        area / self.areas[1].max(f64::MIN_POSITIVE)
    }

    /// Balls that the cells of the panes lie in.
    pub(super) fn pane_regions(&self) -> impl Iterator<Item = [f32; 4]> {
        let radius = self.edge * std::f64::consts::FRAC_1_SQRT_2;
        self.panes.iter().map(move |[x, y, z]| [*x as f32, *y as f32, *z as f32, radius as f32])
    }

    /// Balls around the cells that reach over their rims.
    fn regions(&self, metres: f64) -> impl Iterator<Item = [f32; 4]> {
        let radius = self.edge * std::f64::consts::FRAC_1_SQRT_2 + RIM / metres;
        self.cells.iter().map(move |[x, y, z]| [*x as f32, *y as f32, *z as f32, radius as f32])
    }
}

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

impl Large {
    /// The gaps and panes of this surface, among Gaussians whose opacities are given over the median one.
    pub(super) fn gaps(&self, rows: &[[f64; 3]], opacity: &[f64], diagonal: f64) -> Gaps {
        let flat = |row: [f64; 3]| [dot(self.axes[0], row), dot(self.axes[1], row)];
        let off = |row: [f64; 3]| (dot(self.axes[2], row) - self.offset).abs() / diagonal;
        let near = || rows.iter().zip(opacity).filter(|(row, _)| off(**row) <= THICK);
        let on: Vec<[f64; 2]> = near().map(|(row, _)| flat(*row)).collect();
        let side = |a: usize, share| quantile_of(on.iter().map(|p| p[a]), share).unwrap_or(0.0);
        let low = [side(0, 0.002), side(1, 0.002)];
        let extent = [side(0, 0.998) - low[0], side(1, 0.998) - low[1]];
        let widest = extent[0].max(extent[1]);
        let edge = (PER_CELL / self.density).sqrt().max(widest / MOST_CELLS as f64);
        let count = extent.map(|e| ((e / edge) as usize + 1).min(MOST_CELLS + 1));
        let grid = Cells { low, edge, count };
        let mut is_full = vec![false; grid.len()];
        near().filter_map(|(row, _)| grid.of(flat(*row))).for_each(|cell| is_full[cell] = true);
        // A pane may be in either side of a wall.
        let sides = std::iter::once(&self.offset).chain(&self.sides);
        let panes_of = |&offset: &f64| {
            let mut here = vec![(0, 0.0); grid.len()];
            for (row, opacity) in near() {
                // What stands right before a pane is none of it.
                if (dot(self.axes[2], *row) - offset).abs() > ACROSS * diagonal {
                    continue;
                }
                let Some(cell) = grid.of(flat(*row)) else { continue };
                here[cell] = (here[cell].0 + 1, here[cell].1 + opacity);
            }
            grid.panes(&here)
        };
        // The first of the largest.
        let size = |panes: &Vec<bool>| panes.iter().filter(|is| **is).count();
        let is_pane = sides.map(panes_of).rev().max_by_key(size).unwrap_or_default();
        let is_gap = |cell: usize| !is_full[cell] && !is_pane[cell] && grid.is_amid(&is_full, cell);
        let place = |cell: usize| -> [f64; 3] {
            let [u, v] = grid.middle(cell);
            std::array::from_fn(|k| {
                u * self.axes[0][k] + v * self.axes[1][k] + self.offset * self.axes[2][k]
            })
        };
        let gaps: Vec<usize> = (0..grid.len()).filter(|&cell| is_gap(cell)).collect();
        let panes: Vec<usize> = (0..grid.len()).filter(|&cell| is_pane[cell]).collect();
        let all =
            gaps.len() + (0..grid.len()).filter(|&cell| is_full[cell] || is_pane[cell]).count();
        Gaps {
            areas: [gaps.len(), all].map(|cells| cells as f64 * edge * edge),
            cells: gaps.into_iter().map(place).collect(),
            panes: panes.into_iter().map(place).collect(),
            edge,
        }
    }
}

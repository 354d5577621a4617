//! Gaps and panes of a large flat surface.

use super::cells::Cells;
use super::table::quantile_of;
use scenesplat_scene::vector::dot;

/// The patches of a plane lie within so many diagonals of it.
pub(super) const ACROSS: f64 = 0.012;
/// What lies within so many diagonals of a plane belongs to it: windows and doors are set back.
pub(super) const THICK: f64 = 0.04;
/// Gaussians that a cell should hold.
const PER_CELL: f64 = 10.0;
/// Cells along a side at most; cells are larger where that is not enough.
const MOST_CELLS: usize = 256;
/// Labels are lost up to so far from what is missing, meters (docs/effects.md).
const RIM: f64 = 0.15;

/// A large flat surface.
pub(super) struct Large {
    /// Two directions in it, then the normal; each of length 1.
    pub(super) axes: [[f64; 3]; 3],
    /// Where it is along its normal.
    pub(super) offset: f64,
    /// Where its other sides are, if it has some: walls are a hand thick.
    pub(super) sides: Vec<f64>,
    /// Gaussians that are looked at, for each unit of area.
    pub(super) density: f64,
    /// The share of the flat patches that lies in it.
    pub(super) share: f64,
}

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
    pub(super) fn regions(&self, metres: f64) -> impl Iterator<Item = [f32; 4]> {
        let radius = self.edge * std::f64::consts::FRAC_1_SQRT_2 + RIM / metres;
        self.cells.iter().map(move |[x, y, z]| [*x as f32, *y as f32, *z as f32, radius as f32])
    }
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

    /// The places behind it: on the side where there are fewer, the first if there are as many on both.
    pub(super) fn beyond(&self, places: &[[f64; 3]], diagonal: f64) -> Vec<usize> {
        let height = |i: usize| dot(self.axes[2], places[i]) - self.offset;
        let side = |sign: f64| -> Vec<usize> {
            (0..places.len()).filter(|&i| sign * height(i) > THICK * diagonal).collect()
        };
        let [a, b] = [side(1.0), side(-1.0)];
        if b.len() < a.len() { b } else { a }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places every 5 cm of a wall of 4 × 3 m at x = `x`, with opacities; of the part of 1.5 × 1.2 m in it one in `keep`,
    /// of another opacity.
    fn wall(x: f64, opacity: f64, keep: usize, of_pane: f64) -> Vec<([f64; 3], f64)> {
        let mut rows = Vec::new();
        for i in 0..80 {
            for j in 0..60 {
                let in_pane = (20..50).contains(&i) && (20..44).contains(&j);
                if !in_pane || (7 * i + j) % keep == 0 {
                    let place = [x, 0.05 * f64::from(i as u32), 0.05 * f64::from(j as u32)];
                    rows.push((place, if in_pane { of_pane } else { opacity }));
                }
            }
        }
        rows
    }

    fn pane_share(rows: &[([f64; 3], f64)], sides: &[f64]) -> f64 {
        let axes = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
        let (offset, sides) = (sides[0], sides[1..].to_vec());
        let plane = Large { axes, offset, sides, density: 400.0, share: 0.1 };
        let (places, opacity): (Vec<[f64; 3]>, Vec<f64>) = rows.iter().copied().unzip();
        plane.gaps(&places, &opacity, 6.0).pane_share()
    }

    /// 1.5 × 1.2 of 4 × 3 m.
    const SHARE: f64 = 0.15;

    #[test]
    fn panes_are_found_in_either_side_of_a_wall() {
        let mut rows = wall(0.0, 1.0, 2, 0.3);
        rows.extend(wall(-0.12, 1.0, 1, 1.0));
        let found = pane_share(&rows, &[-0.12, 0.0]);
        assert!((found - SHARE).abs() < 0.03, "{found}");
        assert_eq!(pane_share(&rows, &[-0.12]), 0.0);
        assert_eq!(pane_share(&wall(0.0, 1.0, 1, 1.0), &[0.0]), 0.0);
    }

    #[test]
    fn panes_of_clear_scenes_are_thin_as_well() {
        // A little clearer and much less of it; no less of it, or no clearer, is a thin spot.
        // Cells at its edge hold some of the wall.
        let found = pane_share(&wall(0.0, 1.0, 8, 0.7), &[0.0]);
        assert!((0.6 * SHARE..SHARE).contains(&found), "{found}");
        assert_eq!(pane_share(&wall(0.0, 1.0, 1, 0.7), &[0.0]), 0.0);
        assert_eq!(pane_share(&wall(0.0, 1.0, 8, 1.0), &[0.0]), 0.0);
    }

    #[test]
    fn what_touches_a_pane_makes_no_wall_of_it() {
        let mut rows = wall(0.0, 1.0, 1, 0.3);
        // The edge of a shelf across it.
        rows.extend((20..50).map(|i| ([0.03, 0.05 * f64::from(i), 1.52], 1.2)));
        let found = pane_share(&rows, &[0.0]);
        assert!((found - SHARE).abs() < 0.03, "{found}");
    }
}

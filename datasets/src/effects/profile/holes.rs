//! Holes: gaps in the flat surfaces that bound a scene, around which the surface goes on.
//!
//! Each such plane (a wall, the floor) is covered with cells that should hold several Gaussians. Cells that are
//! empty though the surface goes on in nearly all directions are gaps. Where a surface ends (a room without a
//! ceiling) there is no gap; of curved surfaces, and of planes inside the scene, where several things of one
//! height leave gaps between them, nothing is said.

use super::planes::{Large, Shell, THICK};
use super::table::quantile_of;
use super::{Figure, Measured, Outcome};
use scenesplat_scene::vector::dot;

/// Gaps are looked for in planes with at most this share of the Gaussians behind them.
const BEHIND: f64 = 0.03;
/// Gaussians that a cell should hold.
const PER_CELL: f64 = 10.0;
/// Cells along a side at most; cells are larger where that is not enough.
const MOST_CELLS: usize = 256;
/// Of eight directions, in so many the surface goes on around a gap.
const AROUND: usize = 6;
/// Labels are lost up to so far from what is missing, metres (docs/effects.md).
const RIM: f64 = 0.15;

/// The gaps of a surface.
pub(super) struct Gaps {
    /// Areas of the gaps, and of the surface with them, in units of the scene.
    pub(super) areas: [f64; 2],
    /// Middles of the cells that are gaps, in units of the scene.
    cells: Vec<[f64; 3]>,
    /// Side of a cell, in units of the scene.
    edge: f64,
    /// Area of the cells in which everything is faint though the surface goes on around them, in units of the scene.
    pub(super) faint: f64,
}

impl Gaps {
    /// Balls around the cells that reach over their rims.
    fn regions(&self, metres: f64) -> impl Iterator<Item = [f32; 4]> {
        let radius = self.edge * std::f64::consts::FRAC_1_SQRT_2 + RIM / metres;
        self.cells.iter().map(move |[x, y, z]| [*x as f32, *y as f32, *z as f32, radius as f32])
    }
}

pub(super) fn measure(shell: &Shell, metres: f64) -> Outcome {
    shell.is_room()?;
    let square = metres * metres;
    let bounding = || shell.walls.iter().filter(|w| w.share_behind <= BEHIND).map(|w| &w.gaps);
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
    /// The gaps of this surface, among Gaussians of which some are faint.
    pub(super) fn gaps(&self, rows: &[[f64; 3]], is_faint: &[bool], diagonal: f64) -> Gaps {
        let flat = |row: [f64; 3]| [dot(self.axes[0], row), dot(self.axes[1], row)];
        let is_on =
            |row: [f64; 3]| (dot(self.axes[2], row) - self.offset).abs() <= THICK * diagonal;
        let near = || rows.iter().zip(is_faint).filter(|(row, _)| is_on(**row));
        let on: Vec<[f64; 2]> = near().map(|(row, _)| flat(*row)).collect();
        let side = |a: usize, share| quantile_of(on.iter().map(|p| p[a]), share).unwrap_or(0.0);
        let low = [side(0, 0.002), side(1, 0.002)];
        let extent = [side(0, 0.998) - low[0], side(1, 0.998) - low[1]];
        let widest = extent[0].max(extent[1]);
        let edge = (PER_CELL / self.density).sqrt().max(widest / MOST_CELLS as f64);
        let cells = extent.map(|e| ((e / edge) as usize + 1).min(MOST_CELLS + 1));
        let (mut is_full, mut is_solid) =
            (vec![false; cells[0] * cells[1]], vec![false; cells[0] * cells[1]]);
        for (p, (_, faint)) in on.iter().zip(near()) {
            let [x, y] = [0, 1].map(|a| ((p[a] - low[a]) / edge).floor());
            if x >= 0.0 && y >= 0.0 && (x as usize) < cells[0] && (y as usize) < cells[1] {
                let cell = x as usize * cells[1] + y as usize;
                is_full[cell] = true;
                is_solid[cell] |= !faint;
            }
        }
        let middle = |x: usize, y: usize| -> [f64; 3] {
            let [u, v] = [(x, 0), (y, 1)].map(|(cell, a)| low[a] + (cell as f64 + 0.5) * edge);
            std::array::from_fn(|k| {
                u * self.axes[0][k] + v * self.axes[1][k] + self.offset * self.axes[2][k]
            })
        };
        let (mut found, mut all, mut faint) = (Vec::new(), 0usize, 0usize);
        for x in 0..cells[0] {
            for y in 0..cells[1] {
                let full = is_full[x * cells[1] + y];
                let gap = !full && goes_on(&is_full, cells, [x, y]) >= AROUND;
                if gap {
                    found.push(middle(x, y));
                }
                all += usize::from(gap || full);
                let is_pane = full && !is_solid[x * cells[1] + y];
                faint += usize::from(is_pane && goes_on(&is_solid, cells, [x, y]) >= AROUND);
            }
        }
        let [gaps, all, faint] = [found.len(), all, faint].map(|cells| cells as f64 * edge * edge);
        Gaps { areas: [gaps, all], cells: found, edge, faint }
    }
}

/// In how many of eight directions there is a full cell.
fn goes_on(is_full: &[bool], cells: [usize; 2], from: [usize; 2]) -> usize {
    let steps = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]];
    let hits = |step: &[isize; 2]| {
        let mut at = from;
        loop {
            let next = [0, 1].map(|a| at[a].checked_add_signed(step[a]).filter(|v| *v < cells[a]));
            let [Some(x), Some(y)] = next else { return false };
            at = [x, y];
            if is_full[x * cells[1] + y] {
                return true;
            }
        }
    };
    steps.iter().filter(|step| hits(step)).count()
}

//! Which Gaussians each tile of 16×16 pixels draws, front to back.

use crate::{ExtentRule, Projected, RasterSettings, TILE, View};

/// The Gaussians of every tile, front to back.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TileLists {
    /// Tiles across.
    pub columns: usize,
    /// Tiles down.
    pub rows: usize,
    /// Where the list of tile `row · columns + column` starts in `entries`; one more value than
    /// tiles.
    pub offsets: Vec<usize>,
    /// Rows of [`Projected`], by depth, then by index of the Gaussian.
    pub entries: Vec<u32>,
    /// For each entry the rows of the tile that it can reach: first in the low 4 bits, last in the
    /// high 4.
    pub reach: Vec<u8>,
}

impl TileLists {
    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Whether there is no tile.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Lists per tile the Gaussians that can reach one of its pixels.
///
/// The lists are exact up to rounding margins: a Gaussian is listed where its ellipse `α ≥ cut` meets the
/// rectangle of the tile's pixel centres. With [`ExtentRule::Circle`], where its square does.
pub fn tile_lists(projected: &Projected, view: &View, settings: &RasterSettings) -> TileLists {
    let (columns, rows) = view.tiles();
    let mut order: Vec<u32> = (0..projected.len() as u32).collect();
    order.sort_by_key(|&row| projected.depth[row as usize].to_bits());
    let mut lists = vec![Vec::new(); columns * rows];
    for row in order {
        each_tile(projected, row as usize, view, settings, |tile, reach| {
            lists[tile].push((row, reach));
        });
    }
    let mut out = TileLists { columns, rows, offsets: vec![0], ..TileLists::default() };
    for list in lists {
        out.entries.extend(list.iter().map(|e| e.0));
        out.reach.extend(list.iter().map(|e| e.1));
        out.offsets.push(out.entries.len());
    }
    out
}

/// Calls `found(tile, reach)` for each tile that the Gaussian can reach.
fn each_tile(
    projected: &Projected,
    row: usize,
    view: &View,
    settings: &RasterSettings,
    mut found: impl FnMut(usize, u8),
) {
    let columns = view.tiles().0;
    let [u, v] = projected.mean2d[row];
    let [ex, ey] = projected.half_extent[row];
    let Some([x0, x1]) = centres(u - ex, u + ex, view.width) else { return };
    let Some([y0, y1]) = centres(v - ey, v + ey, view.height) else { return };
    let last = TILE as u32 - 1;
    for column in x0 / TILE as u32..=x1 / TILE as u32 {
        let mut range = [y0, y1];
        if settings.extent == ExtentRule::Ellipse {
            let left = (column * TILE as u32) as f32 + 0.5;
            let right = left + last as f32;
            let [low, high] = strip(projected, row, left - u, right - u);
            match centres(v + low, v + high, view.height) {
                Some(inside) => range = inside,
                None => continue,
            }
        }
        for tile_row in range[0] / TILE as u32..=range[1] / TILE as u32 {
            let top = tile_row * TILE as u32;
            let first = range[0].max(top) - top;
            let end = range[1].min(top + last) - top;
            found(tile_row as usize * columns + column as usize, (first | end << 4) as u8);
        }
    }
}

/// First and last pixel whose centre is between two coordinates, with a margin for rounding.
fn centres(low: f32, high: f32, size: u32) -> Option<[u32; 2]> {
    let margin = 1e-3 + 1e-6 * (low.abs() + high.abs()).min(1e6);
    // Casts saturate; what is far outside ends at the border.
    let first = (low - 0.5 - margin).ceil().max(0.0);
    let last = (high - 0.5 + margin).floor().min(size as f32 - 1.0);
    (first <= last).then_some([first as u32, last as u32])
}

/// Lowest and highest y, from the centre, of the ellipse between two x from the centre.
fn strip(projected: &Projected, row: usize, left: f32, right: f32) -> [f32; 2] {
    let [a, b, c] = projected.conic[row];
    let [ex, ey] = projected.half_extent[row];
    let [v11, _] = projected.variance[row];
    // Wider than the cut by more than f32 can be wrong.
    let level = projected.level[row] * (1.0 + 1e-4) + 1e-4;
    let top = ey * (-b / a);
    let edge = |x: f32| {
        let x = x.clamp(left, right).clamp(-ex, ex);
        let (middle, half) = (-b / c * x, ((level - x * x / v11).max(0.0) / c).sqrt());
        (middle, half)
    };
    let (low, high) = (edge(-top), edge(top));
    [low.0 - low.1, high.0 + high.1]
}

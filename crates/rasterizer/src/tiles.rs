//! Which Gaussians each tile of 16×16 pixels draws, front to back.

use crate::depth_order::{OrderMemory, Shared, depth_order};
use crate::splats::prefetch;
use crate::{ExtentRule, Projected, RasterSettings, TILE, View};
use rayon::prelude::*;
use scenesplat_kernels::simd::compiled_for;

/// Fewest Gaussians per task.
const MIN_CHUNK: usize = 2048;
/// Gaussians between asking for one and reading it: depth order is no order in memory.
const AHEAD: usize = 16;
/// Most tiles: a [`Hit`] has room for the numbers of as many. A picture that [`View::check`] accepts
/// has no more than 2²⁰ + 2¹³ of them.
const MAX_TILES: usize = 1 << 24;
/// Most tasks: each counts all tiles.
const MAX_CHUNKS: usize = 32;

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
/// rectangle of the tile's pixel centers. With [`ExtentRule::Circle`], where its square meets the
/// tile, and then all rows are in reach, as in the programs with that rule: pixels outside the
/// square count if they are above the cut.
///
/// # Panics
/// If the picture is larger than [`View::check`] allows, or `projected` is not what
/// [`project`](crate::project) made (its arrays differ in length).
pub fn tile_lists(projected: &Projected, view: &View, settings: &RasterSettings) -> TileLists {
    let mut out = TileLists::default();
    tile_lists_into(projected, view, settings, &mut TileMemory::default(), &mut out);
    out
}

/// Memory of [`tile_lists_into`].
#[derive(Debug, Default)]
pub(crate) struct TileMemory {
    order: OrderMemory,
    hits: Vec<Hits>,
}

/// [`tile_lists`] with memory that is used again.
pub(crate) fn tile_lists_into(
    projected: &Projected,
    view: &View,
    settings: &RasterSettings,
    memory: &mut TileMemory,
    out: &mut TileLists,
) {
    let (columns, rows) = view.tiles();
    // Places in the lists are counted by tile and then written through a pointer: a number that did
    // not fit would count for one tile and write for another.
    let tiles = columns.checked_mul(rows);
    assert!(tiles.is_some_and(|tiles| tiles <= MAX_TILES), "a picture of {columns} × {rows} tiles");
    let order = depth_order(&projected.depth, &mut memory.order);
    let chunk = order.len().div_ceil(MAX_CHUNKS).max(MIN_CHUNK);
    let isa = settings.isa();
    let tasks = order.len().div_ceil(chunk);
    if memory.hits.len() < tasks {
        memory.hits.resize_with(tasks, Hits::default);
    }
    let parts = &mut memory.hits[..tasks];
    order.par_chunks(chunk).zip(&mut *parts).for_each(|(order, part)| {
        compiled_for(
            isa,
            #[inline(always)]
            |_| hits(projected, order, view, settings.extent, part),
        );
    });
    (out.columns, out.rows) = (columns, rows);
    out.offsets.clear();
    let mut total = 0;
    for tile in 0..columns * rows {
        out.offsets.push(total);
        let mut inside = 0;
        for part in &mut *parts {
            inside += std::mem::replace(&mut part.counts[tile], inside);
        }
        total += inside as usize;
    }
    out.offsets.push(total);
    out.entries.resize(total, 0);
    out.reach.resize(total, 0);
    let offsets = &out.offsets;
    let entries = Shared(out.entries.as_mut_ptr());
    let reach = Shared(out.reach.as_mut_ptr());
    parts.par_iter_mut().for_each(|Hits { list, counts: starts }| {
        let (entries, reach) = (&entries, &reach);
        for hit in list {
            let tile = (hit.place >> 8) as usize;
            let at = offsets[tile] + starts[tile] as usize;
            starts[tile] += 1;
            // SAFETY: places are below the total, since the counts made the offsets, and no two
            // hits have the same.
            unsafe {
                entries.0.add(at).write(hit.row);
                reach.0.add(at).write(hit.place as u8);
            }
        }
    });
}

/// A Gaussian in a tile.
#[derive(Debug)]
struct Hit {
    row: u32,
    /// Tile, below [`MAX_TILES`], above the lowest 8 bits; reach in them.
    place: u32,
}

/// Hits of some Gaussians, in their order, and how many each tile has.
#[derive(Debug, Default)]
struct Hits {
    list: Vec<Hit>,
    counts: Vec<u32>,
}

#[inline(always)]
fn hits(projected: &Projected, order: &[u32], view: &View, rule: ExtentRule, out: &mut Hits) {
    let (columns, rows) = view.tiles();
    out.list.clear();
    out.list.reserve(4 * order.len());
    out.counts.clear();
    out.counts.resize(columns * rows, 0);
    for (at, &row) in order.iter().enumerate() {
        if let Some(&ahead) = order.get(at + AHEAD) {
            let ahead = ahead as usize;
            prefetch(&projected.mean2d[ahead]);
            prefetch(&projected.half_extent[ahead]);
            prefetch(&projected.conic[ahead]);
            prefetch(&projected.variance[ahead]);
            prefetch(&projected.level[ahead]);
        }
        each_tile(projected, row as usize, view, rule, |tile, reach| {
            out.list.push(Hit { row, place: (tile as u32) << 8 | u32::from(reach) });
            out.counts[tile] += 1;
        });
    }
}

/// Calls `found(tile, reach)` for each tile that the Gaussian can reach.
#[inline(always)]
fn each_tile(
    projected: &Projected,
    row: usize,
    view: &View,
    rule: ExtentRule,
    mut found: impl FnMut(usize, u8),
) {
    let side = TILE as u32;
    let (columns, rows) = view.tiles();
    let [u, v] = projected.mean2d[row];
    let [ex, ey] = projected.half_extent[row];
    if rule != ExtentRule::Ellipse {
        for tile_row in whole_tiles(v, ey, rows) {
            for column in whole_tiles(u, ex, columns) {
                found(tile_row * columns + column, 15 << 4);
            }
        }
        return;
    }
    let Some([x0, x1]) = centres(u - ex, u + ex, view.width) else { return };
    let Some([y0, y1]) = centres(v - ey, v + ey, view.height) else { return };
    let one_tile = x0 / side == x1 / side && y0 / side == y1 / side;
    let ellipse = (!one_tile).then(|| Ellipse::new(projected, row));
    for column in x0 / side..=x1 / side {
        let [mut low, mut high] = [y0, y1];
        if let Some(ellipse) = &ellipse {
            let left = (column * side) as f32 + 0.5;
            let [top, bottom] = ellipse.strip(left - u, left + (side - 1) as f32 - u);
            let Some(inside) = centres(v + top, v + bottom, view.height) else { continue };
            (low, high) = (low.max(inside[0]), high.min(inside[1]));
            if low > high {
                continue;
            }
        }
        for tile_row in low / side..=high / side {
            let top = tile_row * side;
            let first = low.max(top) - top;
            let last = high.min(top + side - 1) - top;
            found(tile_row as usize * columns + column as usize, (first | last << 4) as u8);
        }
    }
}

/// Tiles, of `count`, that what is at most `extent` from a center meets.
#[inline(always)]
fn whole_tiles(centre: f32, extent: f32, count: usize) -> std::ops::Range<usize> {
    let side = TILE as f32;
    // Casts saturate; what is far outside ends at the border.
    let first = (centre / side - extent / side).floor().max(0.0) as usize;
    let end = (centre / side + extent / side).ceil().max(0.0) as usize;
    first.min(count)..end.min(count)
}

/// First and last pixel whose center is between two coordinates, with a margin for rounding.
#[inline(always)]
fn centres(low: f32, high: f32, size: u32) -> Option<[u32; 2]> {
    let margin = 1e-3 + 1e-6 * (low.abs() + high.abs()).min(1e6);
    // Casts saturate; what is far outside ends at the border.
    let first = (low - 0.5 - margin).ceil().max(0.0);
    let last = (high - 0.5 + margin).floor().min(size as f32 - 1.0);
    (first <= last).then_some([first as u32, last as u32])
}

/// What the outline `q = level` needs, coordinates from the center.
struct Ellipse {
    /// Of the line through the points with the outermost x: `y = slope · x` is the middle at `x`.
    slope: f32,
    /// x of the point with the highest y.
    top: f32,
    half_width: f32,
    level: f32,
    per_variance: f32,
    per_c: f32,
}

impl Ellipse {
    #[inline(always)]
    fn new(projected: &Projected, row: usize) -> Self {
        let [a, b, c] = projected.conic[row];
        let [half_width, half_height] = projected.half_extent[row];
        Self {
            slope: -b / c,
            top: half_height * (-b / a),
            half_width,
            // Wider than the cut by more than f32 can be wrong.
            level: projected.level[row] * (1.0 + 1e-4) + 1e-4,
            per_variance: 1.0 / projected.variance[row][0],
            per_c: 1.0 / c,
        }
    }

    /// Lowest and highest y of what is between two x.
    #[inline(always)]
    fn strip(&self, left: f32, right: f32) -> [f32; 2] {
        // `min` and `max` instead of `clamp`, which would check its bounds.
        let inside = |x: f32| x.max(left).min(right).max(-self.half_width).min(self.half_width);
        let half = |x: f32| {
            // Nothing is below 0 but rounding: `x` is inside the half width.
            ((self.level - x * x * self.per_variance).max(0.0) * self.per_c).sqrt()
        };
        let (low, high) = (inside(-self.top), inside(self.top));
        [self.slope * low - half(low), self.slope * high + half(high)]
    }
}

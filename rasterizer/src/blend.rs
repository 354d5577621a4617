//! The pixel loop: Gaussians of a tile front to back, each over the rows it reaches.

use crate::{Projected, RasterSettings, TileLists, View};
use rayon::prelude::*;

/// Side of a tile, pixels.
pub const TILE: usize = 16;

/// Where a tile is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TileRect {
    /// Number, row by row.
    pub tile: usize,
    /// Its left pixel.
    pub x0: u32,
    /// Its upper pixel.
    pub y0: u32,
    /// Pixels inside the picture, 1 to 16.
    pub width: u32,
    /// Pixels inside the picture, 1 to 16.
    pub height: u32,
}

/// What one Gaussian does in one row of 16 pixels of a tile.
///
/// Pixels that do not take the Gaussian (α below the cut, stopped, outside the picture) have weight
/// exactly 0; their other values mean nothing. Pixels that take it have a weight above 0.
#[derive(Debug, Clone, Copy)]
pub struct Span<'a> {
    /// `α T`.
    pub weights: &'a [f32; TILE],
    /// `min(alpha_max, o e^(−σ))`: equal to `alpha_max` where the limit was met.
    pub alphas: &'a [f32; TILE],
    /// Transmittance `T` before this Gaussian.
    pub before: &'a [f32; TILE],
}

/// What is made of the weights of one tile. The pixel loop is compiled for each implementor, so
/// what a visitor does not read is not computed; mark the methods `#[inline(always)]`.
pub trait TileVisitor: Send {
    /// What is left of the tile when it is done.
    type Output: Send;
    /// Whether [`finish`](Self::finish) needs `last`; it is all 0 otherwise.
    const LAST: bool = false;

    /// A Gaussian begins: list position `entry`, row of [`Projected`] `row`.
    #[inline(always)]
    fn enter(&mut self, _entry: u32, _row: u32) {}

    /// One row of pixels of that Gaussian: `y`, and `x` of the first of 16 pixels, from the picture's
    /// corner (so `x` is the tile's `x0`). Only called if a weight is above 0.
    fn span(&mut self, entry: u32, row: u32, y: u32, x: u32, span: Span<'_>);

    /// The Gaussian has no more pixels in this tile.
    #[inline(always)]
    fn leave(&mut self, _entry: u32, _row: u32) {}

    /// The tile is done. `transmittance` is what is left per pixel, 16 per row; `last` the list
    /// position + 1 of the last Gaussian the pixel took, 0 for none.
    fn finish(self, transmittance: &[f32; TILE * TILE], last: &[u32; TILE * TILE]) -> Self::Output;
}

/// Blends every tile with a visitor of its own; tiles run in parallel, outputs are in tile order.
///
/// # Panics
/// If `projected` and `lists` do not belong together.
pub fn blend<V: TileVisitor>(
    projected: &Projected,
    lists: &TileLists,
    view: &View,
    settings: &RasterSettings,
    make: impl Fn(TileRect) -> V + Sync,
) -> Vec<V::Output> {
    let tile = |tile: usize| {
        let rect = rect(tile, lists, view);
        blend_tile(projected, lists, settings, rect, make(rect))
    };
    (0..lists.len()).into_par_iter().map(tile).collect()
}

fn rect(tile: usize, lists: &TileLists, view: &View) -> TileRect {
    let side = TILE as u32;
    let x0 = (tile % lists.columns) as u32 * side;
    let y0 = (tile / lists.columns) as u32 * side;
    let (width, height) = ((view.width - x0).min(side), (view.height - y0).min(side));
    TileRect { tile, x0, y0, width, height }
}

fn blend_tile<V: TileVisitor>(
    projected: &Projected,
    lists: &TileLists,
    settings: &RasterSettings,
    rect: TileRect,
    mut visitor: V,
) -> V::Output {
    let (begin, end) = (lists.offsets[rect.tile], lists.offsets[rect.tile + 1]);
    let mut transmittance = [1.0f32; TILE * TILE];
    let mut stopped = [false; TILE * TILE];
    let mut last = [0u32; TILE * TILE];
    for (entry, (&row, &reach)) in
        lists.entries[begin..end].iter().zip(&lists.reach[begin..end]).enumerate()
    {
        let (entry, i) = (entry as u32, row as usize);
        let ([u, v], [a, b, c]) = (projected.mean2d[i], projected.conic[i]);
        visitor.enter(entry, row);
        for r in (reach & 15)..=(reach >> 4).min(rect.height as u8 - 1) {
            let (mut weights, mut alphas) = ([0.0; TILE], [0.0; TILE]);
            let line = usize::from(r) * TILE;
            let mut before = [0.0; TILE];
            before.copy_from_slice(&transmittance[line..line + TILE]);
            let dy = v - (rect.y0 as f32 + f32::from(r) + 0.5);
            let mut any = false;
            for x in 0..rect.width as usize {
                let dx = u - (rect.x0 as f32 + x as f32 + 0.5);
                let sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
                let alpha = (projected.opacity[i] * (-sigma).exp()).min(settings.alpha_max);
                if stopped[line + x] || !(alpha >= settings.alpha_cut) {
                    continue;
                }
                let t = before[x];
                let after = t - alpha * t;
                let go =
                    after > settings.stop || (settings.stop_excluded && after == settings.stop);
                if !go {
                    stopped[line + x] = true;
                    continue;
                }
                (weights[x], alphas[x]) = (alpha * t, alpha);
                transmittance[line + x] = after;
                last[line + x] = entry + 1;
                any = true;
            }
            if any {
                let span = Span { weights: &weights, alphas: &alphas, before: &before };
                visitor.span(entry, row, rect.y0 + u32::from(r), rect.x0, span);
            }
        }
        visitor.leave(entry, row);
    }
    visitor.finish(&transmittance, &last)
}

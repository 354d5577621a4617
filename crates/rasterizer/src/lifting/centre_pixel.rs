//! One pixel per Gaussian: the rule of the program that labels were first lifted with.

use crate::{Projected, Span, TILE, TileRect, TileVisitor, View};

/// No pixel.
const NONE: u32 = u32::MAX;

/// The pixels at which Gaussians count, and at which their segments are read.
///
/// The weight is that of pixel `⌊u − ½⌋, ⌊v − ½⌋`, the segment that of pixel `⌊u⌋, ⌊v⌋`: half a pixel
/// apart, as in the original.
pub(super) struct CentrePixels {
    /// `y << 16 | x` by row of the projection, [`NONE`] outside the picture.
    weight: Vec<u32>,
}

impl CentrePixels {
    pub(super) fn new(projected: &Projected, view: &View) -> Self {
        let pixel = |&[u, v]: &[f32; 2]| {
            let place = |centre: f32, size: u32| {
                let start = (centre - 0.5).floor();
                // As the original tests it, which rounding can make false in the last bit.
                let inside = |p: f32| {
                    let d = centre - (p + 0.5);
                    p >= 0.0 && p < size as f32 && (0.0..1.0).contains(&d)
                };
                [start, start - 1.0, start + 1.0].into_iter().find(|&p| inside(p)).map(|p| p as u32)
            };
            // Sides are at most 65535 pixels.
            match (place(u, view.width), place(v, view.height)) {
                (Some(x), Some(y)) => y << 16 | x,
                _ => NONE,
            }
        };
        Self { weight: projected.mean2d.iter().map(pixel).collect() }
    }

    /// The pixel whose weight counts.
    pub(super) fn weight_pixel(&self, row: u32) -> [u32; 2] {
        let pixel = self.weight[row as usize];
        [pixel & 0xFFFF, pixel >> 16]
    }

    /// The pixel whose segment counts, for a Gaussian with a weight.
    pub(super) fn segment_pixel([u, v]: [f32; 2], view: &View) -> [u32; 2] {
        // Casts cut off the fraction; a Gaussian with a weight is not left of or above the picture.
        [(u as u32).min(view.width - 1), (v as u32).min(view.height - 1)]
    }
}

/// Finds the weight of each Gaussian at its pixel.
pub(super) struct CentrePixel<'a> {
    pixels: &'a CentrePixels,
    rect: TileRect,
    /// Pixel of the tile of the Gaussian at hand, 16 per row; beyond the tile if not in it.
    at: usize,
    weights: Vec<(u32, f32)>,
}

impl<'a> CentrePixel<'a> {
    pub(super) fn new(pixels: &'a CentrePixels, rect: TileRect) -> Self {
        Self { pixels, rect, at: TILE * TILE, weights: Vec::new() }
    }
}

impl TileVisitor for CentrePixel<'_> {
    /// Row of the projection and weight.
    type Output = Vec<(u32, f32)>;

    #[inline(always)]
    fn enter(&mut self, _entry: u32, row: u32) {
        let pixel = self.pixels.weight[row as usize];
        let x = (pixel & 0xFFFF).wrapping_sub(self.rect.x0);
        let y = (pixel >> 16).wrapping_sub(self.rect.y0);
        let inside = pixel != NONE && x < self.rect.width && y < self.rect.height;
        self.at = TILE * TILE;
        if inside {
            self.at = y as usize * TILE + x as usize;
        }
    }

    #[inline(always)]
    fn span(&mut self, _entry: u32, row: u32, span: Span<'_>) {
        let at = self.at.wrapping_sub(span.at);
        if let Some(&weight) = span.weights.get(at)
            && weight > 0.0
        {
            self.weights.push((row, weight));
        }
    }

    fn finish(self, _: &[f32; TILE * TILE], _: &[u32; TILE * TILE]) -> Self::Output {
        self.weights
    }
}

//! What the pixel loop can make: colour, depth, features, weights. Visitors combine as pairs.

use crate::canvas::CanvasTile;
use crate::{Span, TILE, TileVisitor};

/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;

/// Makes nothing.
pub(crate) struct Nothing;

impl TileVisitor for Nothing {
    type Output = ();
    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, _: u32, _: u32, _: Span<'_>) {}
    #[inline(always)]
    fn finish(self, _: &[f32; PIXELS], _: &[u32; PIXELS]) {}
}

impl<A: TileVisitor, B: TileVisitor> TileVisitor for (A, B) {
    type Output = (A::Output, B::Output);
    const LAST: bool = A::LAST || B::LAST;
    #[inline(always)]
    fn enter(&mut self, entry: u32, row: u32) {
        self.0.enter(entry, row);
        self.1.enter(entry, row);
    }
    #[inline(always)]
    fn span(&mut self, entry: u32, row: u32, y: u32, x: u32, span: Span<'_>) {
        self.0.span(entry, row, y, x, span);
        self.1.span(entry, row, y, x, span);
    }
    #[inline(always)]
    fn leave(&mut self, entry: u32, row: u32) {
        self.0.leave(entry, row);
        self.1.leave(entry, row);
    }
    #[inline(always)]
    fn finish(self, transmittance: &[f32; PIXELS], last: &[u32; PIXELS]) -> Self::Output {
        (self.0.finish(transmittance, last), self.1.finish(transmittance, last))
    }
}

/// Colour, `Σ w c` and what is left of the background.
pub(crate) struct Colour<'a> {
    colours: &'a [[f32; 3]],
    background: Option<[f32; 3]>,
    sums: [[f32; PIXELS]; 3],
    target: CanvasTile<'a>,
    y0: u32,
}

impl<'a> Colour<'a> {
    pub(crate) fn new(
        colours: &'a [[f32; 3]],
        background: Option<[f32; 3]>,
        target: CanvasTile<'a>,
    ) -> Self {
        let y0 = target.rect().y0;
        Self { colours, background, sums: [[0.0; PIXELS]; 3], target, y0 }
    }
}

impl TileVisitor for Colour<'_> {
    type Output = ();

    #[inline(always)]
    fn span(&mut self, _: u32, row: u32, y: u32, _: u32, span: Span<'_>) {
        let colour = self.colours[row as usize];
        let line = (y - self.y0) as usize * TILE;
        for k in 0..3 {
            let sums = &mut self.sums[k][line..line + TILE];
            for x in 0..TILE {
                sums[x] += span.weights[x] * colour[k];
            }
        }
    }

    fn finish(mut self, transmittance: &[f32; PIXELS], _: &[u32; PIXELS]) {
        let rect = self.target.rect();
        for r in 0..rect.height as usize {
            let out = self.target.row(r);
            for (x, pixel) in out.chunks_exact_mut(3).enumerate() {
                let at = r * TILE + x;
                for k in 0..3 {
                    let behind = self.background.map_or(0.0, |b| transmittance[at] * b[k]);
                    pixel[k] = self.sums[k][at] + behind;
                }
            }
        }
    }
}

/// Depth: `Σ w z`, or the depth at which half of the light is gone.
pub(crate) struct Depth<'a, const MEDIAN: bool> {
    depth: &'a [f32],
    values: [f32; PIXELS],
    target: CanvasTile<'a>,
    y0: u32,
}

impl<'a, const MEDIAN: bool> Depth<'a, MEDIAN> {
    pub(crate) fn new(depth: &'a [f32], target: CanvasTile<'a>) -> Self {
        let y0 = target.rect().y0;
        Self { depth, values: [0.0; PIXELS], target, y0 }
    }
}

impl<const MEDIAN: bool> TileVisitor for Depth<'_, MEDIAN> {
    type Output = ();

    #[inline(always)]
    fn span(&mut self, _: u32, row: u32, y: u32, _: u32, span: Span<'_>) {
        let z = self.depth[row as usize];
        let line = (y - self.y0) as usize * TILE;
        let values = &mut self.values[line..line + TILE];
        for x in 0..TILE {
            if MEDIAN {
                let takes = span.weights[x] > 0.0 && span.before[x] > 0.5;
                values[x] = if takes { z } else { values[x] };
            } else {
                values[x] += span.weights[x] * z;
            }
        }
    }

    fn finish(mut self, _: &[f32; PIXELS], _: &[u32; PIXELS]) {
        for r in 0..self.target.rect().height as usize {
            let out = self.target.row(r);
            out.copy_from_slice(&self.values[r * TILE..r * TILE + out.len()]);
        }
    }
}

/// Writes the transmittance, and gives back the last list positions if asked to.
pub(crate) struct Transmittance<'a, const LAST: bool> {
    target: CanvasTile<'a>,
}

impl<'a, const LAST: bool> Transmittance<'a, LAST> {
    pub(crate) fn new(target: CanvasTile<'a>) -> Self {
        Self { target }
    }
}

impl<const LAST: bool> TileVisitor for Transmittance<'_, LAST> {
    type Output = Vec<u32>;
    const LAST: bool = LAST;

    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, _: u32, _: u32, _: Span<'_>) {}

    fn finish(mut self, transmittance: &[f32; PIXELS], last: &[u32; PIXELS]) -> Vec<u32> {
        for r in 0..self.target.rect().height as usize {
            let out = self.target.row(r);
            out.copy_from_slice(&transmittance[r * TILE..r * TILE + out.len()]);
        }
        if LAST { last.to_vec() } else { Vec::new() }
    }
}

/// Sum, maximum and number of the weights of each entry of the tile's list.
pub(crate) struct Weights {
    entries: Vec<(f32, f32, u32)>,
}

impl Weights {
    pub(crate) fn new(entries: usize) -> Self {
        Self { entries: vec![(0.0, 0.0, 0); entries] }
    }
}

impl TileVisitor for Weights {
    type Output = Vec<(f32, f32, u32)>;

    #[inline(always)]
    fn span(&mut self, entry: u32, _: u32, _: u32, _: u32, span: Span<'_>) {
        let (sum, max, count) = &mut self.entries[entry as usize];
        for &w in span.weights {
            *sum += w;
            *max = max.max(w);
            *count += u32::from(w > 0.0);
        }
    }

    fn finish(self, _: &[f32; PIXELS], _: &[u32; PIXELS]) -> Self::Output {
        self.entries
    }
}

/// `Σ w f` of any number of channels.
pub(crate) struct Features<'a> {
    features: &'a [f32],
    index: &'a [u32],
    dim: usize,
    target: CanvasTile<'a>,
}

impl<'a> Features<'a> {
    pub(crate) fn new(
        features: &'a [f32],
        index: &'a [u32],
        dim: usize,
        target: CanvasTile<'a>,
    ) -> Self {
        Self { features, index, dim, target }
    }
}

impl TileVisitor for Features<'_> {
    type Output = ();

    #[inline(always)]
    fn span(&mut self, _: u32, row: u32, y: u32, _: u32, span: Span<'_>) {
        let start = self.index[row as usize] as usize * self.dim;
        let feature = &self.features[start..start + self.dim];
        let line = (y - self.target.rect().y0) as usize;
        let pixels = self.target.row(line).chunks_exact_mut(self.dim);
        for (pixel, &w) in pixels.zip(span.weights) {
            if w > 0.0 {
                for (p, f) in pixel.iter_mut().zip(feature) {
                    *p += w * f;
                }
            }
        }
    }

    fn finish(self, _: &[f32; PIXELS], _: &[u32; PIXELS]) {}
}

//! What the pixel loop can make: color, depth, features, weights. Visitors combine as pairs.

use crate::blend::prefetch;
use crate::canvas::CanvasTile;
use crate::lanes::{Lanes, OnLanes, on_lanes};
use crate::splats::Aligned;
use crate::{SPAN, Span, TILE, TileVisitor};
use scenesplat_kernels::simd::Isa;

/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;

/// Makes nothing.
pub(crate) struct Nothing;

impl TileVisitor for Nothing {
    type Output = ();
    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, _: Span<'_>) {}
    #[inline(always)]
    fn finish(self, _: &[f32; PIXELS], _: &[u32; PIXELS]) {}
}

impl<A: TileVisitor, B: TileVisitor> TileVisitor for (A, B) {
    type Output = (A::Output, B::Output);
    const LAST: bool = A::LAST || B::LAST;
    const STOP_TRANSMITTANCE: f32 = if A::STOP_TRANSMITTANCE < B::STOP_TRANSMITTANCE {
        A::STOP_TRANSMITTANCE
    } else {
        B::STOP_TRANSMITTANCE
    };
    #[inline(always)]
    fn prefetch(&self, row: u32) {
        self.0.prefetch(row);
        self.1.prefetch(row);
    }
    #[inline(always)]
    fn enter(&mut self, entry: u32, row: u32) {
        self.0.enter(entry, row);
        self.1.enter(entry, row);
    }
    #[inline(always)]
    fn span(&mut self, entry: u32, row: u32, span: Span<'_>) {
        self.0.span(entry, row, span);
        self.1.span(entry, row, span);
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

/// Color, `Σ w c` and the share of the background.
pub(crate) struct Color<'a> {
    colors: &'a [[f32; 3]],
    background: Option<[f32; 3]>,
    sums: Aligned<[[f32; PIXELS]; 3]>,
    target: CanvasTile<'a>,
}

impl<'a> Color<'a> {
    pub(crate) fn new(
        colors: &'a [[f32; 3]],
        background: Option<[f32; 3]>,
        target: CanvasTile<'a>,
    ) -> Self {
        Self { colors, background, sums: Aligned([[0.0; PIXELS]; 3]), target }
    }
}

impl TileVisitor for Color<'_> {
    type Output = ();

    #[inline(always)]
    fn prefetch(&self, row: u32) {
        // Twelve bytes may be in two cache lines.
        let [r, _, b] = &self.colors[row as usize];
        prefetch(r);
        prefetch(b);
    }

    #[inline(always)]
    fn span(&mut self, _: u32, row: u32, span: Span<'_>) {
        let color = self.colors[row as usize];
        for k in 0..3 {
            let sums = &mut self.sums.0[k][span.at..span.at + span.weights.len()];
            for (sum, weight) in sums.iter_mut().zip(span.weights) {
                *sum += weight * color[k];
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
                    pixel[k] = self.sums.0[k][at] + behind;
                }
            }
        }
    }
}

/// Depth: `Σ w z`, or the depth at which half of the light is gone.
pub(crate) struct Depth<'a, const MEDIAN: bool> {
    depth: &'a [f32],
    values: Aligned<[f32; PIXELS]>,
    target: CanvasTile<'a>,
    isa: Isa,
}

impl<'a, const MEDIAN: bool> Depth<'a, MEDIAN> {
    /// `isa` is [`RasterSettings::isa`](crate::RasterSettings::isa) of what tiles are drawn with.
    pub(crate) fn new(depth: &'a [f32], target: CanvasTile<'a>, isa: Isa) -> Self {
        Self { depth, values: Aligned([0.0; PIXELS]), target, isa }
    }
}

/// Half of the light: what comes behind does not move the median.
const HALF: f32 = 0.5;

/// Depth `z` where a pixel takes the Gaussian with more than half of the light left.
struct Median<'a> {
    values: &'a mut [f32],
    span: Span<'a>,
    z: f32,
}

impl OnLanes for Median<'_> {
    #[inline(always)]
    unsafe fn run<L: Lanes>(self) {
        let Self { values, span, z } = self;
        assert!([values.len(), span.weights.len(), span.before.len()] == [L::COUNT; 3]);
        // SAFETY: the instruction set is the caller's promise, the lengths were checked.
        unsafe {
            let taken = L::load(span.weights.as_ptr()).above(L::splat(0.0));
            let early = L::load(span.before.as_ptr()).above(L::splat(HALF));
            let values = values.as_mut_ptr();
            L::splat(z).or_else(L::both(taken, early), L::load(values)).store(values);
        }
    }
}

impl<const MEDIAN: bool> TileVisitor for Depth<'_, MEDIAN> {
    type Output = ();
    const STOP_TRANSMITTANCE: f32 = if MEDIAN { HALF } else { 0.0 };

    #[inline(always)]
    fn prefetch(&self, row: u32) {
        prefetch(&self.depth[row as usize]);
    }

    #[inline(always)]
    fn span(&mut self, _: u32, row: u32, span: Span<'_>) {
        let z = self.depth[row as usize];
        let values = &mut self.values.0[span.at..span.at + span.weights.len()];
        if MEDIAN {
            // SAFETY: that of the settings.
            unsafe { on_lanes(self.isa, span.weights.len(), Median { values, span, z }) };
        } else {
            for (value, weight) in values.iter_mut().zip(span.weights) {
                *value += weight * z;
            }
        }
    }

    fn finish(mut self, _: &[f32; PIXELS], _: &[u32; PIXELS]) {
        put(&mut self.target, &self.values.0);
    }
}

/// Writes the transmittance.
pub(crate) struct Transmittance<'a> {
    target: CanvasTile<'a>,
}

impl<'a> Transmittance<'a> {
    pub(crate) fn new(target: CanvasTile<'a>) -> Self {
        Self { target }
    }
}

impl TileVisitor for Transmittance<'_> {
    type Output = ();

    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, _: Span<'_>) {}

    fn finish(mut self, transmittance: &[f32; PIXELS], _: &[u32; PIXELS]) {
        put(&mut self.target, transmittance);
    }
}

/// Writes the last list positions.
pub(crate) struct Last<'a> {
    target: CanvasTile<'a, u32>,
}

impl<'a> Last<'a> {
    pub(crate) fn new(target: CanvasTile<'a, u32>) -> Self {
        Self { target }
    }
}

impl TileVisitor for Last<'_> {
    type Output = ();
    const LAST: bool = true;

    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, _: Span<'_>) {}

    fn finish(mut self, _: &[f32; PIXELS], last: &[u32; PIXELS]) {
        put(&mut self.target, last);
    }
}

/// Copies the pixels of a tile that are in the picture.
fn put<T: Copy>(to: &mut CanvasTile<'_, T>, values: &[T; PIXELS]) {
    for r in 0..to.rect().height as usize {
        let out = to.row(r);
        out.copy_from_slice(&values[r * TILE..r * TILE + out.len()]);
    }
}

/// Sum, maximum and number of the weights of each entry of the tile's list.
pub(crate) struct Weights {
    entries: Vec<(f32, f32, u32)>,
    /// Of the Gaussian at hand, per place in a span: sums across one are slow.
    sum: Aligned<[f32; SPAN]>,
    max: Aligned<[f32; SPAN]>,
    count: Aligned<[u32; SPAN]>,
}

impl Weights {
    pub(crate) fn new(entries: usize) -> Self {
        let entries = vec![(0.0, 0.0, 0); entries];
        let (none, zero) = (Aligned([0.0; SPAN]), Aligned([0; SPAN]));
        Self { entries, sum: none, max: none, count: zero }
    }
}

impl TileVisitor for Weights {
    type Output = Vec<(f32, f32, u32)>;

    #[inline(always)]
    fn enter(&mut self, _: u32, _: u32) {
        let none = Aligned([0.0; SPAN]);
        (self.sum, self.max, self.count) = (none, none, Aligned([0; SPAN]));
    }

    #[inline(always)]
    fn span(&mut self, _: u32, _: u32, span: Span<'_>) {
        for (i, &w) in span.weights.iter().enumerate() {
            self.sum.0[i] += w;
            self.max.0[i] = if w > self.max.0[i] { w } else { self.max.0[i] };
            self.count.0[i] += u32::from(w > 0.0);
        }
    }

    #[inline(always)]
    fn leave(&mut self, entry: u32, _: u32) {
        let max = self.max.0.iter().fold(0.0, |m: f32, &v| m.max(v));
        self.entries[entry as usize] = (halves(self.sum.0), max, self.count.0.iter().sum());
    }

    fn finish(self, _: &[f32; PIXELS], _: &[u32; PIXELS]) -> Self::Output {
        self.entries
    }
}

/// The sum, half added to half.
#[inline(always)]
fn halves(mut values: [f32; SPAN]) -> f32 {
    for half in [8, 4, 2, 1] {
        for x in 0..half {
            values[x] += values[x + half];
        }
    }
    values[0]
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
    fn span(&mut self, _: u32, row: u32, span: Span<'_>) {
        let start = self.index[row as usize] as usize * self.dim;
        let feature = &self.features[start..start + self.dim];
        let line = self.target.row(span.at / TILE);
        let pixels = line.chunks_exact_mut(self.dim).skip(span.at % TILE);
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

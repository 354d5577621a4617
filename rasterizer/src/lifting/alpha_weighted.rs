//! Sums of blending weights per Gaussian and segment.

use super::tile_segments::{MAX_BITS, SegmentTuple, TileSegments};
use super::view_weights::DepthBounds;
use crate::splats::Aligned;
use crate::{SPAN, Span, TILE, TileVisitor};

/// How much of a Gaussian a tile shows in one tuple of segments.
#[derive(Debug, Clone, Copy)]
pub(super) struct TileWeight {
    /// Row of the projection.
    pub(super) row: u32,
    /// Number of the tuple in the tile.
    pub(super) tuple: u32,
    pub(super) weight: f32,
}

/// The sums of one tile.
#[derive(Debug, Default)]
pub(super) struct TileSums {
    pub(super) tuples: Vec<SegmentTuple>,
    /// In the order of the tile's list.
    pub(super) weights: Vec<TileWeight>,
}

/// Sums weights by segment while a Gaussian is drawn: sixteen sums per tuple side by side, one
/// masked addition per part of a row.
///
/// With `DEPTH`, weights of pixels whose depth does not agree with the Gaussian's go to the first
/// tuple, which is nowhere.
pub(super) struct AlphaWeighted<'a, const DEPTH: bool> {
    segments: TileSegments,
    sums: Vec<Aligned<[f32; SPAN]>>,
    weights: Vec<TileWeight>,
    /// Tuples that the Gaussian at hand met, as bits.
    met: u64,
    /// First and last row drawn of it, for a tile with more tuples than bits.
    rows: (usize, usize),
    /// Depths of the Gaussians, by row of the projection.
    depth: &'a [f32],
    bounds: Option<Box<DepthBounds>>,
    z: f32,
}

impl<'a, const DEPTH: bool> AlphaWeighted<'a, DEPTH> {
    /// With room for `expected` sums.
    pub(super) fn new(
        segments: TileSegments,
        expected: usize,
        depth: &'a [f32],
        bounds: Option<Box<DepthBounds>>,
    ) -> Self {
        Self {
            sums: vec![Aligned([0.0; SPAN]); segments.tuples.len()],
            segments,
            weights: Vec::with_capacity(expected),
            met: 0,
            rows: (usize::MAX, 0),
            depth,
            bounds,
            z: 0.0,
        }
    }
}

impl<const DEPTH: bool> TileVisitor for AlphaWeighted<'_, DEPTH> {
    type Output = TileSums;

    #[inline(always)]
    fn enter(&mut self, _entry: u32, row: u32) {
        self.met = 0;
        self.rows = (usize::MAX, 0);
        if DEPTH {
            self.z = self.depth[row as usize];
        }
    }

    #[inline(always)]
    fn span(&mut self, _entry: u32, _row: u32, span: Span<'_>) {
        let (r, x) = (span.at / TILE, span.at % TILE);
        let count = span.weights.len();
        if !DEPTH && self.segments.tuples.len() == 1 {
            // Most tiles: every pixel of the picture is in the one tuple, and the others weigh 0.
            self.met = 1;
            self.rows = (0, 0);
            for (sum, weight) in self.sums[0].0.iter_mut().zip(span.weights) {
                *sum += weight;
            }
            return;
        }
        self.rows = (self.rows.0.min(r), r);
        let mut agreeing = [0.0; SPAN];
        let mut weights = span.weights;
        if DEPTH && let Some(bounds) = &self.bounds {
            let (low, high) = (&bounds.low[r][x..x + count], &bounds.high[r][x..x + count]);
            let nowhere = &mut self.sums[0].0;
            for i in 0..count {
                let agrees = self.z >= low[i] && self.z <= high[i];
                nowhere[i] += if agrees { 0.0 } else { weights[i] };
                agreeing[i] = if agrees { weights[i] } else { 0.0 };
            }
            weights = &agreeing[..count];
        }
        self.met |= self.segments.bits[r];
        let parts = self.segments.starts[r] as usize..self.segments.starts[r + 1] as usize;
        for part in &self.segments.parts[parts] {
            let sum = &mut self.sums[part.tuple as usize].0;
            let mask = &part.mask.0[x..x + count];
            for i in 0..count {
                sum[i] += weights[i] * mask[i];
            }
        }
    }

    #[inline(always)]
    fn leave(&mut self, _entry: u32, row: u32) {
        let (first, last) = self.rows;
        if first > last {
            return;
        }
        let mut flush = |tuple: u32| {
            let weight = add_up(&mut self.sums[tuple as usize].0);
            if weight > 0.0 {
                self.weights.push(TileWeight { row, tuple, weight });
            }
        };
        if DEPTH {
            flush(0);
        }
        if self.segments.tuples.len() <= MAX_BITS {
            let mut left = self.met;
            while left != 0 {
                flush(left.trailing_zeros());
                left &= left - 1;
            }
            return;
        }
        let starts = &self.segments.starts;
        // A tuple of several rows is met again, with nothing left of it.
        for part in starts[first]..starts[last + 1] {
            flush(self.segments.parts[part as usize].tuple);
        }
    }

    fn finish(self, _: &[f32; TILE * TILE], _: &[u32; TILE * TILE]) -> TileSums {
        TileSums { tuples: self.segments.tuples, weights: self.weights }
    }
}

/// The sum of sixteen sums, which are 0 afterwards.
#[inline(always)]
fn add_up(sums: &mut [f32; SPAN]) -> f32 {
    let mut half = [0.0; SPAN / 2];
    for i in 0..SPAN / 2 {
        half[i] = sums[i] + sums[i + SPAN / 2];
    }
    *sums = [0.0; SPAN];
    let quarter = [half[0] + half[4], half[1] + half[5], half[2] + half[6], half[3] + half[7]];
    (quarter[0] + quarter[2]) + (quarter[1] + quarter[3])
}

//! Sums of blending weights per Gaussian and segment.

use super::tile_segments::{MAX_BITS, SegmentTuple, TileSegments};
use crate::lanes::{Lanes, OnLanes, on_lanes};
use crate::splats::Aligned;
use crate::{SPAN, Span, TILE, TileVisitor};
use scenesplat_kernels::simd::Isa;

/// The depths of one tile, row by row; NaN where there is none, which agrees with nothing.
pub(super) type TileDepths = [[f32; TILE]; TILE];

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
    /// Least and largest depth that agrees with each Gaussian, by row of the projection.
    ranges: &'a [[f32; 2]],
    depths: Option<Box<TileDepths>>,
    /// Those of the Gaussian at hand.
    range: [f32; 2],
    isa: Isa,
}

impl<'a, const DEPTH: bool> AlphaWeighted<'a, DEPTH> {
    /// With room for `expected` sums; `isa` is
    /// [`RasterSettings::isa`](crate::RasterSettings::isa) of what tiles are drawn with.
    pub(super) fn new(
        segments: TileSegments,
        expected: usize,
        ranges: &'a [[f32; 2]],
        depths: Option<Box<TileDepths>>,
        isa: Isa,
    ) -> Self {
        Self {
            sums: vec![Aligned([0.0; SPAN]); segments.tuples.len()],
            segments,
            weights: Vec::with_capacity(expected),
            met: 0,
            rows: (usize::MAX, 0),
            ranges,
            depths,
            range: [0.0; 2],
            isa,
        }
    }
}

/// A span of a Gaussian for its sums.
struct Add<'a, 'b, const DEPTH: bool> {
    to: &'a mut AlphaWeighted<'b, DEPTH>,
    row: usize,
    column: usize,
    weights: &'a [f32],
}

impl<const DEPTH: bool> OnLanes for Add<'_, '_, DEPTH> {
    #[inline(always)]
    unsafe fn run<L: Lanes>(self) {
        let Self { to, row, column, weights } = self;
        assert!(weights.len() == L::COUNT && row < TILE && column + L::COUNT <= TILE);
        // SAFETY: the instruction set is the caller's promise; the lengths were checked, sums are
        // as long as the longest register.
        unsafe {
            let mut weights = L::load(weights.as_ptr());
            if DEPTH && let Some(depths) = &to.depths {
                let depths = L::load(depths[row].as_ptr().add(column));
                let [least, largest] = to.range.map(|d| L::splat(d));
                let agrees = L::both(depths.at_least(least), largest.at_least(depths));
                let agreeing = weights.keep(agrees);
                let nowhere = to.sums[0].0.as_mut_ptr();
                weights.sub(agreeing).add(L::load(nowhere)).store(nowhere);
                weights = agreeing;
            }
            let starts = &to.segments.starts;
            for part in &to.segments.parts[starts[row] as usize..starts[row + 1] as usize] {
                let sum = to.sums[part.tuple as usize].0.as_mut_ptr();
                let mask = L::load(part.mask.0.as_ptr().add(column));
                // The mask is 0 or 1: fused or not, it is the same sum.
                weights.fma(mask, L::load(sum)).store(sum);
            }
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
            self.range = self.ranges[row as usize];
        }
    }

    #[inline(always)]
    fn span(&mut self, _entry: u32, _row: u32, span: Span<'_>) {
        let (r, x) = (span.at / TILE, span.at % TILE);
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
        self.met |= self.segments.bits[r];
        let isa = self.isa;
        let add = Add { to: self, row: r, column: x, weights: span.weights };
        // SAFETY: that of the settings.
        unsafe { on_lanes(isa, span.weights.len(), add) };
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

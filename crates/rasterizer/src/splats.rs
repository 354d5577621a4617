//! What the pixel loops read of a Gaussian, and which pixels of a tile it can reach.

use crate::lanes::LANES;
use crate::{Projected, TILE, TileRect};
use rayon::prelude::*;
use std::f32::consts::LOG2_E;

/// Numbers of the columns.
pub(crate) const COLUMNS: [f32; TILE] =
    [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// Rows of a tile, and as many more as a block of rows may go beyond it.
const ROWS: usize = TILE + LANES;
/// Room for groups: a power of two, so that places in it cost no comparison.
const ROOM: usize = 64;

/// What the pixel loops read of one Gaussian.
///
/// The exponent of α is a sum of two squares, `½ a (dx + b/a dy)² + ½ dy²/Σᵧᵧ`, which is the conic's
/// form without its cancellation: a needle has `a dx²` and `c dy²` far larger than their sum with
/// `2 b dx dy`.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(32))]
pub(crate) struct Splat<const C: usize> {
    /// Center. px, first of the picture, then from the center of a tile's first pixel
    pub u: f32,
    pub v: f32,
    /// `b/a`: how far the middle of a row of the ellipse moves per row. px
    slope: f32,
    /// `−½ a` and `−½/Σᵧᵧ`, times `log₂ e`: the exponent is one of 2.
    pub across: f32,
    down: f32,
    log_opacity: f32,
    /// Square of half the width of the ellipse at the center, and what a row at distance 1 has less.
    /// px²
    wide: f32,
    narrow: f32,
    /// Its channels.
    pub values: [f32; C],
}

impl<const C: usize> Splat<C> {
    /// All visible Gaussians; `values` gives their channels.
    pub(crate) fn all(
        projected: &Projected,
        values: impl Fn(usize) -> [f32; C] + Sync,
    ) -> Vec<Self> {
        let mut out = Vec::new();
        Self::put_all(projected, values, &mut out);
        out
    }

    /// [`all`](Self::all) into memory that is used again.
    pub(crate) fn put_all(
        projected: &Projected,
        values: impl Fn(usize) -> [f32; C] + Sync,
        out: &mut Vec<Self>,
    ) {
        let one = |row: usize| {
            let [a, b, _] = projected.conic[row];
            let variance = projected.variance[row][1];
            // Wider than the cut by more than f32 can be wrong.
            let level = projected.level[row] * (1.0 + 1e-4) + 1e-4;
            Self {
                u: projected.mean2d[row][0],
                v: projected.mean2d[row][1],
                slope: b / a,
                across: -0.5 * LOG2_E * a,
                down: -0.5 * LOG2_E / variance,
                log_opacity: projected.opacity[row].log2(),
                wide: level / a,
                narrow: 1.0 / (variance * a),
                values: values(row),
            }
        };
        (0..projected.len()).into_par_iter().with_min_len(4096).map(one).collect_into_vec(out);
    }

    /// With the center as seen from a tile.
    #[inline(always)]
    pub(crate) fn seen_from(mut self, rect: TileRect) -> Self {
        self.u -= rect.x0 as f32 + 0.5;
        self.v -= rect.y0 as f32 + 0.5;
        self
    }
}

/// Groups of pixels of a tile that a Gaussian can reach, one after the other, and what all pixels of
/// a row have in common.
///
/// A group is as wide as a register: a row, or eight pixels anywhere in one; no pixel is in two.
pub(crate) struct Groups {
    /// Rows to come, as bits, where a group is a row.
    rows: u32,
    /// Number of the first pixel of each group of eight: at most two a row, and room for one more.
    first: [u8; ROOM],
    len: usize,
    next: usize,
    /// Distance along y from each row to the center. px
    pub dy: [f32; ROWS],
    /// Column of the middle of the ellipse in each row. px
    pub middle: [f32; ROWS],
    /// Exponent of α there.
    pub top: [f32; ROWS],
}

impl Groups {
    /// None; one for all Gaussians of a tile, since clearing it costs as much as filling it.
    pub(crate) fn new() -> Self {
        let none = [0.0; ROWS];
        let first = [0; ROOM];
        Self { rows: 0, first, len: 0, next: 0, dy: none, middle: none, top: none }
    }

    /// Finds the groups of `lanes` pixels that cover all that can be above the cut, and a few more,
    /// in the rows whose bits are set, of the lowest 16. The Gaussian is
    /// [seen from](Splat::seen_from) the tile.
    #[inline(always)]
    pub(crate) fn find<const C: usize>(&mut self, splat: &Splat<C>, rows: u32, lanes: usize) {
        if lanes == TILE {
            self.share::<C, TILE>(splat, 0);
            self.rows = rows;
            return;
        }
        (self.len, self.next) = (0, 0);
        let mut left = rows;
        while left != 0 {
            // As many rows as a register has lanes, be they of the tile or not.
            let row = left.trailing_zeros() as usize % TILE;
            self.share::<C, LANES>(splat, row);
            self.spans(splat, row, left);
            left &= !(((1 << LANES) - 1) << row);
        }
    }

    /// What the pixels of `N` rows share, from `row` on.
    #[inline(always)]
    fn share<const C: usize, const N: usize>(&mut self, splat: &Splat<C>, row: usize) {
        let numbers = numbers_from::<N>(row);
        let (mut dy, mut middle, mut top) = ([0.0; N], [0.0; N], [0.0; N]);
        for k in 0..N {
            dy[k] = splat.v - numbers[k];
            middle[k] = splat.u + splat.slope * dy[k];
            top[k] = splat.log_opacity + splat.down * dy[k] * dy[k];
        }
        self.dy[row..row + N].copy_from_slice(&dy);
        self.middle[row..row + N].copy_from_slice(&middle);
        self.top[row..row + N].copy_from_slice(&top);
    }

    /// Adds groups of eight pixels that cover the ellipse in eight rows, of those in `wanted`.
    #[inline(always)]
    fn spans<const C: usize>(&mut self, splat: &Splat<C>, row: usize, wanted: u32) {
        let numbers = numbers_from::<LANES>(row);
        let (mut first, mut count) = ([0i32; LANES], [0i32; LANES]);
        for k in 0..LANES {
            let (dy, middle) = (self.dy[row + k], self.middle[row + k]);
            let squared = splat.wide - dy * dy * splat.narrow;
            let half = if squared > 0.0 { squared.sqrt() } else { -1e9 };
            let shift = middle - splat.u;
            let margin = 1e-3 + 1e-6 * (splat.u.abs() + shift.abs() + half.abs());
            let begin = (middle - half - margin).ceil().max(0.0).min(TILE as f32);
            let end = (middle + half + margin).floor().min(TILE as f32 - 1.0).max(-1.0);
            let across = end - begin + 1.0;
            // One group inside the row, or both of the row.
            let one = across <= LANES as f32;
            let x = if one { begin.min((TILE - LANES) as f32) } else { 0.0 };
            let some = if one { 1.0f32 } else { 2.0 };
            let some = if across > 0.0 { some } else { 0.0 };
            // SAFETY: both are whole numbers below 400, whatever the Gaussian is: `max` and `min`
            // leave no NaN.
            unsafe {
                first[k] = (x + TILE as f32 * numbers[k]).to_int_unchecked();
                count[k] = some.to_int_unchecked();
            }
        }
        let mut len = self.len;
        for k in 0..LANES {
            let at = first[k] as u8;
            self.first[len % ROOM] = at;
            // Overwritten if the row has no second one.
            self.first[(len + 1) % ROOM] = at.wrapping_add(LANES as u8);
            len += (wanted >> (row + k) & 1) as usize * count[k] as usize;
        }
        self.len = len;
    }

    /// First pixel of the next group of `lanes` pixels.
    #[inline(always)]
    pub(crate) fn next(&mut self, lanes: usize) -> Option<usize> {
        if lanes == TILE {
            let row = (self.rows != 0).then(|| self.rows.trailing_zeros() as usize % TILE)?;
            self.rows &= self.rows - 1;
            return Some(row * TILE);
        }
        let at = (self.next < self.len).then(|| self.first[self.next % ROOM])?;
        self.next += 1;
        Some(usize::from(at))
    }
}

/// The numbers `row, row + 1, …`.
#[inline(always)]
fn numbers_from<const N: usize>(row: usize) -> &'static [f32; N] {
    const NUMBERS: [f32; ROWS] = {
        let mut numbers = [0.0; ROWS];
        let mut i = 0;
        while i < ROWS {
            numbers[i] = i as f32;
            i += 1;
        }
        numbers
    };
    let tail: &'static [f32] = &NUMBERS[row..];
    tail.first_chunk().unwrap_or(&[0.0; N])
}

/// The rows of [`TileLists::reach`](crate::TileLists::reach) as bits.
#[inline(always)]
pub(crate) fn reached(reach: u8) -> u32 {
    let (first, last) = (reach & 15, reach >> 4);
    (2 << last) - (1 << first)
}

/// What begins with a cache line, so that no row of a tile is in two.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Aligned<T>(pub(crate) T);

/// Asks for a cache line that will be read soon.
#[inline(always)]
pub fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the instruction is part of every x86-64, and a reference is a valid address.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

//! The pixel loop: Gaussians of a tile front to back, each over the rows it reaches.

use crate::lanes::{Lanes, Plain};
pub use crate::splats::prefetch;
use crate::splats::{Aligned, COLUMNS, Groups, Splat, reached};
use crate::{Projected, RasterSettings, TileLists, View};
use rayon::prelude::*;
use scenesplat_kernels::simd::Isa;

/// Side of a tile, pixels.
pub const TILE: usize = 16;
/// Most pixels of a [`Span`].
pub const SPAN: usize = TILE;
/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;

/// Most tiles of a task. Where much of a scene is in few tiles, threads would otherwise wait for the
/// one that has them.
pub(crate) const TILES_PER_TASK: usize = 4;

/// List positions between asking for a Gaussian and reading it: tens of rows of arithmetic, more
/// than memory takes.
const AHEAD: usize = 12;
/// List positions between checks of which rows still have pixels to draw.
const LOOK: usize = 16;

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

/// What one Gaussian does at some pixels side by side: 8 or 16, by the instruction set, and always
/// as many in one tile.
///
/// Pixels that do not take the Gaussian (α below the cut, stopped, outside the picture) have weight
/// exactly 0; their other values mean nothing. Pixels that take it have a weight above 0, unless the
/// light left is so little that it underflows (`stop` 0).
#[derive(Debug, Clone, Copy)]
pub struct Span<'a> {
    /// Number of the first pixel in its tile, 16 per row; all are in one row.
    pub at: usize,
    /// `α T`.
    pub weights: &'a [f32],
    /// `min(alpha_max, o e^(−σ))`: equal to `alpha_max` where the limit was met.
    pub alphas: &'a [f32],
    /// Transmittance `T` before this Gaussian.
    pub before: &'a [f32],
}

/// What is made of the weights of one tile. The pixel loop is compiled for each implementor, so
/// what a visitor does not read is not computed; mark the methods `#[inline(always)]`.
pub trait TileVisitor: Send {
    /// The result of a tile.
    type Output: Send;
    /// Whether [`finish`](Self::finish) needs `last`; it is all 0 otherwise.
    const LAST: bool = false;
    /// The transmittance from which on spans no longer matter to it: rows of a tile whose pixels have
    /// all come down to it may be left out, and what [`finish`](Self::finish) is given with them. 0:
    /// every span matters.
    const STOP_TRANSMITTANCE: f32 = 0.0;

    /// The Gaussian of row `row` of [`Projected`] comes soon: a place to [`prefetch`] what
    /// [`span`](Self::span) reads of it. Rows are in no order in memory, so that each is waited for
    /// otherwise.
    #[inline(always)]
    fn prefetch(&self, _row: u32) {}

    /// A Gaussian begins: list position `entry`, row of [`Projected`] `row`.
    #[inline(always)]
    fn enter(&mut self, _entry: u32, _row: u32) {}

    /// Some pixels of that Gaussian; none comes twice. All weights may be 0.
    fn span(&mut self, entry: u32, row: u32, span: Span<'_>);

    /// The Gaussian has no more pixels in this tile.
    #[inline(always)]
    fn leave(&mut self, _entry: u32, _row: u32) {}

    /// The tile is done. `transmittance` is the light that passes each pixel, 16 per row; `last` the list
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
    blend_in(projected, lists, view, settings, &mut Vec::new(), make)
}

/// [`blend`] with memory that is used again.
pub(crate) fn blend_in<V: TileVisitor>(
    projected: &Projected,
    lists: &TileLists,
    view: &View,
    settings: &RasterSettings,
    splats: &mut Vec<Splat<0>>,
    make: impl Fn(TileRect) -> V + Sync,
) -> Vec<V::Output> {
    let (columns, rows) = view.tiles();
    assert!(
        (lists.columns, lists.rows) == (columns, rows)
            && lists.offsets.len() == columns * rows + 1
            && lists.entries.len() == lists.reach.len(),
        "lists of other tiles than the view's {columns} × {rows}"
    );
    Splat::put_all(projected, |_| [], splats);
    let scene = Blend { splats, lists, settings };
    let tile = |tile: usize| {
        let rect = rect(tile, lists, view);
        blend_tile(&scene, rect, make(rect))
    };
    (0..lists.len()).into_par_iter().with_max_len(TILES_PER_TASK).map(tile).collect()
}

/// Where a tile is.
pub(crate) fn rect(tile: usize, lists: &TileLists, view: &View) -> TileRect {
    let side = TILE as u32;
    let x0 = (tile % lists.columns) as u32 * side;
    let y0 = (tile / lists.columns) as u32 * side;
    let (width, height) = ((view.width - x0).min(side), (view.height - y0).min(side));
    TileRect { tile, x0, y0, width, height }
}

/// One tile with the instruction set of the settings.
fn blend_tile<V: TileVisitor>(scene: &Blend<'_>, rect: TileRect, visitor: V) -> V::Output {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx2,fma")]
    unsafe fn avx512<V: TileVisitor>(s: &Blend<'_>, r: TileRect, v: V) -> V::Output {
        // SAFETY: the instruction set is enabled here, and the caller found it.
        unsafe { run::<std::arch::x86_64::__m512, V>(s, r, v) }
    }
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn avx2<V: TileVisitor>(s: &Blend<'_>, r: TileRect, v: V) -> V::Output {
        // SAFETY: as above.
        unsafe { run::<std::arch::x86_64::__m256, V>(s, r, v) }
    }
    #[cfg(target_arch = "x86_64")]
    match scene.settings.isa() {
        // SAFETY: `RasterSettings::isa` names no more than the CPU has.
        isa if isa >= Isa::Avx512 => return unsafe { avx512(scene, rect, visitor) },
        // SAFETY: as above; AVX2 and FMA are part of every set above portable.
        isa if isa >= Isa::Avx2 => return unsafe { avx2(scene, rect, visitor) },
        _ => {}
    }
    // SAFETY: plain Rust.
    unsafe { run::<Plain, V>(scene, rect, visitor) }
}

/// What all tiles share.
struct Blend<'a> {
    splats: &'a [Splat<0>],
    lists: &'a TileLists,
    settings: &'a RasterSettings,
}

/// The transmittance of the pixels of one tile, 16 per row; below 0 where a pixel has stopped. A sign
/// instead of a branch: which pixels stop cannot be foreseen.
struct Pixels(Aligned<[f32; PIXELS]>);

impl Pixels {
    /// 0 outside the picture, where no Gaussian is taken then.
    fn new(rect: TileRect) -> Self {
        let mut pixels = Self(Aligned([0.0; PIXELS]));
        for row in pixels.0.0.chunks_exact_mut(TILE).take(rect.height as usize) {
            row[..rect.width as usize].fill(1.0);
        }
        pixels
    }

    /// Bit per row: whether more than `enough` light is left at a pixel of it that goes on.
    ///
    /// # Safety
    /// The CPU has the instruction set of `L`.
    #[inline(always)]
    unsafe fn live_rows<L: Lanes>(&self, enough: f32) -> u32 {
        let mut rows = 0;
        for (i, pixels) in self.0.0.chunks_exact(L::COUNT).enumerate() {
            // SAFETY: the caller's promise; as many pixels as lanes.
            let live = unsafe { L::bits(L::load(pixels.as_ptr()).above(L::splat(enough))) };
            rows |= u32::from(live != 0) << (i * L::COUNT / TILE);
        }
        rows
    }
}

/// The loop.
///
/// # Safety
/// The CPU has the instruction set of `L`.
#[inline(always)]
unsafe fn run<L: Lanes, V: TileVisitor>(
    scene: &Blend<'_>,
    rect: TileRect,
    mut visitor: V,
) -> V::Output {
    let Blend { splats, lists, settings } = *scene;
    let (begin, end) = (lists.offsets[rect.tile], lists.offsets[rect.tile + 1]);
    let (entries, reach) = (&lists.entries[begin..end], &lists.reach[begin..end]);
    let mut pixels = Pixels::new(rect);
    let mut rows = 0;
    let mut last = Aligned([0.0; PIXELS]);
    let mut groups = Groups::new();
    // SAFETY: the caller's promise; a group is in a row, so in `COLUMNS` from its column on, and
    // checked to be in the tile.
    unsafe {
        let (zero, cut) = (L::splat(0.0), L::splat(settings.alpha_cut));
        let (most, stop) = (L::splat(settings.alpha_max), L::splat(settings.stop_above()));
        for (entry, (&row, &reach)) in entries.iter().zip(reach).enumerate() {
            if let Some(&ahead) = entries.get(entry + AHEAD) {
                prefetch(&splats[ahead as usize]);
                visitor.prefetch(ahead);
            }
            if entry % LOOK == 0 {
                rows = pixels.live_rows::<L>(V::STOP_TRANSMITTANCE);
                if rows == 0 {
                    break;
                }
            }
            let reached = rows & reached(reach);
            if reached == 0 {
                continue;
            }
            let splat = splats[row as usize].seen_from(rect);
            groups.find(&splat, reached, L::COUNT);
            visitor.enter(entry as u32, row);
            let across = L::splat(splat.across);
            while let Some(at) = groups.next(L::COUNT) {
                let (r, x) = (at / TILE, at % TILE);
                assert!(r < TILE && x + L::COUNT <= TILE);
                let dx = L::load(COLUMNS.as_ptr().add(x)).sub(L::splat(groups.middle[r]));
                let full = across.mul(dx).fma(dx, L::splat(groups.top[r])).exp2();
                let alpha = full.min(most);
                let light = pixels.0.0.as_mut_ptr().add(at);
                let signed = L::load(light);
                let before = signed.max(zero);
                let weight = alpha.mul(before);
                let after = before.sub(weight);
                let counts = L::both(full.at_least(cut), signed.above(zero));
                let take = L::both(counts, after.above(stop));
                // Those that count and are not taken stop.
                after.or_else(take, signed.negate(counts)).store(light);
                let mut weights = Aligned([0.0; SPAN]);
                let mut alphas = Aligned([0.0; SPAN]);
                let mut earlier = Aligned([0.0; SPAN]);
                weight.keep(take).store(weights.0.as_mut_ptr());
                alpha.store(alphas.0.as_mut_ptr());
                before.store(earlier.0.as_mut_ptr());
                if V::LAST {
                    // The number's bits: a selection copies them as they are.
                    let (place, last) =
                        (f32::from_bits(entry as u32 + 1), last.0.as_mut_ptr().add(at));
                    L::splat(place).or_else(take, L::load(last)).store(last);
                }
                let [weights, alphas, before] =
                    [&weights.0, &alphas.0, &earlier.0].map(|v| &v[..L::COUNT]);
                visitor.span(entry as u32, row, Span { at, weights, alphas, before });
            }
            visitor.leave(entry as u32, row);
        }
    }
    let mut light = [0.0; PIXELS];
    let mut places = [0; PIXELS];
    for i in 0..PIXELS {
        light[i] = pixels.0.0[i].abs();
        places[i] = last.0[i].to_bits();
    }
    visitor.finish(&light, &places)
}

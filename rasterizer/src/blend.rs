//! The pixel loop: Gaussians of a tile front to back, each over the rows it reaches.

use crate::lanes::{Lanes, Plain};
use crate::{Projected, RasterSettings, TileLists, View};
use rayon::prelude::*;
use scenesplat_kernels::simd::Isa;
use std::f32::consts::LOG2_E;

/// Side of a tile, pixels.
pub const TILE: usize = 16;

/// List positions between asking for a Gaussian and reading it: tens of rows of arithmetic, more
/// than memory takes.
const AHEAD: usize = 4;

/// Numbers of the columns.
const COLUMNS: [f32; TILE] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

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
    let splats = Splat::all(projected);
    let scene = Blend { splats: &splats, lists, settings };
    let tile = |tile: usize| {
        let rect = rect(tile, lists, view);
        blend_tile(&scene, rect, make(rect))
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

/// What the loop reads of one Gaussian; half a cache line.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct Splat {
    mean: [f32; 2],
    /// `−½a, −b, −½c`, times `log₂ e`: the exponent of α is a power of two.
    conic: [f32; 3],
    opacity: f32,
}

impl Splat {
    fn all(projected: &Projected) -> Vec<Self> {
        let one = |i: usize| {
            let [a, b, c] = projected.conic[i];
            let half = -0.5 * LOG2_E;
            let conic = [half * a, -LOG2_E * b, half * c];
            Self { mean: projected.mean2d[i], conic, opacity: projected.opacity[i] }
        };
        (0..projected.len()).into_par_iter().with_min_len(4096).map(one).collect()
    }
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
        unsafe { run::<crate::lanes::Pair, V>(s, r, v) }
    }
    #[cfg(target_arch = "x86_64")]
    match scene.settings.isa() {
        // SAFETY: `RasterSettings::isa` names no more than the CPU has.
        isa if isa >= Isa::Avx512 => return unsafe { avx512(scene, rect, visitor) },
        // SAFETY: as above.
        Isa::Avx2 => return unsafe { avx2(scene, rect, visitor) },
        _ => {}
    }
    // SAFETY: plain Rust.
    unsafe { run::<Plain, V>(scene, rect, visitor) }
}

/// What all tiles share.
struct Blend<'a> {
    splats: &'a [Splat],
    lists: &'a TileLists,
    settings: &'a RasterSettings,
}

/// The pixels of one tile.
struct Pixels {
    /// Transmittance, 0 where the pixel has stopped.
    live: [[f32; TILE]; TILE],
    /// Transmittance of those that have stopped.
    stopped: [[f32; TILE]; TILE],
    /// Bit per row: whether a pixel of it has not stopped.
    rows: u32,
}

impl Pixels {
    fn new(rect: TileRect) -> Self {
        let mut pixels = Self { live: [[0.0; TILE]; TILE], stopped: [[1.0; TILE]; TILE], rows: 0 };
        for row in &mut pixels.live[..rect.height as usize] {
            row[..rect.width as usize].fill(1.0);
        }
        pixels.rows = (1 << rect.height) - 1;
        pixels
    }

    /// Takes pixels of a row out of the loop.
    #[cold]
    #[inline(never)]
    fn stop(&mut self, row: usize, bits: u32) {
        for x in (0..TILE).filter(|x| bits >> x & 1 == 1) {
            self.stopped[row][x] = std::mem::take(&mut self.live[row][x]);
        }
        if self.live[row] == [0.0; TILE] {
            self.rows &= !(1 << row);
        }
    }

    /// The transmittance, stopped or not.
    fn transmittance(&self) -> [f32; TILE * TILE] {
        std::array::from_fn(|i| {
            let (live, stopped) = (self.live[i / TILE][i % TILE], self.stopped[i / TILE][i % TILE]);
            if live > 0.0 { live } else { stopped }
        })
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
    let corner = [rect.x0 as f32 + 0.5, rect.y0 as f32 + 0.5];
    let mut pixels = Pixels::new(rect);
    let mut last = [0u32; TILE * TILE];
    // SAFETY: the caller's promise.
    unsafe {
        let columns = L::load(&COLUMNS);
        let (zero, cut) = (L::splat(0.0), L::splat(settings.alpha_cut));
        let (most, stop) = (L::splat(settings.alpha_max), L::splat(settings.stop_above()));
        for (entry, (&row, &reach)) in entries.iter().zip(reach).enumerate() {
            if let Some(&ahead) = entries.get(entry + AHEAD) {
                prefetch(&splats[ahead as usize]);
            }
            let mut rows = pixels.rows & reached(reach);
            if rows == 0 {
                if pixels.rows == 0 {
                    break;
                }
                continue;
            }
            let splat = splats[row as usize];
            let dx = L::splat(splat.mean[0] - corner[0]).sub(columns);
            let along = L::splat(splat.conic[0]).mul(dx).mul(dx);
            let opacity = L::splat(splat.opacity);
            visitor.enter(entry as u32, row);
            while rows != 0 {
                let r = rows.trailing_zeros() as usize;
                rows &= rows - 1;
                let dy = splat.mean[1] - (corner[1] + r as f32);
                let flat = along.add(L::splat(splat.conic[2] * dy * dy));
                let power = zero.min(dx.fma(L::splat(splat.conic[1] * dy), flat));
                let full = opacity.mul(power.exp2());
                let alpha = full.min(most);
                let before = L::load(&pixels.live[r]);
                let weight = alpha.mul(before);
                let after = before.sub(weight);
                let counts = full.ge(cut);
                let take = L::and(counts, after.gt(stop));
                let ends = L::bits(L::and_not(L::and(counts, before.gt(zero)), take));
                if L::bits(take) != 0 {
                    L::select(take, after, before).store(&mut pixels.live[r]);
                    let mut span = Stored::default();
                    L::select(take, weight, zero).store(&mut span.weights);
                    alpha.store(&mut span.alphas);
                    before.store(&mut span.before);
                    if V::LAST {
                        for x in 0..TILE {
                            let at = &mut last[r * TILE + x];
                            *at = if span.weights[x] > 0.0 { entry as u32 + 1 } else { *at };
                        }
                    }
                    let Stored { weights, alphas, before } = &span;
                    let span = Span { weights, alphas, before };
                    visitor.span(entry as u32, row, rect.y0 + r as u32, rect.x0, span);
                }
                if ends != 0 {
                    pixels.stop(r, ends);
                }
            }
            visitor.leave(entry as u32, row);
        }
    }
    visitor.finish(&pixels.transmittance(), &last)
}

/// What a span borrows.
#[derive(Default)]
#[repr(align(64))]
struct Stored {
    weights: [f32; TILE],
    alphas: [f32; TILE],
    before: [f32; TILE],
}

/// The rows of [`TileLists::reach`] as bits.
#[inline(always)]
fn reached(reach: u8) -> u32 {
    let (first, last) = (reach & 15, reach >> 4);
    (2 << last) - (1 << first)
}

/// Asks for a cache line that will be read soon.
#[inline(always)]
fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the instruction is part of every x86-64, and a reference is a valid address.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

//! The pixels of one tile, back to front: gradients of every Gaussian in its list.
//!
//! All channels of a pixel enter the derivative of α only through their product with the upstream
//! gradient, so a pixel keeps two numbers: its transmittance `T`, and what is behind, `R`, in units
//! of the loss. With `s = Σ_c f_c v_c` of a Gaussian, walking backwards,
//!
//! ```text
//! T ← T / (1 − α);   ∂/∂α = T s − R / (1 − α);   R ← R + α T s
//! ```
//!
//! where `R` starts as `T_final (Σ_c background_c v_c − v_alpha)`. Position and shape of a Gaussian
//! then need six sums over its pixels of `p = ∂/∂σ`: `p, p dx, p dx², p dy, p dx dy, p dy²`.

use super::lanes::{LANES, Lanes};
use crate::{Projected, RasterSettings, TILE, TileRect};
use rayon::prelude::*;
use scenesplat_kernels::simd::Isa;
use std::f32::consts::LOG2_E;

/// Pixels of a tile.
pub(crate) const PIXELS: usize = TILE * TILE;
/// Number of the sums named above.
pub(crate) const MOMENTS: usize = 6;

/// What a tile reads. `C` channels: colour, depth, both or none.
pub(crate) struct Tile<'a, const C: usize> {
    pub rect: TileRect,
    pub entries: &'a [u32],
    pub reach: &'a [u8],
    /// Visible Gaussians.
    pub splats: &'a [Splat<C>],
    pub settings: &'a RasterSettings,
}

/// The state of a tile's pixels, 16 per row.
pub(crate) struct Pixels<const C: usize> {
    /// `T`, of what has been walked over.
    pub transmittance: [f32; PIXELS],
    /// `R`.
    pub behind: [f32; PIXELS],
    /// Upstream gradient of each channel.
    pub gradient: [[f32; PIXELS]; C],
    /// List position + 1 of the last Gaussian of the pixel, 0 for none: exact below 2²⁴.
    pub last: [f32; PIXELS],
}

/// Walks over a tile. `out` has a record per entry, zeros at the start: the six sums (if `K` has
/// room for them), then the gradient of each channel.
pub(crate) fn walk<const C: usize, const K: usize>(
    tile: &Tile<'_, C>,
    pixels: &mut Pixels<C>,
    out: &mut [[f32; K]],
) {
    const { assert!(K == C || K == C + MOMENTS) };
    assert!(tile.entries.len() == out.len() && tile.reach.len() == out.len());
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
        unsafe fn avx512<const C: usize, const K: usize>(
            tile: &Tile<'_, C>,
            pixels: &mut Pixels<C>,
            out: &mut [[f32; K]],
        ) {
            // SAFETY: the features are enabled here.
            unsafe { walk_with::<std::arch::x86_64::__m256, C, K>(tile, pixels, out) }
        }
        #[target_feature(enable = "avx2,fma")]
        unsafe fn avx2<const C: usize, const K: usize>(
            tile: &Tile<'_, C>,
            pixels: &mut Pixels<C>,
            out: &mut [[f32; K]],
        ) {
            // SAFETY: as above.
            unsafe { walk_with::<std::arch::x86_64::__m256, C, K>(tile, pixels, out) }
        }
        let isa = tile.settings.isa();
        if isa >= Isa::Avx512 && is_x86_feature_detected!("avx512vl") {
            // SAFETY: just detected; AVX2 and FMA are part of every set above portable.
            return unsafe { avx512(tile, pixels, out) };
        }
        if isa >= Isa::Avx2 {
            // SAFETY: as above.
            return unsafe { avx2(tile, pixels, out) };
        }
    }
    // SAFETY: plain Rust.
    unsafe { walk_with::<super::lanes::Plain, C, K>(tile, pixels, out) }
}

#[inline(always)]
unsafe fn walk_with<V: Lanes, const C: usize, const K: usize>(
    tile: &Tile<'_, C>,
    pixels: &mut Pixels<C>,
    out: &mut [[f32; K]],
) {
    let (row_last, end) = row_last(&pixels.last);
    for entry in (0..end.min(out.len())).rev() {
        if entry >= AHEAD {
            prefetch(&tile.splats[tile.entries[entry - AHEAD] as usize]);
        }
        let splat = tile.splats[tile.entries[entry] as usize].seen_from(tile.rect);
        let mut sums = Sums::<V, C> {
            // SAFETY: the caller has made sure of the instruction set, here and below.
            moments: unsafe { [V::splat(0.0); MOMENTS] },
            // SAFETY: as above.
            channels: unsafe { [V::splat(0.0); C] },
        };
        let mut any = false;
        let place = entry as f32;
        for at in splat.spans(tile.rect).groups(tile.reach[entry], &row_last, place).iter() {
            // SAFETY: as above.
            any |= unsafe { step::<V, C, K>(tile, pixels, &splat, place, at, &mut sums) };
        }
        if any {
            // SAFETY: as above.
            unsafe { sums.store(&mut out[entry]) };
        }
    }
}

/// Numbers of the columns.
const COLUMNS: [f32; TILE] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// List positions between asking for a Gaussian and reading it.
const AHEAD: usize = 4;

/// What the loop reads of one Gaussian; a cache line with up to four channels.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Splat<const C: usize> {
    /// Centre. px, first of the picture, then from the centre of a tile's first pixel
    u: f32,
    v: f32,
    /// `−½a, −b, −½c`, times `log₂ e`, as the forward pass has them.
    conic: [f32; 3],
    opacity: f32,
    /// How far the middle of a row of the ellipse moves per row. px
    slope: f32,
    /// Square of half its width at the centre, and what a row at distance 1 has less. px²
    wide: f32,
    narrow: f32,
    /// Its channels.
    values: [f32; C],
}

impl<const C: usize> Splat<C> {
    /// All visible Gaussians; `values` gives their channels.
    pub(crate) fn all(
        projected: &Projected,
        values: impl Fn(usize) -> [f32; C] + Sync,
    ) -> Vec<Self> {
        let one = |row: usize| {
            let [a, b, c] = projected.conic[row];
            let half = -0.5 * LOG2_E;
            // Wider than the cut by more than f32 can be wrong.
            let level = projected.level[row] * (1.0 + 1e-4) + 1e-4;
            Self {
                u: projected.mean2d[row][0],
                v: projected.mean2d[row][1],
                conic: [half * a, -LOG2_E * b, half * c],
                opacity: projected.opacity[row],
                slope: b / a,
                wide: level / a,
                narrow: 1.0 / (projected.variance[row][1] * a),
                values: values(row),
            }
        };
        (0..projected.len()).into_par_iter().with_min_len(4096).map(one).collect()
    }

    #[inline(always)]
    pub(crate) fn seen_from(mut self, rect: TileRect) -> Self {
        self.u -= rect.x0 as f32 + 0.5;
        self
    }

    /// Distance along y from row `r` of a tile.
    #[inline(always)]
    pub(crate) fn dy(&self, rect: TileRect, r: usize) -> f32 {
        self.v - ((rect.y0 as f32 + 0.5) + r as f32)
    }

    /// Which pixels of each row of the tile can be above the cut; a few more may be.
    #[inline(always)]
    pub(crate) fn spans(&self, rect: TileRect) -> Spans {
        let mut spans = Spans { begin: [0; TILE], end: [0; TILE] };
        for r in 0..TILE {
            let dy = self.dy(rect, r);
            let squared = self.wide - dy * dy * self.narrow;
            let half = if squared > 0.0 { squared.sqrt() } else { -1e9 };
            let shift = self.slope * dy;
            let middle = self.u + shift;
            let margin = 1e-3 + 1e-6 * (self.u.abs() + shift.abs() + half.abs());
            let begin = (middle - half - margin).ceil().max(0.0).min(TILE as f32);
            let end = (middle + half + margin).floor().min(TILE as f32 - 1.0).max(-1.0);
            spans.begin[r] = begin as i32;
            spans.end[r] = end as i32 + 1;
        }
        spans
    }
}

/// Asks for a cache line that will be read soon.
#[inline(always)]
pub(crate) fn prefetch<T>(value: &T) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: the instruction is part of every x86-64, and a reference is a valid address.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(value).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}

/// Per row of the tile: first pixel, and the one after the last.
pub(crate) struct Spans {
    begin: [i32; TILE],
    end: [i32; TILE],
}

/// Groups of eight pixels of a tile, by the number of their first pixel.
pub(crate) struct Groups {
    first: [u8; 2 * TILE],
    len: usize,
}

impl Groups {
    #[inline(always)]
    pub(crate) fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.first[..self.len].iter().map(|at| usize::from(*at))
    }
}

impl Spans {
    /// Groups that cover the spans, in rows that the Gaussian reaches and whose last Gaussian is
    /// not in front of it.
    #[inline(always)]
    pub(crate) fn groups(&self, reach: u8, row_last: &[f32; TILE], entry: f32) -> Groups {
        let mut groups = Groups { first: [0; 2 * TILE], len: 0 };
        for r in usize::from(reach & 15)..=usize::from(reach >> 4) {
            let (begin, end) = (self.begin[r], self.end[r]);
            if begin >= end || row_last[r] <= entry {
                continue;
            }
            // One group that stays in the row, or both of the row.
            let one = end - begin <= LANES as i32;
            let x = if one { begin.min((TILE - LANES) as i32) } else { 0 };
            let at = (r * TILE) as u8 + x as u8;
            groups.first[groups.len] = at;
            // Overwritten if there is one; the last of all may wrap, and then is not there.
            groups.first[(groups.len + 1) % (2 * TILE)] = at.wrapping_add(LANES as u8);
            groups.len += if one { 1 } else { 2 };
        }
        groups
    }
}

/// The largest `last` of each row of a tile, and of all.
#[inline(always)]
pub(crate) fn row_last(last: &[f32; PIXELS]) -> ([f32; TILE], usize) {
    let rows: [f32; TILE] = std::array::from_fn(|r| {
        last[r * TILE..(r + 1) * TILE].iter().fold(0.0, |a: f32, b| a.max(*b))
    });
    (rows, rows.iter().fold(0.0f32, |a, b| a.max(*b)) as usize)
}

/// Sums over the pixels of one Gaussian, by lane.
struct Sums<V, const C: usize> {
    moments: [V; MOMENTS],
    channels: [V; C],
}

impl<V: Lanes, const C: usize> Sums<V, C> {
    #[inline(always)]
    unsafe fn store<const K: usize>(&self, out: &mut [f32; K]) {
        let mut lanes = [0.0f32; 16];
        // SAFETY: the caller's promise of the instruction set; 8 values at 0 and at 8.
        unsafe {
            let mut all = [V::splat(0.0); 16];
            let first = K - C;
            all[..first].copy_from_slice(&self.moments[..first]);
            all[first..K].copy_from_slice(&self.channels);
            let [a, b, c, d, e, f, g, h, rest @ ..] = all;
            V::sums([a, b, c, d, e, f, g, h]).store(lanes.as_mut_ptr());
            if K == 9 {
                lanes[8] = rest[0].sum();
            } else if K > 8 {
                V::sums(rest).store(lanes.as_mut_ptr().add(8));
            }
        }
        out.copy_from_slice(&lanes[..K]);
    }
}

/// What one Gaussian is at eight pixels.
#[derive(Clone, Copy)]
pub(crate) struct Alphas<V: Lanes> {
    /// From the pixel to the Gaussian's centre along x. px
    pub dx: V,
    /// `o e^(−σ)`.
    pub full: V,
    /// At most `alpha_max`.
    pub alpha: V,
    /// Which pixels took the Gaussian.
    pub takes: V::Mask,
    /// Which of them are below the limit of α.
    pub free: V::Mask,
}

/// Eight pixels of a row of the tile, from pixel `at`; `None` if none of them took the Gaussian.
///
/// # Safety
/// On a CPU with the instruction set of `V`.
#[inline(always)]
pub(crate) unsafe fn alphas<V: Lanes, const C: usize>(
    settings: &RasterSettings,
    splat: &Splat<C>,
    dy: f32,
    last: &[f32; PIXELS],
    entry: f32,
    at: usize,
) -> Option<Alphas<V>> {
    assert!(at + LANES <= PIXELS && at % TILE <= TILE - LANES);
    let [a, b, c] = splat.conic;
    // SAFETY: the caller's promise of the instruction set; `at` was checked.
    unsafe {
        let dx = V::splat(splat.u).sub(V::load(COLUMNS.as_ptr().add(at % TILE)));
        // The same operations in the same order as the forward pass: the same pixels count.
        let along = V::splat(a).mul(dx).mul(dx);
        let flat = along.add(V::splat(c * dy * dy));
        let power = V::splat(0.0).min(dx.fma(V::splat(b * dy), flat));
        let full = V::splat(splat.opacity).mul(power.exp2());
        let limit = V::splat(settings.alpha_max);
        let alpha = full.min(limit);
        let takes = V::both(
            full.at_least(V::splat(settings.alpha_cut)),
            V::load(last.as_ptr().add(at)).at_least(V::splat(entry + 1.0)),
        );
        if !V::any(takes) {
            return None;
        }
        let free = V::both(takes, limit.at_least(full));
        Some(Alphas { dx, full, alpha, takes, free })
    }
}

/// Eight pixels of a row, from pixel `at`; whether any of them took the Gaussian.
#[inline(always)]
unsafe fn step<V: Lanes, const C: usize, const K: usize>(
    tile: &Tile<'_, C>,
    pixels: &mut Pixels<C>,
    splat: &Splat<C>,
    entry: f32,
    at: usize,
    sums: &mut Sums<V, C>,
) -> bool {
    let dy = splat.dy(tile.rect, at / TILE);
    // SAFETY: the caller's promise of the instruction set; `alphas` checked `at`.
    unsafe {
        let Some(here) = alphas::<V, C>(tile.settings, splat, dy, &pixels.last, entry, at) else {
            return false;
        };
        let through = V::splat(1.0).div(V::splat(1.0).sub(here.alpha));
        let after = V::load(pixels.transmittance.as_ptr().add(at));
        let before = after.mul(through);
        before.or_else(here.takes, after).store(pixels.transmittance.as_mut_ptr().add(at));
        let weight = here.alpha.mul(before).keep(here.takes);
        let gradient: [V; C] =
            std::array::from_fn(|k| V::load(pixels.gradient[k].as_ptr().add(at)));
        for k in 0..C {
            sums.channels[k] = weight.fma(gradient[k], sums.channels[k]);
        }
        if K == C {
            return true;
        }
        let mut value = V::splat(0.0);
        for k in 0..C {
            value = gradient[k].fma(V::splat(splat.values[k]), value);
        }
        let behind = V::load(pixels.behind.as_ptr().add(at));
        // −∂/∂α
        let of_alpha = before.negative_fma(value, behind.mul(through));
        weight.fma(value, behind).store(pixels.behind.as_mut_ptr().add(at));
        // No gradient where α met its limit.
        let p = here.full.mul(of_alpha).keep(here.free);
        let p_dx = p.mul(here.dx);
        let m = &mut sums.moments;
        m[0] = m[0].add(p);
        m[1] = m[1].add(p_dx);
        m[2] = p_dx.fma(here.dx, m[2]);
        m[3] = p.fma(V::splat(dy), m[3]);
        m[4] = p_dx.fma(V::splat(dy), m[4]);
        m[5] = p.fma(V::splat(dy * dy), m[5]);
    }
    true
}

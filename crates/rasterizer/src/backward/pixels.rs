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

use crate::lanes::{LANES, Lanes8, Plain};
use crate::splats::{COLUMNS, Groups, Splat, prefetch, reached};
use crate::{RasterSettings, TILE, TileRect};
use scenesplat_kernels::simd::Isa;

/// Pixels of a tile.
pub(crate) const PIXELS: usize = TILE * TILE;
/// Number of the sums named above.
pub(crate) const MOMENTS: usize = 6;

/// What a tile reads. `C` channels: color, depth, both or none.
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

/// Walks over a tile. Writes a record per entry: the six sums (if `K` has room for them), then the
/// gradient of each channel.
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
    unsafe { walk_with::<Plain, C, K>(tile, pixels, out) }
}

#[inline(always)]
unsafe fn walk_with<V: Lanes8, const C: usize, const K: usize>(
    tile: &Tile<'_, C>,
    pixels: &mut Pixels<C>,
    out: &mut [[f32; K]],
) {
    let (row_last, end) = row_last(&pixels.last);
    let end = end.min(out.len());
    // Behind the last Gaussian of every pixel.
    out[end..].fill([0.0; K]);
    let mut groups = Groups::new();
    for entry in (0..end).rev() {
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
        let rows = reached(tile.reach[entry]) & rows_behind(&row_last, place);
        groups.find(&splat, rows, LANES);
        while let Some(at) = groups.next(LANES) {
            // SAFETY: as above.
            any |=
                unsafe { step::<V, C, K>(tile, pixels, (&splat, &groups), place, at, &mut sums) };
        }
        if any {
            // SAFETY: as above.
            unsafe { sums.store(&mut out[entry]) };
        } else {
            out[entry] = [0.0; K];
        }
    }
}

/// List positions between asking for a Gaussian and reading it.
const AHEAD: usize = 4;

/// The largest `last` of each row of a tile, and of all.
#[inline(always)]
pub(crate) fn row_last(last: &[f32; PIXELS]) -> ([f32; TILE], usize) {
    let rows: [f32; TILE] = std::array::from_fn(|r| {
        last[r * TILE..(r + 1) * TILE].iter().fold(0.0, |a: f32, b| a.max(*b))
    });
    (rows, rows.iter().fold(0.0f32, |a, b| a.max(*b)) as usize)
}

/// Bit per row: whether its last Gaussian is not in front of the one at position `entry`.
#[inline(always)]
pub(crate) fn rows_behind(row_last: &[f32; TILE], entry: f32) -> u32 {
    let mut rows = 0;
    for (r, &last) in row_last.iter().enumerate() {
        rows |= u32::from(last > entry) << r;
    }
    rows
}

/// Sums over the pixels of one Gaussian, by lane.
struct Sums<V, const C: usize> {
    moments: [V; MOMENTS],
    channels: [V; C],
}

impl<V: Lanes8, const C: usize> Sums<V, C> {
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
pub(crate) struct Alphas<V: Lanes8> {
    /// From the pixel to the Gaussian's center along x. px
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
pub(crate) unsafe fn alphas<V: Lanes8, const C: usize>(
    settings: &RasterSettings,
    (splat, groups): (&Splat<C>, &Groups),
    last: &[f32; PIXELS],
    entry: f32,
    at: usize,
) -> Option<Alphas<V>> {
    assert!(at + LANES <= PIXELS && at % TILE <= TILE - LANES);
    let row = at / TILE;
    // SAFETY: the caller's promise of the instruction set; `at` was checked.
    unsafe {
        let column = V::load(COLUMNS.as_ptr().add(at % TILE));
        // The same operations as the forward pass: the same pixels count.
        let from_middle = column.sub(V::splat(groups.middle[row]));
        let power = V::splat(splat.across).mul(from_middle);
        let full = power.fma(from_middle, V::splat(groups.top[row])).exp2();
        let dx = V::splat(splat.u).sub(column);
        let limit = V::splat(settings.alpha_max);
        let alpha = full.min(limit);
        let takes = V::both(
            full.at_least(V::splat(settings.alpha_cut)),
            V::load(last.as_ptr().add(at)).at_least(V::splat(entry + 1.0)),
        );
        if V::bits(takes) == 0 {
            return None;
        }
        let free = V::both(takes, limit.at_least(full));
        Some(Alphas { dx, full, alpha, takes, free })
    }
}

/// Eight pixels of a row, from pixel `at`; whether any of them took the Gaussian.
#[inline(always)]
unsafe fn step<V: Lanes8, const C: usize, const K: usize>(
    tile: &Tile<'_, C>,
    pixels: &mut Pixels<C>,
    (splat, groups): (&Splat<C>, &Groups),
    entry: f32,
    at: usize,
    sums: &mut Sums<V, C>,
) -> bool {
    let dy = groups.dy[at / TILE];
    // SAFETY: the caller's promise of the instruction set; `alphas` checked `at`.
    unsafe {
        let found = alphas::<V, C>(tile.settings, (splat, groups), &pixels.last, entry, at);
        let Some(here) = found else { return false };
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

//! Gradients through a picture of features, some channels at a time.
//!
//! A Gaussian's derivative of α is a sum over the channels, so groups of channels can be walked
//! over one after the other, each with its own `R`, and what they give is added. A group's
//! records stay small however many channels there are, and its pixels stay in the first cache.

use super::pixels::{MOMENTS, PIXELS, alphas, row_last, rows_behind};
use super::reduce::{CHUNK, PairsOfRow, cut};
use super::rows::{Pass, Sums};
use crate::blend::TILES_PER_TASK;
use crate::lanes::{LANES, Lanes8, Plain};
use crate::splats::{Groups, Splat, reached};
use crate::{TILE, TileRect};
use rayon::prelude::*;
use scenesplat_kernels::simd::Isa;

/// Channels of a group.
const GROUP: usize = 32;
/// Values of a record: the moments, then the channels.
const RECORD: usize = GROUP + MOMENTS;

/// The state of a tile's pixels.
struct State {
    transmittance: [f32; PIXELS],
    behind: [f32; PIXELS],
    last: [f32; PIXELS],
    gradient: [[f32; GROUP]; PIXELS],
}

impl Pass<'_> {
    /// Adds what comes through the features: to the sums of each visible row if geometry is
    /// wanted, and to `out`, the gradient of the features (`[N, dim]`).
    pub(crate) fn features(&self, pairs: &PairsOfRow, rows: &mut [Sums], out: &mut [f32]) {
        let dim = self.upstream.feature_dim();
        let splats = if dim == 0 { Vec::new() } else { Splat::all(&self.trace.projected, |_| []) };
        for first in (0..dim).step_by(GROUP) {
            let width = GROUP.min(dim - first);
            let mut records = vec![[0.0f32; RECORD]; self.trace.lists.entries.len()];
            let tiles = self.tiles(&mut records);
            tiles.into_par_iter().with_max_len(TILES_PER_TASK).for_each(|(rect, out)| {
                let group = Group { pass: self, splats: &splats, rect, first, width };
                group.walk(self.state(rect, first, width), out);
            });
            let index = &self.trace.projected.index;
            let parts = cut(out, index, dim);
            let chunks = parts.into_par_iter().zip(rows.par_chunks_mut(CHUNK));
            chunks.enumerate().for_each(|(i, (out, rows))| {
                let start = index[i * CHUNK];
                for (k, sums) in rows.iter_mut().enumerate() {
                    let row = i * CHUNK + k;
                    let sum = pairs.sum(row, &records);
                    (0..MOMENTS).for_each(|m| sums.moments[m] += sum[m]);
                    let at = (index[row] - start) as usize * dim + first;
                    for (o, s) in out[at..at + width].iter_mut().zip(&sum[MOMENTS..]) {
                        *o += s;
                    }
                }
            });
        }
    }

    fn state(&self, rect: TileRect, first: usize, width: usize) -> Box<State> {
        let mut state = Box::new(State {
            transmittance: [1.0; PIXELS],
            behind: [0.0; PIXELS],
            last: self.last(rect),
            gradient: [[0.0; GROUP]; PIXELS],
        });
        if let Some(f) = self.upstream.features {
            for (to, from) in self.places(rect) {
                state.transmittance[to] = self.trace.picture.transmittance[from];
                let at = from * f.dim + first;
                state.gradient[to][..width].copy_from_slice(&f.gradient[at..at + width]);
            }
        }
        state
    }
}

/// Which channels of which tile.
struct Group<'a> {
    pass: &'a Pass<'a>,
    splats: &'a [Splat<0>],
    rect: TileRect,
    first: usize,
    width: usize,
}

impl Group<'_> {
    fn walk(&self, mut state: Box<State>, out: &mut [[f32; RECORD]]) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
            unsafe fn avx512(g: &Group<'_>, state: &mut State, out: &mut [[f32; RECORD]]) {
                // SAFETY: the features are enabled here.
                unsafe { walk::<std::arch::x86_64::__m256>(g, state, out) }
            }
            #[target_feature(enable = "avx2,fma")]
            unsafe fn avx2(g: &Group<'_>, state: &mut State, out: &mut [[f32; RECORD]]) {
                // SAFETY: as above.
                unsafe { walk::<std::arch::x86_64::__m256>(g, state, out) }
            }
            let isa = self.pass.settings.isa();
            if isa >= Isa::Avx512 && is_x86_feature_detected!("avx512vl") {
                // SAFETY: just detected; AVX2 and FMA are part of every set above portable.
                return unsafe { avx512(self, &mut state, out) };
            }
            if isa >= Isa::Avx2 {
                // SAFETY: as above.
                return unsafe { avx2(self, &mut state, out) };
            }
        }
        // SAFETY: plain Rust.
        unsafe { walk::<Plain>(self, &mut state, out) }
    }
}

#[inline(always)]
unsafe fn walk<V: Lanes8>(group: &Group<'_>, state: &mut State, out: &mut [[f32; RECORD]]) {
    let pass = group.pass;
    let (projected, lists) = (&pass.trace.projected, &pass.trace.lists);
    let Some(features) = pass.upstream.features else { return };
    let begin = lists.offsets[group.rect.tile];
    let (row_last, end) = row_last(&state.last);
    let geometry = pass.mask.geometry();
    let mut groups = Groups::new();
    for entry in (0..end.min(out.len())).rev() {
        let row = lists.entries[begin + entry] as usize;
        let splat = group.splats[row].seen_from(group.rect);
        let at = projected.index[row] as usize * features.dim + group.first;
        let mut values = [0.0f32; GROUP];
        values[..group.width].copy_from_slice(&features.features[at..at + group.width]);
        let record = &mut out[entry];
        let place = entry as f32;
        let reached = reached(lists.reach[begin + entry]);
        groups.find(&splat, reached & rows_behind(&row_last, place), LANES);
        while let Some(at) = groups.next(LANES) {
            let (dy, seen) = (groups.dy[at / TILE], (&splat, &groups));
            // SAFETY: the caller has made sure of the instruction set.
            let lanes = unsafe {
                match alphas::<V, 0>(pass.settings, seen, &state.last, place, at) {
                    Some(here) => Lane::of(here),
                    None => continue,
                }
            };
            for (lane, at) in lanes.iter().zip(at..) {
                lane.step(state, at, &values, dy, geometry, record);
            }
        }
    }
}

/// One pixel of [`alphas`].
#[derive(Clone, Copy, Default)]
struct Lane {
    takes: bool,
    free: bool,
    dx: f32,
    full: f32,
    alpha: f32,
}

impl Lane {
    /// # Safety
    /// On a CPU with the instruction set of `V`.
    #[inline(always)]
    unsafe fn of<V: Lanes8>(here: super::pixels::Alphas<V>) -> [Self; LANES] {
        let mut lanes = [[0.0f32; LANES]; 5];
        // SAFETY: the caller's promise; each array has eight values.
        unsafe {
            let one = V::splat(1.0);
            let all = [one.keep(here.takes), one.keep(here.free), here.dx, here.full, here.alpha];
            for (to, v) in lanes.iter_mut().zip(all) {
                v.store(to.as_mut_ptr());
            }
        }
        let [takes, free, dx, full, alpha] = lanes;
        std::array::from_fn(|i| Self {
            takes: takes[i] > 0.0,
            free: free[i] > 0.0,
            dx: dx[i],
            full: full[i],
            alpha: alpha[i],
        })
    }

    #[inline(always)]
    fn step(
        &self,
        state: &mut State,
        at: usize,
        values: &[f32; GROUP],
        dy: f32,
        geometry: bool,
        record: &mut [f32; RECORD],
    ) {
        if !self.takes {
            return;
        }
        let through = 1.0 / (1.0 - self.alpha);
        let before = state.transmittance[at] * through;
        state.transmittance[at] = before;
        let weight = self.alpha * before;
        let gradient = &state.gradient[at];
        for (sum, g) in record[MOMENTS..].iter_mut().zip(gradient) {
            *sum += weight * g;
        }
        if !geometry {
            return;
        }
        let mut products = [0.0f32; LANES];
        for (v, g) in values.chunks_exact(LANES).zip(gradient.chunks_exact(LANES)) {
            for k in 0..LANES {
                products[k] += v[k] * g[k];
            }
        }
        let value: f32 = products.iter().sum();
        let behind = state.behind[at];
        state.behind[at] = behind + weight * value;
        if self.free {
            let p = self.full * (behind * through - before * value);
            let p_dx = p * self.dx;
            let more = [p, p_dx, p_dx * self.dx, p * dy, p_dx * dy, p * dy * dy];
            (0..MOMENTS).for_each(|m| record[m] += more[m]);
        }
    }
}

//! The steps of a backward pass, and what goes from one to the next.

use super::pixels::{MOMENTS, PIXELS, Pixels, Tile, walk};
use super::projection::{self, Lens, RowGradient, Shape};
use super::reduce::{CHUNK, PairsOfRow, cut};
use super::{GradMask, Gradients, Trace, Upstream, harmonics};
use crate::blend::{TILES_PER_TASK, rect};
use crate::projection::tangent_limits;
use crate::splats::Splat;
use crate::{Gaussians, RasterSettings, TILE, TileRect, View};
use rayon::prelude::*;

/// Everything that is read.
#[derive(Clone, Copy)]
pub(crate) struct Pass<'a> {
    pub gaussians: &'a Gaussians,
    pub view: &'a View,
    pub settings: &'a RasterSettings,
    pub trace: &'a Trace,
    pub upstream: &'a Upstream<'a>,
    pub mask: GradMask,
}

/// Sums over all pixels of a visible Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sums {
    /// See [`pixels`](super::pixels).
    pub moments: [f32; MOMENTS],
    pub color: [f32; 3],
    pub depth: f32,
}

/// What walking over the tiles needs.
#[derive(Debug, Default)]
pub(crate) struct PixelMemory {
    /// By the channels of the pass.
    none: Vec<Splat<0>>,
    depth: Vec<Splat<1>>,
    color: Vec<Splat<3>>,
    both: Vec<Splat<4>>,
    /// Records of all (tile, Gaussian) pairs, one after the other.
    records: Vec<f32>,
}

impl<'a> Pass<'a> {
    /// Walks over all tiles. One row per visible Gaussian.
    pub(crate) fn pixels(
        &self,
        pairs: &PairsOfRow,
        memory: &mut PixelMemory,
        rows: &mut Vec<Sums>,
    ) {
        let colors = &self.trace.colors;
        let depths = &self.trace.projected.depth;
        let geometry = self.mask.geometry();
        rows.clear();
        rows.resize(self.trace.projected.len(), Sums::default());
        let PixelMemory { none, depth, color, both, records } = memory;
        let alpha = self.upstream.alpha.is_some();
        match (geometry, self.upstream.rgb.is_some(), self.upstream.depth()) {
            (true, true, true) => {
                let values = |row: usize| {
                    let [r, g, b] = colors[row];
                    [r, g, b, depths[row]]
                };
                self.walk::<4, 10>(values, pairs, (both, records), rows);
            }
            (true, true, false) => {
                self.walk::<3, 9>(|row| colors[row], pairs, (color, records), rows);
            }
            (true, false, true) => {
                self.walk::<1, 7>(|row| [depths[row]], pairs, (depth, records), rows);
            }
            (true, false, false) if alpha => {
                self.walk::<0, 6>(|_| [], pairs, (none, records), rows);
            }
            (false, true, _) if self.mask.sh => {
                self.walk::<3, 3>(|row| colors[row], pairs, (color, records), rows);
            }
            _ => {}
        }
    }

    /// One instantiation: `C` channels, `K` sums per Gaussian.
    fn walk<const C: usize, const K: usize>(
        &self,
        values: impl Fn(usize) -> [f32; C] + Sync,
        pairs: &PairsOfRow,
        (splats, records): (&mut Vec<Splat<C>>, &mut Vec<f32>),
        rows: &mut [Sums],
    ) {
        let lists = &self.trace.lists;
        Splat::put_all(&self.trace.projected, values, splats);
        let splats = &splats[..];
        // The walk writes every record.
        records.resize(K * lists.entries.len(), 0.0);
        let (records, _) = records.as_chunks_mut::<K>();
        let mut tasks = Vec::with_capacity(lists.len().div_ceil(TILES_PER_TASK));
        let mut rest = &mut *records;
        for first in (0..lists.len()).step_by(TILES_PER_TASK) {
            let end = (first + TILES_PER_TASK).min(lists.len());
            let len = lists.offsets[end] - lists.offsets[first];
            let (part, tail) = std::mem::take(&mut rest).split_at_mut(len);
            tasks.push((first..end, part));
            rest = tail;
        }
        tasks.into_par_iter().with_max_len(1).for_each(|(tiles, mut rest)| {
            for tile in tiles {
                let (begin, end) = (lists.offsets[tile], lists.offsets[tile + 1]);
                let (out, tail) = std::mem::take(&mut rest).split_at_mut(end - begin);
                rest = tail;
                if out.is_empty() {
                    continue;
                }
                let rect = rect(tile, lists, self.view);
                let (entries, reach) = (&lists.entries[begin..end], &lists.reach[begin..end]);
                let tile = Tile { rect, entries, reach, splats, settings: self.settings };
                walk(&tile, &mut self.start(rect), out);
            }
        });
        pairs.each(records, rows, |_, sum, row| {
            let first = K - C;
            row.moments[..first].copy_from_slice(&sum[..first]);
            if C >= 3 {
                row.color.copy_from_slice(&sum[first..first + 3]);
            }
            if C == 4 || C == 1 {
                row.depth = sum[K - 1];
            }
        });
    }

    /// Tiles that have a list, each with its part of the records.
    pub(crate) fn tiles<'r, T>(&self, records: &'r mut [T]) -> Vec<(TileRect, &'r mut [T])> {
        let lists = &self.trace.lists;
        let mut rest = records;
        let mut tiles = Vec::with_capacity(lists.len());
        for tile in 0..lists.len() {
            let len = lists.offsets[tile + 1] - lists.offsets[tile];
            let (part, tail) = std::mem::take(&mut rest).split_at_mut(len);
            rest = tail;
            if len > 0 {
                tiles.push((rect(tile, lists, self.view), part));
            }
        }
        tiles
    }

    /// The state of a tile's pixels before the walk.
    fn start<const C: usize>(&self, rect: TileRect) -> Pixels<C> {
        let (picture, up) = (&self.trace.picture, self.upstream);
        let background = self.settings.background.unwrap_or_default();
        let mut pixels = Pixels {
            transmittance: [1.0; PIXELS],
            behind: [0.0; PIXELS],
            gradient: [[0.0; PIXELS]; C],
            last: self.last(rect),
        };
        let at = |plane: Option<&[f32]>, i: usize| plane.map_or(0.0, |p| p[i]);
        for (to, from) in self.places(rect) {
            if pixels.last[to] == 0.0 {
                continue;
            }
            let light = picture.transmittance[from];
            pixels.transmittance[to] = light;
            let mut behind = -at(up.alpha, from);
            if let (Some(rgb), true) = (up.rgb, C >= 3) {
                for k in 0..3 {
                    pixels.gradient[k][to] = rgb[3 * from + k];
                    behind += rgb[3 * from + k] * background[k];
                }
            }
            if C == 1 || C == 4 {
                let alpha = (1.0 - light).max(1e-10);
                let expected = at(up.depth_expected, from) / alpha;
                pixels.gradient[C - 1][to] = at(up.depth_accumulated, from) + expected;
                behind += expected * at(picture.depth_expected.as_deref(), from);
            }
            pixels.behind[to] = light * behind;
        }
        pixels
    }

    /// Where the pixels of a tile are in the tile, and in the picture.
    pub(crate) fn places(&self, rect: TileRect) -> impl Iterator<Item = (usize, usize)> + use<> {
        let width = self.view.width as usize;
        let first = rect.y0 as usize * width + rect.x0 as usize;
        let across = rect.width as usize;
        (0..rect.height as usize)
            .flat_map(move |y| (0..across).map(move |x| (y * TILE + x, first + y * width + x)))
    }

    /// List position + 1 of the last Gaussian of each pixel of a tile.
    pub(crate) fn last(&self, rect: TileRect) -> [f32; PIXELS] {
        let mut last = [0.0; PIXELS];
        for (to, from) in self.places(rect) {
            last[to] = self.trace.last[from] as f32;
        }
        last
    }

    /// Adds the gradients of the parameters, from the sums over the pixels.
    pub(crate) fn parameters(&self, rows: &[Sums], out: &mut Gradients) {
        let index = &self.trace.projected.index;
        let width = 3 * self.gaussians.sh_len();
        let parts = cut(&mut out.means, index, 1)
            .into_iter()
            .zip(cut(&mut out.quats, index, 1))
            .zip(cut(&mut out.scales, index, 1))
            .zip(cut(&mut out.opacities, index, 1))
            .zip(cut(&mut out.sh, index, width))
            .zip(screens(&mut out.screen, index))
            .enumerate()
            .collect::<Vec<_>>();
        let lens = lens(self.view, self.settings);
        let eye = self.view.centre();
        parts.into_par_iter().for_each(
            |(i, (((((means, quats), scales), opacities), sh), screen))| {
                let begin = i * CHUNK;
                let end = (begin + CHUNK).min(index.len());
                let first = index[begin] as usize;
                for row in begin..end {
                    let at = index[row] as usize - first;
                    let harmonics = &mut sh[at * width..(at + 1) * width];
                    let moved = self.color(index[row] as usize, eye, &rows[row], harmonics);
                    if self.mask.geometry() {
                        let to =
                            (&mut means[at], &mut quats[at], &mut scales[at], &mut opacities[at]);
                        let moved = self.geometry(&lens, row, &rows[row], moved, to);
                        if let Some(screen) = screen.get_mut(at) {
                            (0..2).for_each(|k| screen[k] += moved[k]);
                        }
                    }
                }
            },
        );
    }

    /// Adds the gradients of one Gaussian's harmonics, and gives back what its center gets from
    /// its color.
    #[inline]
    fn color(&self, i: usize, eye: [f32; 3], row: &Sums, sh: &mut [f32]) -> [f32; 3] {
        let wanted = harmonics::Wanted {
            harmonics: self.mask.sh,
            direction: self.mask.means && self.mask.sh_direction && self.trace.sh_degree > 0,
        };
        if row.color == [0.0; 3] || !(wanted.harmonics || wanted.direction) {
            return [0.0; 3];
        }
        let stride = sh.len();
        let coefficients = &self.gaussians.sh[i * stride..(i + 1) * stride];
        let to = [0, 1, 2].map(|k| self.gaussians.means[i][k] - eye[k]);
        let degree = self.trace.sh_degree;
        harmonics::pull_back(degree, coefficients, to, row.color, wanted, sh)
    }

    /// Adds the gradients of one Gaussian's geometry; `moved` goes to the center too. Gives the one of
    /// the center on the picture.
    #[allow(clippy::needless_pass_by_value, reason = "a tuple of references")]
    #[inline]
    fn geometry(
        &self,
        lens: &Lens,
        row: usize,
        sums: &Sums,
        moved: [f32; 3],
        to: (&mut [f32; 3], &mut [f32; 4], &mut [f32; 3], &mut f32),
    ) -> [f32; 2] {
        let (p, isotropic) = (&self.trace.projected, self.settings.isotropic);
        let i = p.index[row] as usize;
        let [m0, m1, m2, m3, m4, m5] = sums.moments;
        let [a, b, c] = p.conic[row];
        let gradient = RowGradient {
            mean2d: [a * m1 + b * m3, b * m1 + c * m3],
            conic: [0.5 * m2, m4, 0.5 * m5],
            opacity: -m0 / p.opacity[row],
            depth: sums.depth,
        };
        let scale = self.gaussians.scales[i];
        let shape = Shape {
            mean: self.gaussians.means[i],
            quat: if isotropic { [1.0, 0.0, 0.0, 0.0] } else { self.gaussians.quats[i] },
            scale: if isotropic { [scale[0]; 3] } else { scale },
            opacity: self.gaussians.opacities[i].min(1.0),
        };
        let found = projection::pull_back(lens, &shape, p.compensation[row], &gradient);
        if self.mask.means {
            (0..3).for_each(|k| to.0[k] += found.mean[k] + moved[k]);
        }
        if self.mask.quats && !isotropic {
            (0..4).for_each(|k| to.1[k] += found.quat[k]);
        }
        if self.mask.scales && isotropic {
            to.2[0] += found.scale.iter().sum::<f32>();
        } else if self.mask.scales {
            (0..3).for_each(|k| to.2[k] += found.scale[k]);
        }
        // Above 1 the opacity that was drawn is the constant 1.
        if self.mask.opacities && self.gaussians.opacities[i] <= 1.0 {
            *to.3 += found.opacity;
        }
        gradient.mean2d
    }
}

/// Parts of the gradients on the picture as [`cut`] makes them, empty where there is no room for them.
fn screens<'a>(screen: &'a mut [[f32; 2]], index: &[u32]) -> Vec<&'a mut [[f32; 2]]> {
    if screen.is_empty() {
        return index.chunks(CHUNK).map(|_| &mut [][..]).collect();
    }
    cut(screen, index, 1)
}

/// The constants of the projection.
fn lens(view: &View, settings: &RasterSettings) -> Lens {
    let [r0, r1, r2] = view.world_to_camera;
    let floor = settings.antialias_floor;
    Lens {
        rotation: [r0, r1, r2].map(|[x, y, z, _]| [x, y, z]),
        translation: [r0[3], r1[3], r2[3]],
        focal: [view.fx, view.fy],
        tangent: tangent_limits(view, settings),
        eps2d: settings.eps2d,
        // As the forward pass rounds it, so that a factor at the floor is seen to be there.
        floor: settings.antialiased.then(|| (floor * floor).sqrt()),
        normalize: settings.normalize_quats,
    }
}

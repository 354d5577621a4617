//! Weights per Gaussian and segment of one picture.

use super::LiftError;
use super::alpha_weighted::{AlphaWeighted, TileDepths, TileSums, TileWeight};
use super::centre_pixel::{CentrePixel, CentrePixels};
use super::segment_map::{NO_SEGMENT, SegmentMap};
use super::spool::SegmentWeight;
use super::tile_segments::{MAX_LEVELS, NOWHERE, SegmentTuple, TileSegments};
use crate::render::median_depth;
use crate::{
    Gaussians, Projected, RasterSettings, TILE, TileLists, TileRect, View, blend, project,
    tile_lists,
};
use rayon::prelude::*;
use scenesplat_scene::vector::{dot, rotation};
use std::ops::Range;

/// Which pixels of a picture label a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LiftRule {
    /// All that show it, each with its blending weight `α T`.
    #[default]
    AlphaWeighted,
    /// The one pixel up to one pixel left of and above its center, with the weight there, and the
    /// segment of the pixel its center is in: half a pixel apart, as in Occam's LGS (70d2e69) and
    /// the fork of gsplat 1.4 it uses (5791713). Its constants are
    /// [`RasterSettings::gsplat_1_4`]. A Gaussian whose center is hidden or outside the picture gets
    /// no label from it.
    CentrePixel,
}

/// When the depth D of a pixel agrees with a Gaussian at depth z that is σ deep along the camera's axis:
/// `|z − D| ≤ relative · z + absolute + sigmas · σ`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthTolerance {
    /// Part of the Gaussian's depth, in `0..1`.
    pub relative: f32,
    /// Units of the world, ≥ 0.
    pub absolute: f32,
    /// Standard deviations of the Gaussian, ≥ 0.
    pub sigmas: f32,
}

impl Default for DepthTolerance {
    /// 3 % and 5 cm: what depth cameras err by indoors.
    fn default() -> Self {
        Self { relative: 0.03, absolute: 0.05, sigmas: 0.0 }
    }
}

impl DepthTolerance {
    /// For the median depth of the scene itself, which errs by what the surface is thick.
    pub const RENDERED: Self = Self { relative: 0.01, absolute: 0.0, sigmas: 2.0 };

    pub(super) fn check(&self) -> Result<(), LiftError> {
        let length = |v: f32| v >= 0.0 && v.is_finite();
        let relative = (0.0..1.0).contains(&self.relative);
        if relative && length(self.absolute) && length(self.sigmas) {
            return Ok(());
        }
        let problem = format!(
            "{} of the depth, {} units and {} standard deviations; a part in 0..1 and numbers from 0 \
             are expected",
            self.relative, self.absolute, self.sigmas
        );
        Err(LiftError::argument("depth tolerance", problem))
    }

    /// Least and largest depth that agrees with each Gaussian in the picture.
    fn ranges(
        &self,
        gaussians: &Gaussians,
        projected: &Projected,
        view: &View,
        settings: &RasterSettings,
    ) -> Vec<[f32; 2]> {
        let axis = view.world_to_camera[2];
        let range = |(&i, &z): (&u32, &f32)| {
            let deep = match self.sigmas {
                0.0 => 0.0,
                sigmas => {
                    let unit = settings.normalize_quats;
                    sigmas * deviation(gaussians, i as usize, [axis[0], axis[1], axis[2]], unit)
                }
            };
            let slack = self.relative * z + self.absolute + deep;
            [z - slack, z + slack]
        };
        projected.index.par_iter().zip(&projected.depth).map(range).collect()
    }
}

/// Standard deviation of a Gaussian along a unit vector of the world, as it is drawn: with its
/// quaternion as it is, or made one of length 1.
fn deviation(gaussians: &Gaussians, i: usize, axis: [f32; 3], unit: bool) -> f32 {
    let quat = gaussians.quats[i].map(f64::from);
    let norm = if unit { quat.iter().map(|v| v * v).sum::<f64>().sqrt() } else { 1.0 };
    let columns = transposed(rotation(quat.map(|v| (v / norm) as f32)));
    let along = |k: usize| dot(columns[k], axis) * gaussians.scales[i][k];
    (0..3).map(|k| along(k) * along(k)).sum::<f32>().sqrt()
}

fn transposed(m: [[f32; 3]; 3]) -> [[f32; 3]; 3] {
    std::array::from_fn(|c| std::array::from_fn(|r| m[r][c]))
}

/// A picture with its segments.
#[derive(Debug, Clone, Copy)]
pub struct LabelledView<'a> {
    /// The camera.
    pub view: &'a View,
    /// One map per granularity, 1 to 4, each of the camera's size.
    pub levels: &'a [SegmentMap],
    /// Depth along the camera's axis and when it agrees; pixels without a depth (0, or not finite)
    /// label nothing. `[H, W]`, units of the world.
    pub depth: Option<(&'a [f32], DepthTolerance)>,
}

/// What the segments of one picture say about the Gaussians.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ViewWeights {
    /// Per granularity the weights above 0, by Gaussian, then by segment of the picture.
    pub levels: Vec<Vec<SegmentWeight>>,
    /// Gaussians with any weight, ascending, and all of their weight, in segments or not, pixels.
    pub totals: Vec<(u32, f32)>,
    /// Gaussians in the picture.
    pub visible: usize,
}

impl ViewWeights {
    /// Makes all of them count that many times as much.
    pub(super) fn scale(&mut self, by: f32) {
        self.levels.iter_mut().flatten().for_each(|w| w.weight *= by);
        self.totals.iter_mut().for_each(|(_, total)| *total *= by);
    }
}

/// The depth of a pixel, NaN if there is none.
fn known(depth: f32) -> f32 {
    if depth > 0.0 && depth.is_finite() { depth } else { f32::NAN }
}

fn tile_depths(depth: &[f32], view: &View, rect: TileRect) -> Box<TileDepths> {
    let mut out = Box::new([[f32::NAN; TILE]; TILE]);
    for r in 0..rect.height as usize {
        let start = (rect.y0 as usize + r) * view.width as usize + rect.x0 as usize;
        for (out, &d) in out[r].iter_mut().zip(&depth[start..start + rect.width as usize]) {
            *out = known(d);
        }
    }
    out
}

/// Sums the weights of every Gaussian over the pixels of every segment.
///
/// The weights are those of the renderer: pixels without a segment, and those whose depth does not
/// agree, take their share of the light all the same. Tiles are summed in their order: the result does
/// not depend on the number of threads.
///
/// # Errors
/// If a map or the depth is not of the camera's size, there are no maps or more than four, or the
/// renderer refuses the view.
pub fn view_weights(
    gaussians: &Gaussians,
    picture: &LabelledView<'_>,
    rule: LiftRule,
    settings: &RasterSettings,
) -> Result<ViewWeights, LiftError> {
    weights_with_own_depth(gaussians, picture, None, rule, settings)
}

/// As [`view_weights`]; with `own`, the depth is the median depth of the picture itself.
pub(super) fn weights_with_own_depth(
    gaussians: &Gaussians,
    picture: &LabelledView<'_>,
    own: Option<DepthTolerance>,
    rule: LiftRule,
    settings: &RasterSettings,
) -> Result<ViewWeights, LiftError> {
    check(picture)?;
    let drawn = Drawn::new(gaussians, picture.view, settings)?;
    let Some(tolerance) = own else { return Ok(drawn.weights(gaussians, picture, rule, settings)) };
    let depth = drawn.median_depth(picture.view, settings);
    let picture = LabelledView { depth: Some((&depth, tolerance)), ..*picture };
    Ok(drawn.weights(gaussians, &picture, rule, settings))
}

/// The weights of all pixels, then of those that agree with the median depth of the picture itself, one
/// list after the other: what two calls of [`weights_with_own_depth`] give, but for `totals`,
/// which are there once.
pub(super) fn weights_of_all_and_agreeing(
    gaussians: &Gaussians,
    picture: &LabelledView<'_>,
    tolerance: DepthTolerance,
    rule: LiftRule,
    settings: &RasterSettings,
) -> Result<ViewWeights, LiftError> {
    check(picture)?;
    let drawn = Drawn::new(gaussians, picture.view, settings)?;
    let mut out = drawn.weights(gaussians, picture, rule, settings);
    let depth = drawn.median_depth(picture.view, settings);
    let picture = LabelledView { depth: Some((&depth, tolerance)), ..*picture };
    out.levels.extend(drawn.weights(gaussians, &picture, rule, settings).levels);
    Ok(out)
}

/// A view before its pixels.
pub(super) struct Drawn {
    projected: Projected,
    lists: TileLists,
}

impl Drawn {
    pub(super) fn new(
        gaussians: &Gaussians,
        view: &View,
        settings: &RasterSettings,
    ) -> Result<Self, LiftError> {
        let projected = project(gaussians, view, settings)?;
        let lists = tile_lists(&projected, view, settings);
        Ok(Self { projected, lists })
    }

    pub(super) fn median_depth(&self, view: &View, settings: &RasterSettings) -> Vec<f32> {
        median_depth(&self.projected, &self.lists, view, settings)
    }

    pub(super) fn weights(
        &self,
        gaussians: &Gaussians,
        picture: &LabelledView<'_>,
        rule: LiftRule,
        settings: &RasterSettings,
    ) -> ViewWeights {
        let Self { projected, lists } = self;
        let ranges = picture.depth.map_or(Vec::new(), |(_, tolerance)| {
            tolerance.ranges(gaussians, projected, picture.view, settings)
        });
        let pass = Pass { projected, lists, picture, settings, ranges: &ranges };
        let mut out = match rule {
            LiftRule::AlphaWeighted => pass.alpha_weighted(),
            LiftRule::CentrePixel => pass.centre_pixel(),
        };
        out.visible = projected.len();
        out
    }
}

pub(super) fn check(picture: &LabelledView<'_>) -> Result<(), LiftError> {
    let View { width, height, .. } = *picture.view;
    if !(1..=MAX_LEVELS).contains(&picture.levels.len()) {
        let problem = format!("{} maps, 1 to {MAX_LEVELS} are expected", picture.levels.len());
        return Err(LiftError::argument("levels", problem));
    }
    for map in picture.levels {
        if (map.width(), map.height()) != (width, height) {
            let (w, h) = (map.width(), map.height());
            let problem = format!("is {w}×{h}, the camera {width}×{height}");
            return Err(LiftError::argument("segment map", problem));
        }
    }
    if let Some((depth, tolerance)) = picture.depth {
        tolerance.check()?;
        if depth.len() != picture.view.pixels() {
            let problem = format!("has {} values, the camera {width}×{height}", depth.len());
            return Err(LiftError::argument("depth", problem));
        }
    }
    Ok(())
}

/// What one pass over the pixels reads.
struct Pass<'a> {
    projected: &'a Projected,
    lists: &'a TileLists,
    picture: &'a LabelledView<'a>,
    settings: &'a RasterSettings,
    /// See [`DepthTolerance::ranges`]; empty if the picture has no depth.
    ranges: &'a [[f32; 2]],
}

impl Pass<'_> {
    fn alpha_weighted(&self) -> ViewWeights {
        if self.picture.depth.is_some() { self.tiles::<true>() } else { self.tiles::<false>() }
    }

    fn tiles<const DEPTH: bool>(&self) -> ViewWeights {
        let Self { projected, lists, picture, settings, ranges } = *self;
        let sums = blend(projected, lists, picture.view, settings, |rect| {
            let segments = TileSegments::new(picture.levels, rect, DEPTH);
            let listed = lists.offsets[rect.tile + 1] - lists.offsets[rect.tile];
            // Most Gaussians meet one or two segments in a tile.
            let expected = if segments.tuples.len() == 1 { listed } else { listed * 3 / 2 };
            let depths = picture.depth.map(|(depth, _)| tile_depths(depth, picture.view, rect));
            AlphaWeighted::<DEPTH>::new(segments, expected, ranges, depths, settings.isa())
        });
        self.merge(&sums)
    }

    /// Joins the sums of the tiles. Each of a few tasks has some of the rows and looks for them in all
    /// tiles, which takes less time than to sort all of them first.
    fn merge(&self, tiles: &[TileSums]) -> ViewWeights {
        const FEWEST_ROWS: usize = 512;
        const MOST_TASKS: usize = 8;
        let rows = self.projected.len();
        let step = rows.div_ceil(rayon::current_num_threads().min(MOST_TASKS)).max(FEWEST_ROWS);
        let tasks = (0..rows.div_ceil(step)).into_par_iter().with_max_len(1);
        let parts =
            tasks.map(|task| self.merge_rows(tiles, task * step..rows.min((task + 1) * step)));
        let mut out = self.nothing();
        for part in parts.collect::<Vec<_>>() {
            out.totals.extend(part.totals);
            out.levels.iter_mut().zip(part.levels).for_each(|(to, from)| to.extend(from));
        }
        out
    }

    fn merge_rows(&self, tiles: &[TileSums], rows: Range<usize>) -> ViewWeights {
        let count = rows.len();
        // Rows below the first wrap around to more than the last.
        let place_of = |weight: &TileWeight| (weight.row as usize).wrapping_sub(rows.start);
        let mut starts = vec![0u32; count + 1];
        for weight in tiles.iter().flat_map(|t| &t.weights) {
            let place = place_of(weight);
            if place < count {
                starts[place + 1] += 1;
            }
        }
        for place in 0..count {
            starts[place + 1] += starts[place];
        }
        let mut next = starts.clone();
        let mut sorted = vec![(NOWHERE, 0.0f32); starts[count] as usize];
        for tile in tiles {
            for weight in &tile.weights {
                let place = place_of(weight);
                if place < count {
                    let at = &mut next[place];
                    sorted[*at as usize] = (tile.tuples[weight.tuple as usize], weight.weight);
                    *at += 1;
                }
            }
        }
        let mut out = self.nothing();
        for (row, ends) in rows.clone().zip(starts.windows(2)) {
            let weights = &sorted[ends[0] as usize..ends[1] as usize];
            merge_row(self.projected.index[row], weights, &mut out);
        }
        out
    }

    fn nothing(&self) -> ViewWeights {
        ViewWeights { levels: vec![Vec::new(); self.picture.levels.len()], ..Default::default() }
    }

    fn centre_pixel(&self) -> ViewWeights {
        let Self { projected, lists, picture, settings, ranges } = *self;
        let pixels = CentrePixels::new(projected, picture.view);
        let make = |rect| CentrePixel::new(&pixels, rect);
        let tiles = blend(projected, lists, picture.view, settings, make);
        // A center is in one tile: no Gaussian is there twice.
        let mut found: Vec<(u32, f32)> = tiles.concat();
        found.sort_unstable_by_key(|&(row, _)| row);
        let count = picture.levels.len();
        let mut out = ViewWeights { levels: vec![Vec::new(); count], ..Default::default() };
        for (row, weight) in found {
            let (gaussian, i) = (projected.index[row as usize], row as usize);
            out.totals.push((gaussian, weight));
            let [x, y] = pixels.weight_pixel(row);
            if let Some((depth, _)) = picture.depth {
                let d = known(depth[y as usize * picture.view.width as usize + x as usize]);
                let [least, largest] = ranges[i];
                if !(d >= least && d <= largest) {
                    continue;
                }
            }
            let [x, y] = CentrePixels::segment_pixel(projected.mean2d[i], picture.view);
            for (map, level) in picture.levels.iter().zip(&mut out.levels) {
                let segment = map.at(x, y);
                if segment != NO_SEGMENT {
                    level.push(SegmentWeight { gaussian, segment: segment.into(), weight });
                }
            }
        }
        out
    }
}

/// Adds up the weights of one Gaussian by segment, in the order of the tiles.
fn merge_row(gaussian: u32, weights: &[(SegmentTuple, f32)], out: &mut ViewWeights) {
    if weights.is_empty() {
        return;
    }
    out.totals.push((gaussian, weights.iter().map(|w| w.1).sum()));
    for (level, list) in out.levels.iter_mut().enumerate() {
        let first = list.len();
        for &(tuple, weight) in weights {
            let segment = u32::from(tuple[level]);
            if segment == u32::from(NO_SEGMENT) {
                continue;
            }
            // A Gaussian meets few segments: a search from the end beats sorting.
            let at = list[first..].partition_point(|w| w.segment < segment) + first;
            match list.get_mut(at) {
                Some(known) if known.segment == segment => known.weight += weight,
                _ => list.insert(at, SegmentWeight { gaussian, segment, weight }),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn depth_deviations_are_those_of_the_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for size in [1e-4f32, 1.0, 1e4] {
            let mut random = |low: f32| rng.random_range(low..1.0);
            let gaussians = Gaussians {
                means: vec![[0.0; 3]],
                // Of any length.
                quats: vec![[0; 4].map(|_| 30.0 * random(-1.0))],
                scales: vec![[0; 3].map(|_| size * random(0.01))],
                ..Gaussians::default()
            };
            let axis = [0.48f32, -0.6, 0.64];
            // The covariance as a sum over the axes turned by q v q⁻¹, in f64.
            let [w, x, y, z] = gaussians.quats[0].map(f64::from);
            let norm = w * w + x * x + y * y + z * z;
            let turned = |v: [f64; 3]| {
                let cross = |a: [f64; 3], b: [f64; 3]| {
                    [
                        a[1] * b[2] - a[2] * b[1],
                        a[2] * b[0] - a[0] * b[2],
                        a[0] * b[1] - a[1] * b[0],
                    ]
                };
                let q = [x, y, z];
                let t = cross(q, v);
                let u = cross(q, t);
                [0, 1, 2].map(|i: usize| v[i] + 2.0 * (w * t[i] + u[i]) / norm)
            };
            let units = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let variance: f64 = (0..3)
                .map(|k| {
                    let a = turned(units[k]);
                    let along: f64 = (0..3).map(|i| a[i] * f64::from(axis[i])).sum();
                    (along * f64::from(gaussians.scales[0][k])).powi(2)
                })
                .sum();
            let (got, expected) =
                (f64::from(deviation(&gaussians, 0, axis, true)), variance.sqrt());
            assert!((got / expected - 1.0).abs() < 1e-5, "{got} {expected}");
            // A quaternion of length 1 is drawn as it is.
            let length = norm.sqrt() as f32;
            let unit = Gaussians {
                quats: vec![gaussians.quats[0].map(|v| v / length)],
                ..gaussians.clone()
            };
            let as_it_is = f64::from(deviation(&unit, 0, axis, false));
            assert!((as_it_is / expected - 1.0).abs() < 1e-5, "{as_it_is} {expected}");
            assert!(
                (f64::from(deviation(&gaussians, 0, axis, false)) / expected - 1.0).abs() > 0.1
            );
        }
    }
}

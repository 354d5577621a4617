//! Weights per Gaussian and segment of one picture.

use super::LiftError;
use super::alpha_weighted::{AlphaWeighted, TileSums};
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

/// Which pixels of a picture label a Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LiftRule {
    /// All that show it, each with its blending weight `α T`.
    #[default]
    AlphaWeighted,
    /// The one pixel up to one pixel left of and above its centre, with the weight there, and the
    /// segment of the pixel its centre is in: half a pixel apart, as in Occam's LGS (70d2e69) and
    /// the fork of gsplat 1.4 it uses (5791713). Its constants are
    /// [`RasterSettings::gsplat_1_4`]. A Gaussian whose centre is hidden or outside the picture gets
    /// no label from it.
    CentrePixel,
}

/// When the depth of a pixel agrees with that of a Gaussian: `|z − D| ≤ relative · z + absolute`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthTolerance {
    /// Part of the Gaussian's depth, in `0..1`.
    pub relative: f32,
    /// Units of the world, ≥ 0.
    pub absolute: f32,
}

impl Default for DepthTolerance {
    /// 3 % and 5 cm: what depth cameras err by indoors.
    fn default() -> Self {
        Self { relative: 0.03, absolute: 0.05 }
    }
}

impl DepthTolerance {
    pub(super) fn check(&self) -> Result<(), LiftError> {
        let relative = (0.0..1.0).contains(&self.relative);
        if relative && self.absolute >= 0.0 && self.absolute.is_finite() {
            return Ok(());
        }
        let problem = format!(
            "{} of the depth and {} units; a part in 0..1 and a length from 0 are expected",
            self.relative, self.absolute
        );
        Err(LiftError::argument("depth tolerance", problem))
    }
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

/// Depths of Gaussians that agree with the pixels of one tile, row by row.
#[derive(Debug)]
pub(super) struct DepthBounds {
    pub(super) low: [[f32; TILE]; TILE],
    pub(super) high: [[f32; TILE]; TILE],
}

impl DepthBounds {
    fn new(depth: &[f32], tolerance: DepthTolerance, view: &View, rect: TileRect) -> Box<Self> {
        let nothing = [[f32::INFINITY; TILE]; TILE];
        let mut out = Box::new(Self { low: nothing, high: [[0.0; TILE]; TILE] });
        for r in 0..rect.height as usize {
            let start = (rect.y0 as usize + r) * view.width as usize + rect.x0 as usize;
            for (c, &d) in depth[start..start + rect.width as usize].iter().enumerate() {
                let [low, high] = bounds(d, tolerance);
                (out.low[r][c], out.high[r][c]) = (low, high);
            }
        }
        out
    }
}

/// `|z − D| ≤ r z + a` solved for `z`.
fn bounds(depth: f32, tolerance: DepthTolerance) -> [f32; 2] {
    if !(depth > 0.0 && depth.is_finite()) {
        return [f32::INFINITY, 0.0];
    }
    let DepthTolerance { relative, absolute } = tolerance;
    [(depth - absolute) / (1.0 + relative), (depth + absolute) / (1.0 - relative)]
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
    let projected = project(gaussians, picture.view, settings)?;
    let lists = tile_lists(&projected, picture.view, settings);
    let rendered;
    let mut picture = *picture;
    if let Some(tolerance) = own {
        rendered = median_depth(&projected, &lists, picture.view, settings);
        picture.depth = Some((&rendered, tolerance));
    }
    let pass = Pass { projected: &projected, lists: &lists, picture: &picture, settings };
    let mut out = match rule {
        LiftRule::AlphaWeighted => pass.alpha_weighted(),
        LiftRule::CentrePixel => pass.centre_pixel(),
    };
    out.visible = projected.len();
    Ok(out)
}

fn check(picture: &LabelledView<'_>) -> Result<(), LiftError> {
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
}

impl Pass<'_> {
    fn alpha_weighted(&self) -> ViewWeights {
        if self.picture.depth.is_some() { self.tiles::<true>() } else { self.tiles::<false>() }
    }

    fn tiles<const DEPTH: bool>(&self) -> ViewWeights {
        let Self { projected, lists, picture, settings } = *self;
        let sums = blend(projected, lists, picture.view, settings, |rect| {
            let segments = TileSegments::new(picture.levels, rect, DEPTH);
            let listed = lists.offsets[rect.tile + 1] - lists.offsets[rect.tile];
            // Most Gaussians meet one or two segments in a tile.
            let expected = if segments.tuples.len() == 1 { listed } else { listed * 3 / 2 };
            let bounds = picture
                .depth
                .map(|(depth, tolerance)| DepthBounds::new(depth, tolerance, picture.view, rect));
            AlphaWeighted::<DEPTH>::new(segments, expected, &projected.depth, bounds)
        });
        self.merge(&sums)
    }

    /// Joins the sums of the tiles.
    fn merge(&self, tiles: &[TileSums]) -> ViewWeights {
        let rows = self.projected.len();
        let mut starts = vec![0u32; rows + 1];
        for weight in tiles.iter().flat_map(|t| &t.weights) {
            starts[weight.row as usize + 1] += 1;
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut next = starts.clone();
        let mut sorted = vec![(NOWHERE, 0.0f32); starts[rows] as usize];
        for tile in tiles {
            for weight in &tile.weights {
                let place = &mut next[weight.row as usize];
                sorted[*place as usize] = (tile.tuples[weight.tuple as usize], weight.weight);
                *place += 1;
            }
        }
        const ROWS_PER_TASK: usize = 4096;
        let count = self.picture.levels.len();
        let tasks = (0..rows.div_ceil(ROWS_PER_TASK)).into_par_iter().map(|task| {
            let mut out = ViewWeights { levels: vec![Vec::new(); count], ..Default::default() };
            for row in task * ROWS_PER_TASK..rows.min((task + 1) * ROWS_PER_TASK) {
                let weights = &sorted[starts[row] as usize..starts[row + 1] as usize];
                merge_row(self.projected.index[row], weights, &mut out);
            }
            out
        });
        let mut out = ViewWeights { levels: vec![Vec::new(); count], ..Default::default() };
        for part in tasks.collect::<Vec<_>>() {
            out.totals.extend(part.totals);
            out.levels.iter_mut().zip(part.levels).for_each(|(to, from)| to.extend(from));
        }
        out
    }

    fn centre_pixel(&self) -> ViewWeights {
        let Self { projected, lists, picture, settings } = *self;
        let pixels = CentrePixels::new(projected, picture.view);
        let make = |rect| CentrePixel::new(&pixels, rect);
        let tiles = blend(projected, lists, picture.view, settings, make);
        // A centre is in one tile: no Gaussian is there twice.
        let mut found: Vec<(u32, f32)> = tiles.concat();
        found.sort_unstable_by_key(|&(row, _)| row);
        let count = picture.levels.len();
        let mut out = ViewWeights { levels: vec![Vec::new(); count], ..Default::default() };
        for (row, weight) in found {
            let (gaussian, i) = (projected.index[row as usize], row as usize);
            out.totals.push((gaussian, weight));
            let [x, y] = pixels.weight_pixel(row);
            if let Some((depth, tolerance)) = picture.depth {
                let at = y as usize * picture.view.width as usize + x as usize;
                let [low, high] = bounds(depth[at], tolerance);
                if !(projected.depth[i] >= low && projected.depth[i] <= high) {
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

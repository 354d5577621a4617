//! Which way is up: the one answer for pictures, networks and reports.
//!
//! No splat format says it. Six directions are weighed by what a floor leaves behind: a slab that
//! covers the ground plan, most rows low, flat Gaussians that lie level.

use crate::bounds::{Bounds, robust_bounds};
use crate::quantile::quantile;
use crate::quaternion::axes_by_size;
use crate::vector::rotation;
use crate::{GaussianScene, UpAxis};
use serde::Serialize;

/// Rows that the guess looks at.
const SAMPLE: usize = 200_000;

/// Cells per side in which the coverage of a level surface is counted.
const CELLS: usize = 24;

/// Thickness of the slab in which a floor is looked for, in units of the longest side.
const SLAB: f64 = 0.04;

/// A Gaussian is flat when its shortest axis is so much shorter than the middle one, in ln.
const FLAT: f32 = 1.0;

/// A surface faces an axis when the cosine between them exceeds this: within 26°.
const FACING: f32 = 0.9;

/// A surface that faces no axis is plumb to one when its normal leans toward it by less: 12°.
const PLUMB: f32 = 0.2;

/// Share of the surface that must face no axis before plumb surfaces say anything; what random
/// normals would give stands in for less.
const FEWEST_SLANTED: f64 = 0.01;
const RANDOM_PLUMB: f64 = 0.2;

/// Rows nearer to a face of the box, in units of the longest side, are its walls; the others are
/// inside.
const WALL: f64 = 0.06;

/// What each kind of evidence is worth. Set on fourteen scenes and ten furnished rooms whose up is
/// known; only the order of the directions comes from them.
const COVER_WEIGHT: f64 = 0.5;
const BELOW_WEIGHT: f64 = 0.8;
const STANDING_WEIGHT: f64 = 0.6;
const LEVEL_WEIGHT: f64 = 0.3;
const PLUMB_WEIGHT: f64 = 0.5;
const FLOOR_WEIGHT: f64 = 0.5;
const TALL_WEIGHT: f64 = 0.3;
const HABIT_WEIGHT: f64 = 0.1;

/// One side this much longer than both others is taken for the height of something that stands.
const TALL: f64 = 1.6;

/// The direction that seems to be up.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UpGuess {
    /// The direction.
    pub axis: UpAxis,
    /// How sure, 0..=1: how far its score leads. Below [`UpGuess::SURE`] it is no more than a habit.
    pub confidence: f64,
    /// Whether the user said so; then the confidence is 1.
    pub given: bool,
    /// What speaks for it.
    pub evidence: String,
    /// All directions, the best first; empty if given.
    pub candidates: Vec<UpEvidence>,
}

/// What speaks for one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UpEvidence {
    /// The direction.
    pub axis: UpAxis,
    /// Weighted sum of what follows, and of the shape.
    pub score: f64,
    /// Share of the ground plan that the lowest slab covers: a floor.
    pub floor_cover: f64,
    /// Share of the rows in the lower half.
    pub below: f64,
    /// Share of the surface of flat Gaussians that is level.
    pub level: f64,
    /// Share of the surface of flat Gaussians that is level and in the lowest slab.
    pub floor: f64,
    /// Of the rows away from all faces of the box, the share in the lowest third less that in the
    /// highest, −1..=1: furniture stands on a floor, and hangs from nothing.
    pub standing: f64,
    /// Of the surface that faces no axis, the share that is plumb: whatever is turned about the
    /// vertical, and walls that no axis follows.
    pub plumb: f64,
}

/// A row that the guess looks at.
struct Look {
    /// Position in the robust box, 0..=1 along each axis.
    place: [f64; 3],
    /// Whether it is away from all faces of the box.
    is_inside: bool,
    /// The normal of a flat one.
    normal: Option<[f32; 3]>,
    /// Visible surface, m²; 0 if it is not flat.
    surface: f32,
}

/// Which way is up in a scene, by [`robust_bounds`] of all its rows.
///
/// The same for any number of threads. Without rows or extent a habit answers, at confidence 0.
pub fn guess_up(scene: &GaussianScene) -> UpGuess {
    guess_up_within(scene, &robust_bounds(&scene.coord))
}

/// As [`guess_up`], of a scene whose robust bounds are known.
pub fn guess_up_within(scene: &GaussianScene, robust: &Bounds) -> UpGuess {
    let looks = look(scene, robust);
    let habit = habit(robust);
    let mut candidates = UpAxis::ALL.map(|up| weigh(&looks, robust, up));
    let room = roominess(&looks, &candidates);
    for candidate in &mut candidates {
        candidate.score = score(candidate, robust, room)
            + if candidate.axis == habit { HABIT_WEIGHT } else { 0.0 };
    }
    // Stable: of equals the first axis of the list wins, whatever the threads.
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    let [best, second, ..] = candidates;
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let evidence = format!(
        "the lowest {} cover {} of the ground plan, {} of the rows lie in the lower half, {} of the \
         surface is level, {} of what is slanted is plumb; next best is {}",
        percent(SLAB),
        percent(best.floor_cover),
        percent(best.below),
        percent(best.level),
        percent(best.plumb),
        second.axis.name()
    );
    UpGuess {
        axis: best.axis,
        confidence: (best.score - second.score).clamp(0.0, 1.0),
        given: false,
        evidence,
        candidates: candidates.to_vec(),
    }
}

impl UpGuess {
    /// From this confidence on a network's input is turned by it. The least that ten furnished rooms
    /// have, however they lie, is 0.29.
    pub const SURE: f64 = 0.25;

    /// Whether it is more than a habit.
    pub fn is_sure(&self) -> bool {
        self.confidence >= Self::SURE
    }

    /// The direction that the user names.
    pub fn given(axis: UpAxis) -> Self {
        Self {
            axis,
            confidence: 1.0,
            given: true,
            evidence: "as given".to_owned(),
            candidates: Vec::new(),
        }
    }
}

/// What a shape of this kind usually is: rooms are flat along z; objects from image-based pipelines
/// stand along y, which points down.
fn habit(robust: &Bounds) -> UpAxis {
    let [x, y, z] = robust.extent();
    if z <= 0.8 * x.max(y) && y < 1.6 * x { UpAxis::PlusZ } else { UpAxis::MinusY }
}

fn look(scene: &GaussianScene, robust: &Bounds) -> Vec<Look> {
    let extent = robust.extent();
    let share_of = |a: usize, length: f64| if extent[a] > 0.0 { length / extent[a] } else { 0.0 };
    let wall = [0, 1, 2].map(|a| share_of(a, WALL * robust.largest_extent()));
    let step = scene.len().div_ceil(SAMPLE).max(1);
    let mut looks: Vec<Look> = (0..scene.len())
        .step_by(step)
        .filter(|&row| robust.distance(scene.coord[row]) == 0.0)
        .map(|row| {
            let above = |a: usize| f64::from(scene.coord[row][a]) - robust.low[a];
            let place = [0, 1, 2].map(|a| share_of(a, above(a)));
            let is_inside = (0..3).all(|a| place[a] > wall[a] && place[a] < 1.0 - wall[a]);
            let (normal, surface) = flat(scene, row).unzip();
            Look { place, is_inside, normal, surface: surface.unwrap_or(0.0) }
        })
        .collect();
    // A few huge discs, a backdrop say, must not outweigh the scene.
    let mut surfaces: Vec<f32> = looks.iter().map(|l| l.surface).filter(|s| *s > 0.0).collect();
    let most = quantile(&mut surfaces, 0.99).unwrap_or(0.0);
    looks.iter_mut().for_each(|l| l.surface = l.surface.min(most));
    looks
}

/// The normal of a flat Gaussian and its visible surface; `None` if it is not flat.
fn flat(scene: &GaussianScene, row: usize) -> Option<([f32; 3], f32)> {
    let scale = scene.log_scale[row];
    let [shortest, middle, longest] = axes_by_size(scale);
    if scale[middle] - scale[shortest] < FLAT || scale[middle] == f32::NEG_INFINITY {
        return None;
    }
    // Columns of the rotation matrix are the principal axes.
    let axis = rotation(scene.quat[row]).map(|r| r[shortest]);
    let surface = (scale[middle] + scale[longest]).exp() * scene.opacity(row);
    surface.is_finite().then_some((axis, surface))
}

/// All evidence for a direction, without its sum.
fn weigh(looks: &[Look], robust: &Bounds, up: UpAxis) -> UpEvidence {
    let (axis, is_positive) = up.axis();
    let extent = robust.extent();
    let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
    // A slab as thick as the scene is flat says nothing.
    let slab = (SLAB * robust.largest_extent() / extent[axis].max(f64::MIN_POSITIVE)).min(0.25);
    let cell = |share: f64| ((share * CELLS as f64) as usize).min(CELLS - 1);
    let (mut any, mut low) = ([false; CELLS * CELLS], [false; CELLS * CELLS]);
    let (mut below, mut inside, mut standing) = (0usize, 0usize, 0i64);
    let (mut surface, mut level, mut floor, mut slanted, mut plumb) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for l in looks {
        let height = if is_positive { l.place[axis] } else { 1.0 - l.place[axis] };
        let at = cell(l.place[u]) * CELLS + cell(l.place[v]);
        let is_low = height <= slab;
        any[at] = true;
        low[at] |= is_low;
        below += usize::from(height < 0.5);
        if l.is_inside {
            inside += 1;
            standing += i64::from(height < 1.0 / 3.0) - i64::from(height > 2.0 / 3.0);
        }
        let own = f64::from(l.surface);
        surface += own;
        let Some(normal) = l.normal else { continue };
        if normal[axis].abs() > FACING {
            level += own;
            floor += if is_low { own } else { 0.0 };
        } else if normal.iter().all(|n| n.abs() <= FACING) {
            slanted += own;
            plumb += if normal[axis].abs() < PLUMB { own } else { 0.0 };
        }
    }
    let count = |cells: &[bool]| cells.iter().filter(|&&c| c).count() as f64;
    let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
    let is_flat = extent[axis] <= 0.0;
    let tells = slanted > FEWEST_SLANTED * surface;
    UpEvidence {
        axis: up,
        score: 0.0,
        floor_cover: if is_flat { 0.0 } else { share(count(&low), count(&any)) },
        below: if is_flat { 0.5 } else { share(below as f64, looks.len() as f64) },
        level: share(level, surface),
        floor: share(floor, surface),
        standing: share(standing as f64, inside as f64),
        plumb: if tells { share(plumb, slanted) } else { RANDOM_PLUMB },
    }
}

/// How much a scene is a room, 0..=1: closed on five sides at least, with something inside. What
/// fills an object says nothing about its up.
fn roominess(looks: &[Look], evidence: &[UpEvidence]) -> f64 {
    let mut covers: Vec<f64> = evidence.iter().map(|e| e.floor_cover).collect();
    covers.sort_by(f64::total_cmp);
    let fifth = covers.get(1).copied().unwrap_or(0.0);
    let inside = looks.iter().filter(|l| l.is_inside).count() as f64 / looks.len().max(1) as f64;
    ((fifth - 0.4) / 0.4).clamp(0.0, 1.0) * ((inside - 0.07) / 0.07).clamp(0.0, 1.0)
}

fn score(evidence: &UpEvidence, robust: &Bounds, room: f64) -> f64 {
    let (axis, _) = evidence.axis.axis();
    let extent = robust.extent();
    let others = (0..3).filter(|&a| a != axis).map(|a| extent[a]).fold(0.0, f64::max);
    COVER_WEIGHT * evidence.floor_cover
        + BELOW_WEIGHT * (evidence.below - 0.5)
        + STANDING_WEIGHT * room * evidence.standing
        + LEVEL_WEIGHT * evidence.level
        + FLOOR_WEIGHT * evidence.floor
        + PLUMB_WEIGHT * evidence.plumb
        // A corridor is long too, but closed at its ends.
        + if extent[axis] > TALL * others { TALL_WEIGHT * (1.0 - evidence.floor_cover) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flat Gaussians with a normal along z.
    fn flat(coord: Vec<[f32; 3]>) -> GaussianScene {
        GaussianScene {
            log_scale: vec![[-3.0, -3.0, f32::NEG_INFINITY]; coord.len()],
            quat: vec![[1.0, 0.0, 0.0, 0.0]; coord.len()],
            opacity_logit: vec![f32::INFINITY; coord.len()],
            sh_dc: vec![[0.0; 3]; coord.len()],
            coord,
            ..GaussianScene::default()
        }
    }

    /// A floor of 2 × 1.6 m with a column of 1 m on it.
    fn column() -> GaussianScene {
        let cell = |i: u16, n: u16| [f32::from(i % n) * 0.05, f32::from(i / n) * 0.05];
        let floor = (0..40 * 32).map(|i| [cell(i, 40)[0], cell(i, 40)[1], 0.0]);
        let column = (0..20 * 16).map(|i| [1.0, 0.5 + 0.02 * f32::from(i % 16), cell(i, 16)[1]]);
        flat(floor.chain(column).collect())
    }

    #[test]
    fn a_floor_is_found_however_the_scene_lies() {
        for up in UpAxis::ALL {
            let m = up.upright();
            let transposed = [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[j][i]));
            let mut scene = column();
            scene.transform(&crate::Similarity {
                rotation: transposed,
                scale: 1.0,
                translation: [3.0, -2.0, 7.0],
            });
            let guess = guess_up(&scene);
            assert_eq!(guess.axis, up, "{guess:?}");
            assert!(guess.is_sure() && !guess.given, "{guess:?}");
        }
    }

    #[test]
    fn points_and_planes_have_an_up_too() {
        for coord in [
            Vec::new(),
            vec![[1.0, 2.0, 3.0]],
            (0..400u16).map(|i| [f32::from(i % 20), f32::from(i / 20), 0.0]).collect(),
            vec![[1e30, -1e30, 0.0], [f32::MAX, f32::MIN, 1.0]],
        ] {
            let guess = guess_up(&flat(coord));
            assert!(guess.candidates.iter().all(|c| c.score.is_finite()), "{guess:?}");
            assert!((0.0..=1.0).contains(&guess.confidence));
        }
    }
}

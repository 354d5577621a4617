//! What speaks for a direction to be up: what a floor leaves behind.

use super::direction::Up;
use super::surface::Surface;
use crate::bounds::Bounds;
use crate::frame::{Matrix3, matrix};
use crate::quantile::quantile;
use glam::DMat3;
use serde::Serialize;

/// Cells per side in which the coverage of a level surface is counted.
const CELLS: usize = 24;

/// Thickness of the slab in which a floor is looked for, in units of the longest side.
const SLAB: f64 = 0.04;

/// A surface faces an axis when the cosine between them exceeds this: within 26°.
const FACING: f64 = 0.9;

/// A surface that faces no axis is plumb to one when its normal leans toward it by less: 12°.
const PLUMB: f64 = 0.2;

/// Share of the surface that must face no axis before plumb surfaces say anything; what random
/// normals would give stands in for less.
const FEWEST_SLANTED: f64 = 0.01;
const RANDOM_PLUMB: f64 = 0.2;

/// Pieces nearer to a face of the box, in units of the longest side, are its walls; the others are
/// inside.
const WALL: f64 = 0.06;

/// Share of the pieces, at each end of an axis, that the box leaves out.
const FRINGE: f64 = 0.005;

/// What each kind of evidence is worth. Set on fourteen scenes and ten furnished rooms whose up is
/// known; only the order of the directions comes from them.
const COVER_WEIGHT: f64 = 0.5;
const BELOW_WEIGHT: f64 = 0.8;
const STANDING_WEIGHT: f64 = 0.6;
const LEVEL_WEIGHT: f64 = 0.3;
const PLUMB_WEIGHT: f64 = 0.5;
const FLOOR_WEIGHT: f64 = 0.5;
const TALL_WEIGHT: f64 = 0.3;

/// One side this much longer than both others is taken for the height of something that stands.
const TALL: f64 = 1.6;

/// What speaks for one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UpEvidence {
    /// The direction.
    #[serde(rename = "axis")]
    pub direction: Up,
    /// Weighted sum of what follows, of the shape, and of what the file says.
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

/// A piece in the frame of a direction and its opposite.
struct Look {
    /// Place in the box, 0..=1 along each axis.
    place: [f64; 3],
    /// Whether it is away from all faces of the box.
    is_inside: bool,
    /// Unit normal; zero for what is round.
    normal: [f64; 3],
    area: f64,
}

/// A scene in a frame whose third axis is a direction that may be up, or down.
struct Framed {
    extent: [f64; 3],
    looks: Vec<Look>,
}

/// What speaks for a direction and for its opposite. `rows`: the frame, its third row the direction.
pub(super) fn weigh_both(surface: &Surface, direction: Up, rows: &Matrix3) -> [UpEvidence; 2] {
    let framed = Framed::new(surface, &matrix(rows));
    let room = framed.roominess();
    [(direction, true), (direction.opposite(), false)].map(|(up, is_positive)| {
        let evidence = framed.weigh(up, is_positive);
        UpEvidence { score: framed.score(&evidence, room), ..evidence }
    })
}

impl Framed {
    fn new(surface: &Surface, turn: &DMat3) -> Self {
        let places: Vec<[f64; 3]> =
            surface.pieces.iter().map(|p| (*turn * p.place).to_array()).collect();
        let bounds = inner_bounds(&places);
        let extent = bounds.extent();
        let share_of =
            |a: usize, length: f64| if extent[a] > 0.0 { length / extent[a] } else { 0.0 };
        let wall = [0, 1, 2].map(|a| share_of(a, WALL * bounds.largest_extent()));
        let looks = surface
            .pieces
            .iter()
            .zip(&places)
            .filter(|(_, place)| bounds.distance(place.map(|v| v as f32)) == 0.0)
            .map(|(piece, place)| {
                let place =
                    [0, 1, 2].map(|a| share_of(a, place[a] - bounds.low[a]).clamp(0.0, 1.0));
                let is_inside = (0..3).all(|a| place[a] > wall[a] && place[a] < 1.0 - wall[a]);
                let normal = (*turn * piece.normal).to_array();
                Look { place, is_inside, normal, area: piece.area }
            })
            .collect();
        Self { extent, looks }
    }

    fn longest(&self) -> f64 {
        self.extent.into_iter().fold(0.0, f64::max)
    }

    /// Depth of a slab along an axis, in units of the box; as thick as the scene is flat it says nothing.
    fn slab(&self, axis: usize) -> f64 {
        (SLAB * self.longest() / self.extent[axis].max(f64::MIN_POSITIVE)).min(0.25)
    }

    /// Share of the plan along an axis that the slab at one of its ends covers.
    fn cover(&self, axis: usize, at_low: bool) -> f64 {
        if self.extent[axis] <= 0.0 {
            return 0.0;
        }
        let [u, v] = [[1, 2], [0, 2], [0, 1]][axis];
        let slab = self.slab(axis);
        let cell = |share: f64| ((share * CELLS as f64) as usize).min(CELLS - 1);
        let (mut any, mut near) = ([false; CELLS * CELLS], [false; CELLS * CELLS]);
        for l in &self.looks {
            let depth = if at_low { l.place[axis] } else { 1.0 - l.place[axis] };
            let at = cell(l.place[u]) * CELLS + cell(l.place[v]);
            any[at] = true;
            near[at] |= depth <= slab;
        }
        let count = |cells: &[bool]| cells.iter().filter(|&&c| c).count() as f64;
        share(count(&near), count(&any))
    }

    /// All evidence for up along the third axis or against it, without its sum.
    fn weigh(&self, direction: Up, is_positive: bool) -> UpEvidence {
        let slab = self.slab(2);
        let (mut below, mut inside, mut standing) = (0usize, 0usize, 0i64);
        let (mut surface, mut level, mut floor, mut slanted, mut plumb) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for l in &self.looks {
            let height = if is_positive { l.place[2] } else { 1.0 - l.place[2] };
            below += usize::from(height < 0.5);
            if l.is_inside {
                inside += 1;
                standing += i64::from(height < 1.0 / 3.0) - i64::from(height > 2.0 / 3.0);
            }
            surface += l.area;
            let lean = l.normal[2].abs();
            if lean > FACING {
                level += l.area;
                floor += if height <= slab { l.area } else { 0.0 };
            } else if l.normal.iter().all(|n| n.abs() <= FACING) {
                slanted += l.area;
                plumb += if lean < PLUMB { l.area } else { 0.0 };
            }
        }
        let is_flat = self.extent[2] <= 0.0;
        let tells = slanted > FEWEST_SLANTED * surface;
        UpEvidence {
            direction,
            score: 0.0,
            floor_cover: self.cover(2, is_positive),
            below: if is_flat { 0.5 } else { share(below as f64, self.looks.len() as f64) },
            level: share(level, surface),
            floor: share(floor, surface),
            standing: share(standing as f64, inside as f64),
            plumb: if tells { share(plumb, slanted) } else { RANDOM_PLUMB },
        }
    }

    /// How much a scene is a room, 0..=1: closed on five sides at least, with something inside. What
    /// fills an object says nothing about its up.
    fn roominess(&self) -> f64 {
        let sides = [0, 1, 2].into_iter().flat_map(|a| [(a, true), (a, false)]);
        let mut covers: Vec<f64> = sides.map(|(axis, low)| self.cover(axis, low)).collect();
        covers.sort_by(f64::total_cmp);
        let inside = self.looks.iter().filter(|l| l.is_inside).count() as f64;
        let inside = inside / self.looks.len().max(1) as f64;
        ((covers[1] - 0.4) / 0.4).clamp(0.0, 1.0) * ((inside - 0.07) / 0.07).clamp(0.0, 1.0)
    }

    fn score(&self, evidence: &UpEvidence, room: f64) -> f64 {
        let [x, y, height] = self.extent;
        // A corridor is long too, but closed at its ends.
        let is_tall = height > TALL * x.max(y);
        COVER_WEIGHT * evidence.floor_cover
            + BELOW_WEIGHT * (evidence.below - 0.5)
            + STANDING_WEIGHT * room * evidence.standing
            + LEVEL_WEIGHT * evidence.level
            + FLOOR_WEIGHT * evidence.floor
            + PLUMB_WEIGHT * evidence.plumb
            + if is_tall { TALL_WEIGHT * (1.0 - evidence.floor_cover) } else { 0.0 }
    }
}

/// The box of all places but a few at each end of an axis.
pub(super) fn inner_bounds(places: &[[f64; 3]]) -> Bounds {
    let span = |axis: usize| {
        let mut values: Vec<f32> = places.iter().map(|p| p[axis] as f32).collect();
        [FRINGE, 1.0 - FRINGE].map(|s| quantile(&mut values, s).map_or(0.0, f64::from))
    };
    let spans = [0, 1, 2].map(span);
    Bounds { low: spans.map(|s| s[0]), high: spans.map(|s| s[1]) }
}

fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
}

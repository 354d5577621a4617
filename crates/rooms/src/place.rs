//! Where things stand: boxes that must not overlap, and ways to find a free place.

use crate::dice::{between, chance, small_turn, weighted, whole};
use crate::model::Model;
use crate::shape::Block;
use crate::vector::V3;
use scenesplat_kernels::random::{SampleRng, cos_sin};

/// Places tried before an object is left out.
const TRIES: u32 = 40;

/// Boxes may overlap by this much, meters: things that touch are not in each other.
pub(crate) const TOUCH: f64 = 0.004;

/// Where an object stands and which way its x axis points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pose {
    pub(crate) origin: V3,
    /// Cosine and sine of the turn about z.
    pub(crate) turn: [f64; 2],
}

impl Pose {
    pub(crate) fn vector(&self, [x, y, z]: V3) -> V3 {
        let [c, s] = self.turn;
        [c * x - s * y, s * x + c * y, z]
    }

    pub(crate) fn point(&self, p: V3) -> V3 {
        let v = self.vector(p);
        std::array::from_fn(|i| self.origin[i] + v[i])
    }

    /// The place `at` in this frame, turned further by `turn`.
    pub(crate) fn then(&self, at: V3, turn: [f64; 2]) -> Self {
        let ([a, b], [c, s]) = (self.turn, turn);
        Self { origin: self.point(at), turn: [a * c - b * s, b * c + a * s] }
    }
}

/// Half a turn.
pub(crate) const BACKWARDS: [f64; 2] = [-1.0, 0.0];
/// No turn.
pub(crate) const STRAIGHT: [f64; 2] = [1.0, 0.0];
/// Turns by right angles.
const QUARTERS: [[f64; 2]; 4] = [STRAIGHT, [0.0, 1.0], BACKWARDS, [0.0, -1.0]];

/// An upright box, turned about z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Footprint {
    centre: [f64; 2],
    half: [f64; 2],
    turn: [f64; 2],
    z: [f64; 2],
}

impl Footprint {
    pub(crate) fn of(block: &Block, pose: &Pose) -> Self {
        let [x, y, _] = pose.point(block.middle());
        Self {
            centre: [x, y],
            half: [0, 1].map(|i| (block.high[i] - block.low[i]) / 2.0),
            turn: pose.turn,
            z: [block.low[2], block.high[2]].map(|z| z + pose.origin[2]),
        }
    }

    fn corners(&self) -> [[f64; 2]; 4] {
        let [c, s] = self.turn;
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            let (x, y) = (x * self.half[0], y * self.half[1]);
            [self.centre[0] + c * x - s * y, self.centre[1] + s * x + c * y]
        })
    }

    /// Whether the boxes share more than `TOUCH` in every direction.
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        if self.z[0].max(other.z[0]) + TOUCH > self.z[1].min(other.z[1]) {
            return false;
        }
        let apart = [self.centre[0] - other.centre[0], self.centre[1] - other.centre[1]];
        let reach = |axis: [f64; 2], b: &Self| {
            let [c, s] = b.turn;
            b.half[0] * (axis[0] * c + axis[1] * s).abs()
                + b.half[1] * (axis[1] * c - axis[0] * s).abs()
        };
        // Upright boxes are apart if they are along one of their four sides.
        [self.turn, [-self.turn[1], self.turn[0]], other.turn, [-other.turn[1], other.turn[0]]]
            .into_iter()
            .all(|axis| {
                let between = (axis[0] * apart[0] + axis[1] * apart[1]).abs();
                between + TOUCH < reach(axis, self) + reach(axis, other)
            })
    }

    /// How far out a point of the plan is: the square of 0 in the middle to 1 on the ellipse inside
    /// the box.
    pub(crate) fn distance_squared(&self, [x, y]: [f64; 2]) -> f64 {
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let [c, s] = self.turn;
        let along = (dx * c + dy * s) / self.half[0].max(1e-6);
        let across = (dy * c - dx * s) / self.half[1].max(1e-6);
        along * along + across * across
    }

    /// Lowest and highest z.
    pub(crate) fn z(&self) -> [f64; 2] {
        self.z
    }
}

/// A straight wall; its inside is to the left of its direction.
#[derive(Debug, Clone)]
pub(crate) struct Wall {
    pub(crate) start: [f64; 2],
    /// Unit.
    pub(crate) along: [f64; 2],
    pub(crate) length: f64,
    /// `[from, to, low, high]` of each hole, meters.
    pub(crate) openings: Vec<[f64; 4]>,
    /// How far behind its face its back is, meters; none where another room is behind it.
    pub(crate) back: Option<f64>,
}

impl Wall {
    /// The frame of something on the wall, `at` meters along it and `z` high.
    pub(crate) fn pose(&self, at: f64, off: f64, z: f64) -> Pose {
        let [x, y] = self.along;
        let origin = [self.start[0] + x * at - y * off, self.start[1] + y * at + x * off, z];
        Pose { origin, turn: self.along }
    }
}

/// An object with its place.
#[derive(Debug, Clone)]
pub(crate) struct Placed {
    pub(crate) model: Model,
    pub(crate) pose: Pose,
    pub(crate) footprints: Vec<Footprint>,
}

/// A room being furnished.
#[derive(Debug)]
pub(crate) struct Layout {
    /// Extent of the plan, meters.
    pub(crate) size: [f64; 2],
    pub(crate) height: f64,
    pub(crate) walls: Vec<Wall>,
    pub(crate) objects: Vec<Placed>,
    /// The corner that an L-shaped room lacks.
    pub(crate) notch: Option<Footprint>,
    /// Before doors and windows nothing stands.
    pub(crate) kept_free: Vec<Footprint>,
}

impl Layout {
    /// Whether nothing is where the boxes are, and they are inside the room.
    pub(crate) fn is_free(&self, footprints: &[Footprint]) -> bool {
        footprints.iter().all(|f| self.contains(f))
            && footprints.iter().all(|f| {
                !self.kept_free.iter().any(|k| k.overlaps(f))
                    && !self.objects.iter().any(|o| o.footprints.iter().any(|b| b.overlaps(f)))
            })
    }

    /// Whether somebody can stand there: before a door, too.
    pub(crate) fn can_stand(&self, footprint: &Footprint) -> bool {
        self.contains(footprint)
            && !self.objects.iter().any(|o| o.footprints.iter().any(|b| b.overlaps(footprint)))
    }

    fn contains(&self, footprint: &Footprint) -> bool {
        let inside = |v: f64, most: f64| (-1e-9..=most + 1e-9).contains(&v);
        footprint.corners().iter().all(|c| inside(c[0], self.size[0]) && inside(c[1], self.size[1]))
            && footprint.z[1] <= self.height + 1e-9
            && !self.notch.is_some_and(|n| n.overlaps(footprint))
    }

    /// Puts a part of the building there: it bounds the room and takes no place in it.
    pub(crate) fn put_flat(&mut self, model: Model, pose: Pose) {
        self.objects.push(Placed { model, pose, footprints: Vec::new() });
    }

    /// Puts an object there if the place is free; gives it back if not.
    pub(crate) fn try_put(&mut self, model: Model, pose: Pose) -> Result<usize, Model> {
        let footprints: Vec<_> = model.occupied().iter().map(|b| Footprint::of(b, &pose)).collect();
        if !self.is_free(&footprints) {
            return Err(model);
        }
        self.objects.push(Placed { model, pose, footprints });
        Ok(self.objects.len() - 1)
    }

    /// Tries places until one is free.
    pub(crate) fn search(
        &mut self,
        mut model: Model,
        rng: &mut SampleRng,
        mut place: impl FnMut(&Self, &Block, &mut SampleRng) -> Option<Pose>,
    ) -> Option<usize> {
        let block = model.extent();
        for _ in 0..TRIES {
            let Some(pose) = place(self, &block, rng) else { continue };
            match self.try_put(model, pose) {
                Ok(index) => return Some(index),
                Err(back) => model = back,
            }
        }
        None
    }

    /// With its back to a wall, often in a corner, `z` above the floor.
    pub(crate) fn against_wall(
        &mut self,
        model: Model,
        z: [f64; 2],
        rng: &mut SampleRng,
    ) -> Option<usize> {
        self.search(model, rng, |layout, block, rng| {
            let wall = layout.any_wall(rng);
            let z = between(rng, z[0], z[1]);
            let gap = if z > 0.0 { 0.002 } else { between(rng, 0.005, 0.04) };
            let room = [0.015 - block.low[0], wall.length - block.high[0] - 0.015];
            if room[1] <= room[0] {
                return None;
            }
            let at = match whole(rng, 0, 9) {
                0 | 1 if z == 0.0 => room[0] + between(rng, 0.0, 0.05).min(room[1] - room[0]),
                2 | 3 if z == 0.0 => room[1] - between(rng, 0.0, 0.05).min(room[1] - room[0]),
                _ => between(rng, room[0], room[1]),
            };
            Some(wall.pose(at, gap - block.low[1], z))
        })
    }

    fn any_wall(&self, rng: &mut SampleRng) -> &Wall {
        let lengths: Vec<f64> = self.walls.iter().map(|w| w.length).collect();
        &self.walls[weighted(rng, &lengths)]
    }

    /// Anywhere on the floor, mostly in line with the walls.
    pub(crate) fn on_floor(&mut self, model: Model, rng: &mut SampleRng) -> Option<usize> {
        self.search(model, rng, |layout, _, rng| {
            let [x, y] = layout.size.map(|side| between(rng, 0.1, side - 0.1));
            Some(Pose { origin: [x, y, 0.0], turn: any_turn(rng) })
        })
    }

    /// Near the middle of the room.
    pub(crate) fn in_middle(&mut self, model: Model, rng: &mut SampleRng) -> Option<usize> {
        self.search(model, rng, |layout, _, rng| {
            let [x, y] = layout.size.map(|s| s * between(rng, 0.3, 0.7));
            let turn = QUARTERS[whole(rng, 0, 3) as usize];
            let by = small_turn(rng, 0.1);
            Some(Pose { origin: [x, y, 0.0], turn }.then([0.0; 3], by))
        })
    }

    /// On a support of an object, anywhere and turned a little, or as `turn` says.
    pub(crate) fn on_top(
        &mut self,
        parent: usize,
        support: usize,
        model: Model,
        turn: Option<[f64; 2]>,
        rng: &mut SampleRng,
    ) -> Option<usize> {
        let pose = self.objects[parent].pose;
        let support = *self.objects[parent].model.supports.get(support)?;
        self.search(model, rng, |_, block, rng| {
            let turn = turn.unwrap_or_else(|| any_turn(rng));
            let [c, s] = turn.map(f64::abs);
            let half = [0, 1].map(|i| block.high[i].abs().max(block.low[i].abs()));
            let half = [c * half[0] + s * half[1], s * half[0] + c * half[1]];
            let place = |i: usize, rng: &mut SampleRng| {
                let (low, high) = (support.low[i] + half[i], support.high[i] - half[i]);
                (low <= high).then(|| between(rng, low, high))
            };
            let (x, y) = (place(0, rng)?, place(1, rng)?);
            (block.high[2] <= support.clearance).then(|| pose.then([x, y, support.z + 0.002], turn))
        })
    }

    /// On a support at a given place in the parent's frame.
    pub(crate) fn on_top_at(
        &mut self,
        parent: usize,
        support: usize,
        at: [f64; 2],
        turn: [f64; 2],
        model: Model,
    ) -> Option<usize> {
        let pose = self.objects[parent].pose;
        let support = *self.objects[parent].model.supports.get(support)?;
        let block = model.extent();
        let fits = (0..2).all(|i| {
            at[i] + block.low[i] > support.low[i] - 0.04
                && at[i] + block.high[i] < support.high[i] + 0.04
        });
        if !fits {
            return None;
        }
        self.try_put(model, pose.then([at[0], at[1], support.z + 0.002], turn)).ok()
    }

    /// Beside, before or behind an object: `at` in its frame, tried in order.
    pub(crate) fn near(
        &mut self,
        parent: usize,
        mut model: Model,
        places: &[([f64; 2], [f64; 2])],
    ) -> Option<usize> {
        let pose = self.objects[parent].pose;
        for &(at, turn) in places {
            let there = Pose { origin: [pose.origin[0], pose.origin[1], 0.0], turn: pose.turn };
            match self.try_put(model, there.then([at[0], at[1], 0.0], turn)) {
                Ok(index) => return Some(index),
                Err(back) => model = back,
            }
        }
        None
    }
}

/// Mostly in quarter turns.
fn any_turn(rng: &mut SampleRng) -> [f64; 2] {
    if chance(rng, 0.3) {
        return cos_sin(rng);
    }
    let quarter = QUARTERS[whole(rng, 0, 3) as usize];
    let [c, s] = small_turn(rng, 0.15);
    [quarter[0] * c - quarter[1] * s, quarter[1] * c + quarter[0] * s]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn footprint(centre: V3, turn: [f64; 2]) -> Footprint {
        let block = Block { low: [-0.5, -0.25, 0.0], high: [0.5, 0.25, 1.0] };
        Footprint::of(&block, &Pose { origin: centre, turn })
    }

    #[test]
    fn turned_boxes_overlap_only_where_they_do() {
        let at = |x, y| footprint([x, y, 0.0], STRAIGHT);
        assert!(at(0.0, 0.0).overlaps(&at(0.9, 0.4)));
        assert!(!at(0.0, 0.0).overlaps(&at(1.0, 0.0)), "they touch");
        assert!(!at(0.0, 0.0).overlaps(&footprint([0.0, 0.0, 1.0], STRAIGHT)));
        // Turned by 45°, its corner reaches 0.53 m.
        let turned = footprint([0.0, 0.9, 0.0], [0.5_f64.sqrt(), 0.5_f64.sqrt()]);
        assert!(!at(0.0, 0.0).overlaps(&turned));
        let turned = footprint([0.0, 0.7, 0.0], [0.5_f64.sqrt(), 0.5_f64.sqrt()]);
        assert!(at(0.0, 0.0).overlaps(&turned) && turned.overlaps(&at(0.0, 0.0)));
        assert!(turned.distance_squared([0.0, 0.7]) < 1e-12);
        assert!((at(0.0, 0.0).distance_squared([0.5, 0.25]) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn poses_follow_one_another() {
        let pose = Pose { origin: [1.0, 2.0, 0.0], turn: [0.0, 1.0] };
        assert_eq!(pose.point([1.0, 0.0, 0.5]), [1.0, 3.0, 0.5]);
        let next = pose.then([1.0, 0.0, 0.0], BACKWARDS);
        assert_eq!(next.point([1.0, 0.0, 0.0]), [1.0, 2.0, 0.0]);
    }

    #[test]
    fn things_on_a_wall_look_inwards() {
        let wall = Wall {
            start: [4.0, 0.0],
            along: [0.0, 1.0],
            length: 3.0,
            openings: vec![],
            back: None,
        };
        let pose = wall.pose(1.0, 0.2, 0.5);
        assert!((pose.origin[0] - 3.8).abs() < 1e-12 && pose.origin[1] == 1.0);
        assert_eq!(pose.vector([0.0, 1.0, 0.0]), [-1.0, 0.0, 0.0]);
    }
}

//! What kinds of rooms there are and what stands in them.

use super::classes::ClassId;
use super::dice::{between, chance, pick, small_turn, weighted, whole};
use super::furniture::{
    bathroom, bedroom, decoration, electronics, kitchen, lighting, openings, seating, small,
    storage, tables,
};
use super::model::{Build, Model};
use super::place::{BACKWARDS, Layout, STRAIGHT, around};
use super::shell::{Plan, build};
use crate::rng::SampleRng;
use serde::{Deserialize, Serialize};

/// What a room is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RoomKind {
    /// Sofa, television, dining table.
    Living,
    /// Bed, nightstands, wardrobe.
    Bedroom,
    /// Desks with computers.
    Office,
    /// Run of cabinets with sink and stove.
    Kitchen,
    /// Toilet, washbasin, bathtub.
    Bathroom,
    /// A flat of one room: two of the others together, sometimes with a bathtub or a sink.
    Mixed,
}

impl RoomKind {
    /// All kinds.
    pub const ALL: [Self; 6] =
        [Self::Living, Self::Bedroom, Self::Office, Self::Kitchen, Self::Bathroom, Self::Mixed];

    /// Chosen so that each class is in a tenth of the rooms or more.
    const WEIGHTS: [f64; 6] = [0.17, 0.17, 0.15, 0.16, 0.17, 0.18];

    pub(super) fn random(rng: &mut SampleRng) -> Self {
        Self::ALL[weighted(rng, &Self::WEIGHTS)]
    }

    /// Smallest and largest side of the plan, metres.
    fn sides(self) -> [f64; 2] {
        match self {
            Self::Living => [3.4, 6.0],
            Self::Bedroom => [3.0, 5.0],
            Self::Office => [2.9, 5.4],
            Self::Kitchen => [2.7, 5.0],
            Self::Bathroom => [2.1, 3.5],
            Self::Mixed => [4.2, 6.8],
        }
    }
}

/// Builds and furnishes a room.
pub(super) fn furnish(kind: RoomKind, rng: &mut SampleRng) -> Layout {
    let [short, long] = kind.sides();
    let size = [between(rng, short, long), between(rng, short, long)];
    let is_l = kind != RoomKind::Bathroom && size[0].min(size[1]) > 3.3 && chance(rng, 0.3);
    let notch = is_l.then(|| size.map(|s| s * between(rng, 0.25, 0.45)));
    let plan = Plan {
        size,
        height: between(rng, 2.25, 3.2),
        notch,
        is_wet: kind == RoomKind::Bathroom,
        has_ceiling: chance(rng, 0.7),
    };
    let mut layout = build(&plan, rng);
    let mut room = Room { layout: &mut layout, rng };
    match kind {
        RoomKind::Living => room.living(),
        RoomKind::Bedroom => room.bedroom(),
        RoomKind::Office => room.office(),
        RoomKind::Kitchen => room.kitchen(),
        RoomKind::Bathroom => room.bathroom(),
        RoomKind::Mixed => room.mixed(),
    }
    room.extras(kind);
    room.clutter();
    layout
}

struct Room<'a> {
    layout: &'a mut Layout,
    rng: &'a mut SampleRng,
}

impl Room<'_> {
    fn likely(&mut self, probability: f64) -> bool {
        chance(self.rng, probability)
    }

    fn at_wall(&mut self, build: Build) -> Option<usize> {
        let model = build(self.rng);
        self.layout.against_wall(model, [0.0, 0.0], self.rng)
    }

    /// On a wall, its middle between these heights.
    fn hang(&mut self, build: Build, z: [f64; 2]) -> Option<usize> {
        let model = build(self.rng);
        self.layout.against_wall(model, z, self.rng)
    }

    fn on_floor(&mut self, build: Build) -> Option<usize> {
        let model = build(self.rng);
        self.layout.on_floor(model, self.rng)
    }

    fn living(&mut self) {
        let sofa = self.at_wall(seating::sofa);
        if let Some(sofa) = sofa {
            self.before_sofa(sofa);
            self.pillows(sofa, 0);
        }
        self.television();
        if self.likely(0.6) {
            self.dining();
        }
        for (build, probability) in [
            (storage::bookshelf as Build, 0.7),
            (storage::cabinet, 0.5),
            (decoration::plant, 0.7),
            (lighting::floor_lamp, 0.7),
            (storage::bookshelf, 0.3),
            (seating::chair, 0.3),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
        if self.likely(0.3) {
            self.at_wall(seating::sofa);
        }
    }

    /// A coffee table, a rug under it, a lamp or a stool beside.
    fn before_sofa(&mut self, sofa: usize) {
        let block = around(&self.layout.objects[sofa].model);
        if self.likely(0.85) {
            let table = tables::coffee_table(self.rng);
            let deep = table.bounds().high[1];
            let off = block.high[1] + deep + between(self.rng, 0.25, 0.5);
            let side = between(self.rng, -0.25, 0.25);
            let turn = small_turn(self.rng, 0.05);
            self.layout.near(sofa, table, &[([side, off], turn), ([0.0, off + 0.2], turn)]);
        }
        if self.likely(0.6) {
            self.rug_at(sofa, [0.0, block.high[1] + 0.5]);
        }
        if self.likely(0.4) {
            let lamp = lighting::floor_lamp(self.rng);
            let (left, right) = (block.low[0] - 0.3, block.high[0] + 0.3);
            self.layout.near(sofa, lamp, &[([left, -0.1], STRAIGHT), ([right, -0.1], BACKWARDS)]);
        }
    }

    fn rug_at(&mut self, parent: usize, at: [f64; 2]) {
        let half = [between(self.rng, 0.6, 1.4), between(self.rng, 0.45, 0.95)];
        let rug = decoration::rug(half, self.rng);
        let nudged = [at[0], at[1] + 0.3];
        self.layout.near(parent, rug, &[(at, STRAIGHT), (nudged, STRAIGHT)]);
    }

    fn pillows(&mut self, parent: usize, support: usize) {
        for _ in 0..whole(self.rng, 1, 4) {
            let pillow = bedroom::pillow(self.rng);
            let turn = small_turn(self.rng, 0.2);
            self.layout.on_top(parent, support, pillow, Some(turn), self.rng);
        }
    }

    /// A TV on a stand, or on the wall above it.
    fn television(&mut self) {
        let Some(stand) = self.at_wall(storage::tv_stand) else { return };
        let wide = 2.0 * self.layout.objects[stand].model.bounds().high[0];
        let size = (wide * between(self.rng, 0.5, 0.85)).clamp(0.7, 1.45);
        if self.likely(0.6) {
            let tv = electronics::standing_tv(size, self.rng);
            self.layout.on_top_at(stand, 0, [0.0, -0.02], STRAIGHT, tv);
        } else {
            let tv = electronics::wall_tv(size, self.rng);
            let (pose, back) = {
                let object = &self.layout.objects[stand];
                (object.pose, object.model.bounds().low[1])
            };
            let z = between(self.rng, 0.75, 1.15);
            let pose = pose.then([0.0, back + 0.03, z], STRAIGHT);
            let _ = self.layout.try_put(tv, pose);
        }
    }

    /// A table with chairs or stools around it.
    fn dining(&mut self) {
        let table = tables::table(self.rng);
        let placed = if self.likely(0.7) {
            self.layout.in_middle(table, self.rng)
        } else {
            self.layout.against_wall(table, [0.0, 0.0], self.rng)
        };
        let Some(table) = placed else { return };
        self.chairs_around(table);
        if self.likely(0.25) {
            self.rug_at(table, [0.0, 0.0]);
        }
    }

    fn chairs_around(&mut self, table: usize) {
        let bounds = self.layout.objects[table].model.bounds();
        let [x, y, _] = bounds.high;
        let first = seating::chair(self.rng);
        let stool = seating::stool(self.rng);
        let use_stools = self.likely(0.2);
        let per_side = if x > 0.8 { 2 } else { 1 };
        for side in [1.0, -1.0] {
            for i in 0..per_side {
                if self.likely(0.12) {
                    continue;
                }
                let at = if per_side == 2 { (f64::from(i) - 0.5) * x * 0.95 } else { 0.0 };
                // Mostly a set of equal chairs, sometimes a stray one.
                let seat = match (use_stools, self.likely(0.1)) {
                    (_, true) => seating::chair(self.rng),
                    (true, _) => stool.clone(),
                    _ => first.clone(),
                };
                self.pull_up(table, seat, [at, side * y], side);
            }
        }
        if x > 0.75 && self.likely(0.4) {
            let turn = [0.0, 1.0];
            let near = x + between(self.rng, 0.2, 0.35);
            self.layout.near(table, first, &[([near, 0.0], turn), ([near + 0.2, 0.0], turn)]);
        }
    }

    /// A seat at the edge of a table, as far under it as it goes, facing it.
    fn pull_up(&mut self, table: usize, seat: Model, [x, y]: [f64; 2], side: f64) {
        let facing = if side > 0.0 { BACKWARDS } else { STRAIGHT };
        let [c, s] = small_turn(self.rng, 0.25);
        let turn = [facing[0] * c, facing[0] * s];
        let tucked = between(self.rng, -0.05, 0.3);
        let steps = [0.0, 0.12, 0.25, 0.4, 0.6];
        let places = steps.map(|step| ([x, y + side * (tucked + step)], turn));
        self.layout.near(table, seat, &places);
    }

    fn bedroom(&mut self) {
        let bed = self.at_wall(bedroom::bed);
        if let Some(bed) = bed {
            self.beside_bed(bed);
            self.pillows(bed, 0);
            if self.likely(0.3) {
                self.pillows(bed, 1);
            }
            if self.likely(0.5) {
                let side = if self.likely(0.5) { 1.0 } else { -1.0 };
                let wide = self.layout.objects[bed].model.bounds().high[0];
                self.rug_at(bed, [side * (wide + 0.55), 0.3]);
            }
        }
        if self.likely(0.85) {
            self.at_wall(storage::wardrobe);
        }
        if self.likely(0.6) {
            let chest = self.at_wall(storage::cabinet);
            if let Some(chest) = chest.filter(|_| chance(self.rng, 0.5)) {
                self.above(chest, decoration::mirror, 0.62);
            }
        }
        if self.likely(0.4) {
            self.workplace();
        }
        for (build, probability) in [
            (seating::chair as Build, 0.4),
            (lighting::floor_lamp, 0.3),
            (storage::bookshelf, 0.3),
            (decoration::plant, 0.4),
            (seating::stool, 0.25),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
        if self.likely(0.25) {
            self.television();
        }
    }

    /// Nightstands at the head, with a lamp or a clock.
    fn beside_bed(&mut self, bed: usize) {
        let bounds = self.layout.objects[bed].model.bounds();
        let first = bedroom::nightstand(self.rng);
        for side in [-1.0, 1.0] {
            if !self.likely(0.85) {
                continue;
            }
            let stand =
                if self.likely(0.8) { first.clone() } else { bedroom::nightstand(self.rng) };
            let block = around(&stand);
            let gap = between(self.rng, 0.03, 0.1);
            let x = side * (bounds.high[0] + block.high[0] + gap);
            let y = bounds.low[1] - block.low[1] + 0.01;
            let places = [([x, y], STRAIGHT), ([x, y + 0.08], STRAIGHT)];
            let Some(stand) = self.layout.near(bed, stand, &places) else { continue };
            if self.likely(0.6) {
                let lamp = lighting::table_lamp(self.rng);
                self.layout.on_top(stand, 0, lamp, None, self.rng);
            }
            if self.likely(0.4) {
                let clock = small::standing_clock(self.rng);
                self.layout.on_top(stand, 0, clock, Some(STRAIGHT), self.rng);
            }
        }
    }

    /// Something on the wall above an object that stands at it.
    fn above(&mut self, parent: usize, build: Build, gap: f64) -> Option<usize> {
        let model = build(self.rng);
        let block = around(&model);
        let object = &self.layout.objects[parent];
        let bounds = object.model.bounds();
        let z = bounds.high[2] + gap.max(0.05 - block.low[2]);
        let pose = object.pose.then([0.0, bounds.low[1] - block.low[1] + 0.003, z], STRAIGHT);
        self.layout.try_put(model, pose).ok()
    }

    /// A desk with a computer and a chair.
    fn workplace(&mut self) {
        let Some(desk) = self.at_wall(tables::desk) else { return };
        let [x, y, _] = self.layout.objects[desk].model.bounds().high;
        let screens = if self.likely(0.35) && x > 0.65 { 2 } else { 1 };
        if self.likely(0.85) {
            let twin = electronics::monitor(self.rng);
            for i in 0..screens {
                let at = if screens == 2 {
                    (f64::from(i) - 0.5) * x * 1.05
                } else {
                    between(self.rng, -0.1, 0.1)
                };
                let turn = small_turn(self.rng, 0.15);
                self.layout.on_top_at(desk, 0, [at, -y * 0.4], turn, twin.clone());
            }
            let keyboard = electronics::keyboard(self.rng);
            let turn = small_turn(self.rng, 0.1);
            let at = between(self.rng, -0.08, 0.08);
            // Keys look towards the chair, which is at the front of the desk.
            self.layout.on_top_at(desk, 0, [at, y * 0.55], turn, keyboard);
        }
        if self.likely(0.5) {
            let laptop = electronics::laptop(self.rng);
            let turn = small_turn(self.rng, 0.3);
            self.layout.on_top(desk, 0, laptop, Some(turn), self.rng);
        }
        if self.likely(0.4) {
            let mug = small::mug(self.rng);
            self.layout.on_top(desk, 0, mug, None, self.rng);
        }
        if self.likely(0.35) {
            let lamp = lighting::table_lamp(self.rng);
            self.layout.on_top(desk, 0, lamp, None, self.rng);
        }
        if self.likely(0.9) {
            let chair = seating::chair(self.rng);
            let at = between(self.rng, -0.1, 0.1);
            self.pull_up(desk, chair, [at, y], 1.0);
        }
        if self.likely(0.5) {
            let bin = small::trash_can(self.rng);
            let at = x + 0.25;
            self.layout.near(desk, bin, &[([at, 0.0], STRAIGHT), ([-at, 0.0], STRAIGHT)]);
        }
    }

    fn office(&mut self) {
        for _ in 0..whole(self.rng, 1, 4) {
            self.workplace();
        }
        for (build, probability) in [
            (storage::bookshelf as Build, 0.7),
            (storage::cabinet, 0.6),
            (decoration::plant, 0.5),
            (small::trash_can, 0.5),
            (lighting::floor_lamp, 0.25),
            (storage::bookshelf, 0.3),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
        if self.likely(0.3) {
            self.dining();
        }
        if self.likely(0.25) {
            self.at_wall(seating::sofa);
        }
    }

    fn kitchen(&mut self) {
        self.kitchen_run();
        if self.likely(0.8) {
            self.at_wall(kitchen::refrigerator);
        }
        if self.likely(0.75) {
            self.dining();
        }
        for (build, probability) in [
            (small::trash_can as Build, 0.6),
            (seating::stool, 0.4),
            (storage::cabinet, 0.25),
            (decoration::plant, 0.25),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
        if self.likely(0.5) {
            self.hang(small::wall_clock, [1.7, 2.0]);
        }
    }

    /// Base units in a row along a wall with a sink and a stove, cupboards and a hood above.
    fn kitchen_run(&mut self) {
        let style = kitchen::Style::new(self.rng);
        let order: Vec<usize> = {
            let mut walls: Vec<usize> = (0..self.layout.walls.len()).collect();
            walls.sort_by(|&a, &b| {
                self.layout.walls[b].length.total_cmp(&self.layout.walls[a].length)
            });
            if walls.len() > 1 && self.likely(0.5) {
                walls.swap(0, 1);
            }
            walls
        };
        let run = pick(self.rng, &[5, 6, 7]);
        let (sink_at, stove_at) = if self.likely(0.5) { (1, 3) } else { (3, 1) };
        for wall in order {
            let start = between(self.rng, 0.02, 0.3);
            if self.run_along(wall, start, (run, sink_at, stove_at), &style) >= 2 {
                return;
            }
        }
    }

    /// Number of units that found a place.
    fn run_along(
        &mut self,
        wall: usize,
        start: f64,
        (run, sink_at, stove_at): (usize, usize, usize),
        style: &kitchen::Style,
    ) -> usize {
        let wall = self.layout.walls[wall].clone();
        let mut at = start;
        let mut placed = 0;
        let mut slot = 0;
        let mut next_fails = 0;
        while slot < run && next_fails < 12 {
            let wide = if slot == stove_at { 0.6 } else { pick(self.rng, &[0.5, 0.6, 0.6, 0.8]) };
            let wide = if slot == sink_at { 0.8 } else { wide };
            if at + wide > wall.length - 0.02 {
                break;
            }
            let unit = if slot == stove_at {
                kitchen::stove(style, self.rng)
            } else {
                kitchen::base_unit(style, wide, slot == sink_at, self.rng)
            };
            let pose = wall.pose(at + wide / 2.0, style.deep / 2.0 + 0.01, 0.0);
            let Ok(base) = self.layout.try_put(unit, pose) else {
                // Past a door or a window; before the first unit the run just starts later.
                at += 0.25;
                next_fails += 1;
                continue;
            };
            placed += 1;
            if slot == sink_at {
                let sink = kitchen::kitchen_sink(self.rng);
                let _ = self.layout.try_put(sink, pose.then([0.0, 0.0, style.high], STRAIGHT));
            }
            self.over_unit(base, slot == stove_at, wide, style);
            at += wide + 0.008;
            slot += 1;
        }
        placed
    }

    fn over_unit(&mut self, base: usize, is_stove: bool, wide: f64, style: &kitchen::Style) {
        let pose = self.layout.objects[base].pose;
        let back = -style.deep / 2.0;
        if is_stove {
            let z = between(self.rng, 1.5, 1.65);
            let hood = kitchen::range_hood((self.layout.height - z).max(0.2), self.rng);
            let pose = pose.then([0.0, back + 0.25, z], STRAIGHT);
            let _ = self.layout.try_put(hood, pose);
        } else if self.likely(0.6) {
            let unit = kitchen::wall_unit(style, wide, self.rng);
            let pose = pose.then([0.0, back + 0.17, 1.45], STRAIGHT);
            let _ = self.layout.try_put(unit, pose);
        }
    }

    fn bathroom(&mut self) {
        if self.likely(0.8) {
            self.at_wall(bathroom::bathtub);
        }
        self.at_wall(bathroom::toilet);
        if let Some(sink) = self.at_wall(bathroom::sink) {
            self.above(sink, decoration::mirror, 0.5);
            if self.likely(0.2) {
                self.at_wall(bathroom::sink);
            }
        }
        for (build, probability) in [
            (storage::cabinet as Build, 0.3),
            (small::trash_can, 0.6),
            (seating::stool, 0.35),
            (decoration::plant, 0.3),
            (small::carton, 0.2),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
        if self.likely(0.5) {
            let heater = openings::radiator(between(self.rng, 0.5, 0.9), self.rng);
            self.layout.against_wall(heater, [0.0, 0.0], self.rng);
        }
        if self.likely(0.7) {
            let rug = decoration::rug(
                [between(self.rng, 0.3, 0.5), between(self.rng, 0.22, 0.35)],
                self.rng,
            );
            self.layout.on_floor(rug, self.rng);
        }
    }

    fn mixed(&mut self) {
        let first = whole(self.rng, 0, 3);
        let second = (first + whole(self.rng, 1, 3)) % 4;
        for kind in [first, second] {
            match kind {
                0 => self.living(),
                1 => self.bedroom(),
                2 => self.workplace(),
                _ => self.kitchen(),
            }
        }
        for (build, probability) in [
            (bathroom::sink as Build, 0.15),
            (bathroom::bathtub, 0.12),
            (bathroom::toilet, 0.1),
            (kitchen::refrigerator, 0.25),
        ] {
            if self.likely(probability) {
                self.at_wall(build);
            }
        }
    }

    /// What may be in any room: things on walls and ceiling, plants, boxes.
    fn extras(&mut self, kind: RoomKind) {
        let is_wet = kind == RoomKind::Bathroom;
        let pictures = if is_wet { whole(self.rng, 0, 1) } else { whole(self.rng, 0, 4) };
        for _ in 0..pictures {
            self.hang(decoration::picture, [1.35, 1.75]);
        }
        if self.likely(if is_wet { 0.15 } else { 0.22 }) {
            self.hang(decoration::mirror, [1.2, 1.6]);
        }
        if self.likely(0.3) {
            self.hang(small::wall_clock, [1.6, 2.0]);
        }
        let lamps = if self.likely(0.75) { whole(self.rng, 1, 2) } else { 0 };
        for _ in 0..lamps {
            self.ceiling_lamp();
        }
        if self.likely(0.2) {
            let heater = openings::radiator(between(self.rng, 0.6, 1.3), self.rng);
            self.layout.against_wall(heater, [0.0, 0.0], self.rng);
        }
        if !is_wet && self.likely(0.25) {
            let half = [between(self.rng, 0.5, 1.2), between(self.rng, 0.4, 0.8)];
            let rug = decoration::rug(half, self.rng);
            self.layout.on_floor(rug, self.rng);
        }
        for (build, probability) in [
            (decoration::plant as Build, 0.3),
            (small::carton, 0.4),
            (small::carton, 0.25),
            (small::trash_can, 0.25),
            (seating::stool, 0.12),
            (bedroom::nightstand, 0.06),
            (small::book, 0.1),
        ] {
            if self.likely(probability) {
                if self.likely(0.7) {
                    self.at_wall(build)
                } else {
                    self.on_floor(build)
                };
            }
        }
    }

    fn ceiling_lamp(&mut self) {
        let lamp = lighting::ceiling_lamp(self.layout.height - 2.0, self.rng);
        self.layout.search(lamp, self.rng, |layout, _, rng| {
            let [x, y] = layout.size.map(|s| s * between(rng, 0.25, 0.75));
            let turn = if chance(rng, 0.5) { STRAIGHT } else { [0.0, 1.0] };
            Some(super::place::Pose { origin: [x, y, layout.height - 0.001], turn })
        });
    }

    /// Small things on whatever has room for them.
    fn clutter(&mut self) {
        for parent in 0..self.layout.objects.len() {
            let class = self.layout.objects[parent].model.class;
            let (count, things): (u32, &[Build]) = match class {
                ClassId::Table => (
                    4,
                    &[
                        small::mug,
                        small::book,
                        decoration::pot_plant,
                        small::small_carton,
                        electronics::laptop,
                    ],
                ),
                ClassId::CoffeeTable => (3, &[small::mug, small::book, decoration::pot_plant]),
                ClassId::Desk => {
                    (3, &[small::book, small::mug, decoration::pot_plant, small::small_carton])
                }
                ClassId::Cabinet | ClassId::Nightstand | ClassId::TvStand => (
                    3,
                    &[
                        small::book,
                        decoration::pot_plant,
                        lighting::table_lamp,
                        small::small_carton,
                        small::standing_clock,
                    ],
                ),
                ClassId::KitchenCabinet => {
                    (1, &[small::mug, small::small_carton, decoration::pot_plant])
                }
                ClassId::Sofa => (1, &[small::book]),
                ClassId::Bed => (1, &[small::book, electronics::laptop]),
                _ => continue,
            };
            let supports = self.layout.objects[parent].model.supports.len();
            for _ in 0..whole(self.rng, 0, count) {
                if supports == 0 {
                    break;
                }
                let support = whole(self.rng, 0, supports as u32 - 1) as usize;
                let thing = pick(self.rng, things)(self.rng);
                let turn = matches!(thing.class, ClassId::Laptop | ClassId::Clock)
                    .then(|| small_turn(self.rng, 0.3));
                self.layout.on_top(parent, support, thing, turn, self.rng);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::sample_rng;

    #[test]
    fn nothing_stands_in_anything_else() {
        let mut num_objects = 0;
        for index in 0..120 {
            let mut rng = sample_rng(11, index, 0);
            let kind = RoomKind::random(&mut rng);
            let layout = furnish(kind, &mut rng);
            num_objects += layout.objects.len();
            for (i, a) in layout.objects.iter().enumerate() {
                for b in &layout.objects[..i] {
                    let overlap =
                        a.footprints.iter().any(|f| b.footprints.iter().any(|g| f.overlaps(g)));
                    let (a, b) = (a.model.class, b.model.class);
                    assert!(!overlap, "{kind:?} {index}: {a:?} in {b:?}");
                }
                let is_flat = a.footprints.is_empty();
                assert_eq!(
                    is_flat,
                    a.model.class.about().groups == [crate::synthetic::Group::Structure]
                );
            }
        }
        assert!(num_objects > 120 * 18, "{num_objects}");
    }
}

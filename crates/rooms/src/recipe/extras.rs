//! What may be in any room: things on walls and ceilings, boxes, and clutter on furniture.

use super::{Room, RoomKind};
use crate::classes::ClassId;
use crate::dice::{between, chance, pick, small_turn, whole};
use crate::furniture::decoration::pot_plant;
use crate::furniture::electronics::laptop;
use crate::furniture::lighting::table_lamp;
use crate::furniture::small::{book, mug, small_carton, standing_clock};
use crate::furniture::{bedroom, decoration, lighting, openings, seating, small};
use crate::model::Build;
use crate::place::{Pose, STRAIGHT};
use crate::stock::Place;

impl Room<'_> {
    /// What may be in any room: things on walls and ceiling, plants, boxes.
    pub(super) fn extras(&mut self, kind: RoomKind) {
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
            self.at_wall(|rng| openings::radiator(between(rng, 0.6, 1.3), rng));
        }
        if !is_wet && self.likely(0.25) {
            self.on_floor(|rng| {
                decoration::rug([between(rng, 0.5, 1.2), between(rng, 0.4, 0.8)], rng)
            });
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

    pub(super) fn ceiling_lamp(&mut self) {
        let longest = self.layout.height - 2.0;
        let lamp = self.make(|rng| lighting::ceiling_lamp(longest, rng), Place::Ceiling);
        self.layout.search(lamp, self.rng, |layout, _, rng| {
            let [x, y] = layout.size.map(|s| s * between(rng, 0.25, 0.75));
            let turn = if chance(rng, 0.5) { STRAIGHT } else { [0.0, 1.0] };
            Some(Pose { origin: [x, y, layout.height - 0.001], turn })
        });
    }

    /// Small things on whatever has room for them.
    pub(super) fn clutter(&mut self) {
        for parent in 0..self.layout.objects.len() {
            let Some(class) = self.layout.objects[parent].model.class else { continue };
            let (count, things): (u32, &[Build]) = match class {
                ClassId::Table => (4, &[mug, book, pot_plant, small_carton, laptop]),
                ClassId::CoffeeTable => (3, &[mug, book, pot_plant]),
                ClassId::Desk => (3, &[book, mug, pot_plant, small_carton]),
                ClassId::Cabinet | ClassId::Nightstand | ClassId::TvStand => {
                    (3, &[book, pot_plant, table_lamp, small_carton, standing_clock])
                }
                ClassId::KitchenCabinet => (1, &[mug, small_carton, pot_plant]),
                ClassId::Sofa => (1, &[book]),
                ClassId::Bed => (1, &[book, laptop]),
                _ => continue,
            };
            let supports = self.layout.objects[parent].model.supports.len();
            for _ in 0..whole(self.rng, 0, count) {
                if supports == 0 {
                    break;
                }
                let support = whole(self.rng, 0, supports as u32 - 1) as usize;
                let build = pick(self.rng, things);
                let thing = self.make(build, Place::Top);
                let turn = (thing.is(ClassId::Laptop) || thing.is(ClassId::Clock))
                    .then(|| small_turn(self.rng, 0.3));
                self.layout.on_top(parent, support, thing, turn, self.rng);
            }
        }
    }
}

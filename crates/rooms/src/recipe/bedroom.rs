//! Beds and what stands around them.

use super::Room;
use crate::dice::{between, chance};
use crate::furniture::{bedroom, decoration, lighting, seating, small, storage};
use crate::place::STRAIGHT;
use crate::stock::Place;

impl Room<'_> {
    pub(super) fn bedroom(&mut self) {
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
        self.some_at_wall(&[
            (seating::chair, 0.4),
            (lighting::floor_lamp, 0.3),
            (storage::bookshelf, 0.3),
            (decoration::plant, 0.4),
            (seating::stool, 0.25),
        ]);
        if self.likely(0.25) {
            self.television();
        }
    }

    /// Nightstands at the head, with a lamp or a clock.
    pub(super) fn beside_bed(&mut self, bed: usize) {
        let bounds = self.layout.objects[bed].model.bounds();
        let first = self.make(bedroom::nightstand, Place::Floor);
        for side in [-1.0, 1.0] {
            if !self.likely(0.85) {
                continue;
            }
            let stand = if self.likely(0.8) {
                first.clone()
            } else {
                self.make(bedroom::nightstand, Place::Floor)
            };
            let block = stand.extent();
            let gap = between(self.rng, 0.03, 0.1);
            let x = side * (bounds.high[0] + block.high[0] + gap);
            let y = bounds.low[1] - block.low[1] + 0.01;
            let places = [([x, y], STRAIGHT), ([x, y + 0.08], STRAIGHT)];
            let Some(stand) = self.layout.near(bed, stand, &places) else { continue };
            if self.likely(0.6) {
                let lamp = self.make(lighting::table_lamp, Place::Top);
                self.layout.on_top(stand, 0, lamp, None, self.rng);
            }
            if self.likely(0.4) {
                let clock = self.make(small::standing_clock, Place::Top);
                self.layout.on_top(stand, 0, clock, Some(STRAIGHT), self.rng);
            }
        }
    }
}

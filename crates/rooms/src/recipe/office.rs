//! Desks with computers.

use super::Room;
use crate::dice::{between, small_turn, whole};
use crate::furniture::{decoration, electronics, lighting, seating, small, storage, tables};
use crate::place::STRAIGHT;
use crate::stock::Place;

impl Room<'_> {
    /// A desk with a computer and a chair.
    pub(super) fn workplace(&mut self) {
        if let Some(desk) = self.at_wall(tables::desk) {
            self.workplace_on(desk);
        }
    }

    /// What is on a desk, a chair before it, a bin beside it.
    pub(super) fn workplace_on(&mut self, desk: usize) {
        let [x, y, _] = self.layout.objects[desk].model.bounds().high;
        let screens = if self.likely(0.35) && x > 0.65 { 2 } else { 1 };
        if self.likely(0.85) {
            let twin = self.make(electronics::monitor, Place::Top);
            for i in 0..screens {
                let at = if screens == 2 {
                    (f64::from(i) - 0.5) * x * 1.05
                } else {
                    between(self.rng, -0.1, 0.1)
                };
                let turn = small_turn(self.rng, 0.15);
                self.layout.on_top_at(desk, 0, [at, -y * 0.4], turn, twin.clone());
            }
            let keyboard = self.make(electronics::keyboard, Place::Top);
            let turn = small_turn(self.rng, 0.1);
            let at = between(self.rng, -0.08, 0.08);
            // Keys look toward the chair, which is at the front of the desk.
            self.layout.on_top_at(desk, 0, [at, y * 0.55], turn, keyboard);
        }
        if self.likely(0.5) {
            let laptop = self.make(electronics::laptop, Place::Top);
            let turn = small_turn(self.rng, 0.3);
            self.layout.on_top(desk, 0, laptop, Some(turn), self.rng);
        }
        if self.likely(0.4) {
            let mug = self.make(small::mug, Place::Top);
            self.layout.on_top(desk, 0, mug, None, self.rng);
        }
        if self.likely(0.35) {
            let lamp = self.make(lighting::table_lamp, Place::Top);
            self.layout.on_top(desk, 0, lamp, None, self.rng);
        }
        if self.likely(0.9) {
            let chair = self.make(seating::chair, Place::Floor);
            let at = between(self.rng, -0.1, 0.1);
            self.pull_up(desk, chair, [at, y], 1.0);
        }
        if self.likely(0.5) {
            let bin = self.make(small::trash_can, Place::Floor);
            let at = x + 0.25;
            self.layout.near(desk, bin, &[([at, 0.0], STRAIGHT), ([-at, 0.0], STRAIGHT)]);
        }
    }

    pub(super) fn office(&mut self) {
        for _ in 0..whole(self.rng, 1, 4) {
            self.workplace();
        }
        self.some_at_wall(&[
            (storage::bookshelf, 0.7),
            (storage::cabinet, 0.6),
            (decoration::plant, 0.5),
            (small::trash_can, 0.5),
            (lighting::floor_lamp, 0.25),
            (storage::bookshelf, 0.3),
        ]);
        if self.likely(0.3) {
            self.dining();
        }
        if self.likely(0.25) {
            self.at_wall(seating::sofa);
        }
    }
}

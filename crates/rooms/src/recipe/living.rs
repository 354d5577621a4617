//! Sofas, televisions and dining tables.

use super::Room;
use crate::dice::{between, small_turn, whole};
use crate::furniture::{bedroom, decoration, electronics, lighting, seating, storage, tables};
use crate::model::Model;
use crate::place::{BACKWARDS, STRAIGHT};
use crate::stock::Place;

impl Room<'_> {
    pub(super) fn living(&mut self) {
        let sofa = self.at_wall(seating::sofa);
        if let Some(sofa) = sofa {
            self.before_sofa(sofa);
            self.pillows(sofa, 0);
        }
        self.television();
        if self.likely(0.6) {
            self.dining();
        }
        self.some_at_wall(&[
            (storage::bookshelf, 0.7),
            (storage::cabinet, 0.5),
            (decoration::plant, 0.7),
            (lighting::floor_lamp, 0.7),
            (storage::bookshelf, 0.3),
            (seating::chair, 0.3),
        ]);
        if self.likely(0.3) {
            self.at_wall(seating::sofa);
        }
    }

    /// A coffee table, a rug under it, a lamp or a stool beside.
    pub(super) fn before_sofa(&mut self, sofa: usize) {
        let block = self.layout.objects[sofa].model.extent();
        if self.likely(0.85) {
            let table = self.make(tables::coffee_table, Place::Floor);
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
            let lamp = self.make(lighting::floor_lamp, Place::Floor);
            let (left, right) = (block.low[0] - 0.3, block.high[0] + 0.3);
            self.layout.near(sofa, lamp, &[([left, -0.1], STRAIGHT), ([right, -0.1], BACKWARDS)]);
        }
    }

    pub(super) fn rug_at(&mut self, parent: usize, at: [f64; 2]) {
        let half = [between(self.rng, 0.6, 1.4), between(self.rng, 0.45, 0.95)];
        let rug = self.make(|rng| decoration::rug(half, rng), Place::Floor);
        let nudged = [at[0], at[1] + 0.3];
        self.layout.near(parent, rug, &[(at, STRAIGHT), (nudged, STRAIGHT)]);
    }

    pub(super) fn pillows(&mut self, parent: usize, support: usize) {
        for _ in 0..whole(self.rng, 1, 4) {
            let pillow = self.make(bedroom::pillow, Place::Top);
            let turn = small_turn(self.rng, 0.2);
            self.layout.on_top(parent, support, pillow, Some(turn), self.rng);
        }
    }

    /// A TV on a stand, or on the wall above it.
    pub(super) fn television(&mut self) {
        let Some(stand) = self.at_wall(storage::tv_stand) else { return };
        let wide = 2.0 * self.layout.objects[stand].model.bounds().high[0];
        let size = (wide * between(self.rng, 0.5, 0.85)).clamp(0.7, 1.45);
        if self.likely(0.6) {
            let tv = self.make(|rng| electronics::standing_tv(size, rng), Place::Top);
            self.layout.on_top_at(stand, 0, [0.0, -0.02], STRAIGHT, tv);
        } else {
            let tv = self.make(|rng| electronics::wall_tv(size, rng), Place::Wall);
            let z = between(self.rng, 0.75, 1.15);
            let object = &self.layout.objects[stand];
            let back = object.model.bounds().low[1];
            let pose = object.pose.then([0.0, back + 0.03, z], STRAIGHT);
            let _ = self.layout.try_put(tv, pose);
        }
    }

    /// A table with chairs or stools around it.
    pub(super) fn dining(&mut self) {
        let table = self.make(tables::table, Place::Floor);
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

    pub(super) fn chairs_around(&mut self, table: usize) {
        let bounds = self.layout.objects[table].model.bounds();
        let [x, y, _] = bounds.high;
        let first = self.make(seating::chair, Place::Floor);
        let stool = self.make(seating::stool, Place::Floor);
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
                    (_, true) => self.make(seating::chair, Place::Floor),
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
    pub(super) fn pull_up(&mut self, table: usize, seat: Model, [x, y]: [f64; 2], side: f64) {
        let facing = if side > 0.0 { BACKWARDS } else { STRAIGHT };
        let [c, s] = small_turn(self.rng, 0.25);
        let turn = [facing[0] * c, facing[0] * s];
        let tucked = between(self.rng, -0.05, 0.3);
        let steps = [0.0, 0.12, 0.25, 0.4, 0.6];
        let places = steps.map(|step| ([x, y + side * (tucked + step)], turn));
        self.layout.near(table, seat, &places);
    }
}

//! Runs of kitchen cabinets.

use super::Room;
use crate::dice::{between, pick};
use crate::furniture::{decoration, kitchen, seating, small, storage};
use crate::place::STRAIGHT;
use crate::stock::Place;

impl Room<'_> {
    pub(super) fn kitchen(&mut self) {
        self.kitchen_run();
        if self.likely(0.8) {
            self.at_wall(kitchen::refrigerator);
        }
        if self.likely(0.75) {
            self.dining();
        }
        self.some_at_wall(&[
            (small::trash_can, 0.6),
            (seating::stool, 0.4),
            (storage::cabinet, 0.25),
            (decoration::plant, 0.25),
        ]);
        if self.likely(0.5) {
            self.hang(small::wall_clock, [1.7, 2.0]);
        }
    }

    /// Base units in a row along a wall with a sink and a stove, cupboards and a hood above.
    pub(super) fn kitchen_run(&mut self) {
        let style = kitchen::Style::new(self.rng);
        let mut order: Vec<usize> = (0..self.layout.walls.len()).collect();
        let length = |wall: usize| self.layout.walls[wall].length;
        order.sort_by(|&a, &b| length(b).total_cmp(&length(a)));
        if order.len() > 1 && self.likely(0.5) {
            order.swap(0, 1);
        }
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
    pub(super) fn run_along(
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
            // A basin needs a unit with a hole.
            let unit = if slot == sink_at { unit } else { self.stock.instead(unit, Place::Floor) };
            let (wide, deep) = match &unit.piece {
                None => (wide, style.deep),
                Some(piece) => {
                    let [wide, deep, _] = piece.bounds().size();
                    (wide, deep)
                }
            };
            if at + wide > wall.length - 0.02 {
                break;
            }
            let pose = wall.pose(at + wide / 2.0, deep / 2.0 + 0.01, 0.0);
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
            self.over_unit(base, slot == stove_at, [wide, deep], style);
            at += wide + 0.008;
            slot += 1;
        }
        placed
    }

    pub(super) fn over_unit(
        &mut self,
        base: usize,
        is_stove: bool,
        [wide, deep]: [f64; 2],
        style: &kitchen::Style,
    ) {
        let (part, off, z) = if is_stove {
            let z = between(self.rng, 1.5, 1.65);
            let reach_up = (self.layout.height - z).max(0.2);
            (self.make(|rng| kitchen::range_hood(reach_up, rng), Place::Wall), 0.25, z)
        } else if self.likely(0.6) {
            (self.make(|rng| kitchen::wall_unit(style, wide, rng), Place::Wall), 0.17, 1.45)
        } else {
            return;
        };
        let off = part.piece.as_ref().map_or(off, |piece| -piece.bounds().low[1]);
        let pose = self.layout.objects[base].pose.then([0.0, -deep / 2.0 + off, z], STRAIGHT);
        let _ = self.layout.try_put(part, pose);
    }
}

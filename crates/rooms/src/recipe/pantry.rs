//! The kitchen of a workplace: cabinets over a corner, a large table, papers and boxes on everything.

use super::Room;
use crate::dice::{between, pick, whole};
use crate::furniture::{decoration, electronics, kitchen, small, storage, tables};
use crate::model::Build;
use crate::place::STRAIGHT;
use crate::stock::Place;

impl Room<'_> {
    pub(super) fn pantry(&mut self) {
        let style = kitchen::Style::bold(self.rng);
        let walls = self.layout.walls.len();
        let first = whole(self.rng, 0, walls as u32 - 1) as usize;
        let sink_at = whole(self.rng, 1, 3) as usize;
        let stove_at = if self.likely(0.5) { 4 } else { usize::MAX };
        // The first ends in the corner where the second begins, which stands before its end.
        let next = (first + 1) % walls;
        let run = pick(self.rng, &[4, 6, 8]);
        self.run_along(next, style.deep + 0.02, (run, sink_at, stove_at), &style);
        if self.likely(0.75) {
            let wall = self.layout.walls[first].length;
            let start = (wall - between(self.rng, 1.5, 4.0)).max(0.05);
            self.run_along(first, start, (8, usize::MAX, usize::MAX), &style);
        }
        for parent in 0..self.layout.objects.len() {
            if self.layout.objects[parent].model.is(crate::ClassId::KitchenCabinet) {
                self.on_counter(parent);
            }
        }
        let table = self.make(tables::table, Place::Floor);
        let placed = match self.likely(0.8) {
            true => self.layout.in_middle(table, self.rng),
            false => self.layout.on_floor(table, self.rng),
        };
        if let Some(table) = placed {
            self.chairs_around(table);
            self.papers(table, 7);
        }
        self.wall_screen();
        for _ in 0..whole(self.rng, 0, 2) {
            self.wall_shelf();
        }
        self.some_at_wall(&[
            (kitchen::refrigerator, 0.5),
            (small::trash_can, 0.6),
            (small::carton, 0.4),
            (storage::cabinet, 0.4),
            (decoration::plant, 0.3),
        ]);
    }

    /// Leaflets that lean on the wall, magazines, mugs and boxes on a worktop.
    fn on_counter(&mut self, parent: usize) {
        let things: [Build; 8] = [
            small::standing_book,
            small::standing_book,
            small::magazines,
            small::small_carton,
            small::mug,
            small::lidded_box,
            decoration::pot_plant,
            electronics::laptop,
        ];
        self.scatter_on(parent, &things, 3);
    }

    /// A board on a wall with books on it.
    fn wall_shelf(&mut self) {
        let shelf = self.make(storage::wall_board, Place::Wall);
        let Some(shelf) = self.layout.against_wall(shelf, [1.1, 1.7], self.rng) else { return };
        let wide = self.layout.objects[shelf].model.bounds().high[0];
        for _ in 0..whole(self.rng, 1, 6) {
            let build = pick(
                self.rng,
                &[
                    small::standing_book as Build,
                    small::standing_book,
                    small::book,
                    small::small_carton,
                ],
            );
            let thing = self.make(build, Place::Top);
            let at = between(self.rng, -wide, wide);
            self.layout.on_top_at(shelf, 0, [at, 0.0], STRAIGHT, thing);
        }
    }
}

//! Places other than homes: many of one kind in rows, wide aisles, carpets.

use super::Room;
use crate::dice::{between, chance, pick, small_turn, whole};
use crate::furniture::{
    bedroom, decoration, electronics, lighting, openings, seating, small, storage, tables,
};
use crate::model::{Build, Model};
use crate::place::{BACKWARDS, Pose, STRAIGHT};
use crate::stock::Place;

/// Upright at the back of what it stands on.
const QUARTER: [f64; 2] = [0.0, 1.0];

impl Room<'_> {
    /// Blocks of desks, face to face or in a row, and what is kept beside them.
    pub(super) fn open_office(&mut self) {
        let twins = self.likely(0.7);
        let desk = self.make(tables::desk, Place::Floor);
        self.rows(&desk, [0.05, 1.3], |room, model, pose| {
            if let Ok(first) = room.layout.try_put(model.clone(), pose) {
                room.workplace_on(first);
            }
            let deep = -model.extent().low[1];
            let behind = pose.then([0.0, -2.0 * deep - 0.02, 0.0], BACKWARDS);
            if twins && let Ok(second) = room.layout.try_put(model, behind) {
                room.workplace_on(second);
            }
        });
        self.some_at_wall(&[
            (storage::cabinet, 0.9),
            (storage::cabinet, 0.7),
            (storage::bookshelf, 0.7),
            (storage::bookshelf, 0.5),
            (decoration::plant, 0.7),
            (decoration::plant, 0.5),
            (small::trash_can, 0.7),
            (small::carton, 0.5),
        ]);
    }

    /// One long table or several, a screen on the wall, papers.
    pub(super) fn meeting(&mut self) {
        let table = self.make(tables::table, Place::Floor);
        let Some(first) = self.layout.in_middle(table.clone(), self.rng) else { return };
        let pose = self.layout.objects[first].pose;
        let long = table.extent().size()[0] + 0.01;
        let mut all = vec![first];
        for side in [1.0, -1.0] {
            if self.likely(0.5) {
                let beside = pose.then([side * long, 0.0, 0.0], STRAIGHT);
                all.extend(self.layout.try_put(table.clone(), beside).ok());
            }
        }
        for table in all {
            self.chairs_around(table);
            self.papers(table, 4);
        }
        self.wall_screen();
        self.some_at_wall(&[
            (storage::cabinet, 0.6),
            (seating::chair, 0.4),
            (decoration::plant, 0.6),
            (small::trash_can, 0.4),
        ]);
    }

    /// Shelves back to back and along the walls, tables of goods, a counter with a screen.
    pub(super) fn shop(&mut self) {
        let shelf = self.make(storage::bookshelf, Place::Floor);
        self.rows(&shelf, [0.0, 1.4], |room, model, pose| {
            let deep = -model.extent().low[1];
            let _ = room.layout.try_put(model.clone(), pose);
            let behind = pose.then([0.0, -2.0 * deep - 0.01, 0.0], BACKWARDS);
            let _ = room.layout.try_put(model, behind);
        });
        for _ in 0..whole(self.rng, 2, 5) {
            self.at_wall(storage::bookshelf);
        }
        for _ in 0..whole(self.rng, 0, 2) {
            if let Some(table) = self.on_floor(tables::table) {
                self.goods(table, 8);
            }
        }
        if let Some(counter) = self.at_wall(tables::desk) {
            self.workplace_on(counter);
        }
        self.some_at_wall(&[
            (small::carton, 0.6),
            (small::carton, 0.4),
            (decoration::plant, 0.4),
            (seating::stool, 0.4),
            (seating::sofa, 0.2),
        ]);
    }

    /// Beds with their heads to a wall, curtains between them, and what stands beside a bed.
    pub(super) fn ward(&mut self) {
        let bed = self.make(bedroom::bed, Place::Floor);
        let block = bed.extent();
        let step = block.size()[0] + between(self.rng, 1.0, 1.7);
        for index in 0..self.layout.walls.len().min(4) {
            if !self.likely(0.7) {
                continue;
            }
            let wall = self.layout.walls[index].clone();
            let mut at = step / 2.0 + between(self.rng, 0.0, 0.6);
            while at + step / 2.0 < wall.length {
                let pose = wall.pose(at, 0.02 - block.low[1], 0.0);
                if let Ok(bed) = self.layout.try_put(bed.clone(), pose) {
                    self.bedside(bed, step);
                }
                at += step;
            }
        }
        self.wall_screen();
        self.some_at_wall(&[
            (storage::cabinet, 0.8),
            (storage::cabinet, 0.4),
            (crate::furniture::bathroom::sink, 0.6),
            (small::trash_can, 0.8),
            (seating::chair, 0.6),
            (seating::stool, 0.5),
        ]);
    }

    fn bedside(&mut self, bed: usize, step: f64) {
        let block = self.layout.objects[bed].model.extent();
        self.pillows(bed, 0);
        let side = if self.likely(0.5) { 1.0 } else { -1.0 };
        if self.likely(0.7) {
            let stand = self.make(bedroom::nightstand, Place::Floor);
            let wide = stand.extent().size()[0] / 2.0;
            let back = block.low[1] - stand.extent().low[1];
            let at = block.high[0] + wide + 0.05;
            self.layout.near(
                bed,
                stand,
                &[([side * at, back], STRAIGHT), ([-side * at, back], STRAIGHT)],
            );
        }
        if self.likely(0.4) {
            let chair = self.make(seating::chair, Place::Floor);
            let at = block.high[0] + 0.4;
            self.layout.near(
                bed,
                chair,
                &[([-side * at, 0.5], BACKWARDS), ([side * at, 0.5], STRAIGHT)],
            );
        }
        if self.likely(0.5) {
            // A curtain from the wall into the room, half way to the next bed.
            let half = between(self.rng, 0.7, 1.0);
            let high = (self.layout.height - 0.1).min(between(self.rng, 2.0, 2.4));
            let cloth = self.make(|rng| openings::curtain(half, high, rng), Place::Floor);
            let at = [step / 2.0 - 0.05, block.low[1] + half + 0.05];
            self.layout.near(bed, cloth, &[(at, QUARTER)]);
        }
    }

    /// Desks in rows that look one way, and one before them.
    pub(super) fn classroom(&mut self) {
        let desk = match self.likely(0.6) {
            true => self.make(tables::desk, Place::Floor),
            false => self.make(tables::table, Place::Floor),
        };
        let chair = self.make(seating::chair, Place::Floor);
        self.rows(&desk, [0.15, 0.95], |room, model, pose| {
            let [x, y, _] = model.extent().high;
            let Ok(desk) = room.layout.try_put(model, pose) else { return };
            let seats = if x > 0.55 { 2 } else { 1 };
            for i in 0..seats {
                let at = if seats == 2 { (f64::from(i) - 0.5) * x } else { 0.0 };
                room.pull_up(desk, chair.clone(), [at, y], 1.0);
            }
            if room.likely(0.4) {
                room.papers(desk, 2);
            }
        });
        self.workplace();
        self.wall_screen();
        self.some_at_wall(&[
            (storage::cabinet, 0.7),
            (storage::bookshelf, 0.7),
            (small::trash_can, 0.7),
            (decoration::plant, 0.3),
        ]);
    }

    /// Benches, shelves and boxes.
    pub(super) fn workshop(&mut self) {
        for _ in 0..whole(self.rng, 2, 4) {
            let build: Build = if self.likely(0.7) { tables::table } else { tables::desk };
            if let Some(bench) = self.at_wall(build) {
                self.goods(bench, 5);
                if self.likely(0.5) {
                    let stool = self.make(seating::stool, Place::Floor);
                    let y = self.layout.objects[bench].model.bounds().high[1];
                    self.pull_up(bench, stool, [0.0, y], 1.0);
                }
            }
        }
        if self.likely(0.6)
            && let Some(bench) = self.on_floor(tables::table)
        {
            self.goods(bench, 6);
        }
        for _ in 0..whole(self.rng, 1, 4) {
            self.at_wall(storage::bookshelf);
        }
        for _ in 0..whole(self.rng, 2, 6) {
            self.on_floor(small::carton);
        }
        self.some_at_wall(&[
            (storage::cabinet, 0.8),
            (storage::wardrobe, 0.5),
            (small::trash_can, 0.8),
            (small::carton, 0.8),
            (small::carton, 0.6),
        ]);
    }

    /// Seats along the walls, low tables with magazines, a desk to be received at.
    pub(super) fn lobby(&mut self) {
        let chair = self.make(seating::chair, Place::Floor);
        let block = chair.extent();
        let step = block.size()[0] + between(self.rng, 0.0, 0.15);
        for index in 0..self.layout.walls.len() {
            if !self.likely(0.5) {
                continue;
            }
            let wall = self.layout.walls[index].clone();
            let mut at = between(self.rng, 0.4, 1.2);
            for _ in 0..whole(self.rng, 2, 7) {
                if at + step > wall.length {
                    break;
                }
                let _ = self.layout.try_put(chair.clone(), wall.pose(at, 0.03 - block.low[1], 0.0));
                at += step;
            }
        }
        for _ in 0..whole(self.rng, 0, 2) {
            if let Some(sofa) = self.at_wall(seating::sofa) {
                self.before_sofa(sofa);
            }
        }
        if let Some(low) = self.on_floor(tables::coffee_table) {
            self.papers(low, 4);
        }
        if let Some(desk) = self.on_floor(tables::desk) {
            self.workplace_on(desk);
        }
        self.wall_screen();
        self.some_at_wall(&[
            (decoration::plant, 0.9),
            (decoration::plant, 0.7),
            (small::trash_can, 0.7),
            (lighting::floor_lamp, 0.3),
            (storage::cabinet, 0.4),
            (storage::bookshelf, 0.3),
        ]);
    }

    /// One model many times, in rows over the floor: `gap` meters to its neighbor in the row and to the next row.
    fn rows(&mut self, model: &Model, gap: [f64; 2], mut put: impl FnMut(&mut Self, Model, Pose)) {
        let [wide, deep, _] = model.extent().size();
        let steps = [wide + gap[0] + 0.02, 2.0 * deep + gap[1] + between(self.rng, 0.0, 0.5)];
        let is_across = self.likely(0.5);
        let [along, over] = match is_across {
            true => [self.layout.size[1], self.layout.size[0]],
            false => self.layout.size,
        };
        // An aisle at each wall.
        let aisle = between(self.rng, 0.6, 1.2);
        let left_out = between(self.rng, 0.0, 0.25);
        let mut y = aisle + deep / 2.0;
        while y + deep / 2.0 + aisle < over {
            let mut x = aisle + wide / 2.0;
            while x + wide / 2.0 + aisle < along {
                let [s, c] = [between(self.rng, -0.02, 0.02), 1.0];
                let norm = (c * c + s * s).sqrt();
                let (origin, turn) = match is_across {
                    true => ([over - y, x, 0.0], QUARTER),
                    false => ([x, y, 0.0], STRAIGHT),
                };
                let pose = Pose { origin, turn }.then([0.0; 3], [c / norm, s / norm]);
                if !self.likely(left_out) {
                    put(self, model.clone(), pose);
                }
                x += steps[0];
            }
            y += steps[1];
        }
    }

    /// A television on a wall, at the height of eyes or above.
    pub(super) fn wall_screen(&mut self) {
        if self.likely(0.6) {
            let wide = between(self.rng, 0.7, 1.5);
            let tv = self.make(|rng| electronics::wall_tv(wide, rng), Place::Wall);
            self.layout.against_wall(tv, [1.0, 1.5], self.rng);
        }
    }

    /// What lies on tables where people meet: magazines, papers, mugs, computers.
    pub(super) fn papers(&mut self, parent: usize, most: u32) {
        let things: [Build; 7] = [
            small::magazines,
            small::magazines,
            small::magazines,
            small::mug,
            small::mug,
            small::lidded_box,
            electronics::laptop,
        ];
        self.scatter_on(parent, &things, most);
    }

    /// What is for sale or at work.
    fn goods(&mut self, parent: usize, most: u32) {
        let things: [Build; 5] = [
            small::book,
            small::small_carton,
            small::lidded_box,
            small::magazines,
            decoration::pot_plant,
        ];
        self.scatter_on(parent, &things, most);
    }

    pub(super) fn scatter_on(&mut self, parent: usize, things: &[Build], most: u32) {
        let supports = self.layout.objects[parent].model.supports.len() as u32;
        if supports == 0 {
            return;
        }
        for _ in 0..whole(self.rng, 0, most) {
            let build = pick(self.rng, things);
            let thing = self.make(build, Place::Top);
            let turn = chance(self.rng, 0.5).then(|| small_turn(self.rng, 0.5));
            let support = whole(self.rng, 0, supports - 1) as usize;
            self.layout.on_top(parent, support, thing, turn, self.rng);
        }
    }
}

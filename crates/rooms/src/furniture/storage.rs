//! Cabinets, wardrobes, bookshelves and TV stands.

use super::seating::legs;
use super::tables::drawer_fronts;
use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::{Material, Texture, metal, painted, wood};
use crate::model::{Model, SIDES};
use scenesplat_kernels::random::SampleRng;

/// Doors side by side on the face `y = front`, with gaps and handles; some with raised frames.
pub(super) fn door_fronts(
    model: &mut Model,
    [left, right]: [f64; 2],
    [low, high]: [f64; 2],
    front: f64,
    count: u32,
    material: Material,
    rng: &mut SampleRng,
) {
    let step = (right - left) / f64::from(count);
    let metal = metal(rng).1;
    let framed = chance(rng, 0.4) && step > 0.25;
    let (handle_z, handle_high) = if high - low > 1.2 {
        (low + 0.5 * (high - low), between(rng, 0.15, 0.4))
    } else {
        (low + 0.75 * (high - low), between(rng, 0.05, 0.16))
    };
    for i in 0..count {
        let x = left + f64::from(i) * step;
        let a = [x + 0.006, front, low + 0.006];
        let b = [x + step - 0.006, front + 0.014, high - 0.006];
        model.block(a, b, material.shaded(if i % 2 == 0 { 1.03 } else { 0.98 }));
        if framed {
            let f = 0.06;
            for (p, q) in [
                ([a[0], a[2]], [b[0], a[2] + f]),
                ([a[0], b[2] - f], [b[0], b[2]]),
                ([a[0], a[2]], [a[0] + f, b[2]]),
                ([b[0] - f, a[2]], [b[0], b[2]]),
            ] {
                model.block([p[0], b[1], p[1]], [q[0], b[1] + 0.008, q[1]], material.shaded(0.94));
            }
        }
        // Pairs of doors have their handles side by side.
        let side = if i % 2 == 0 && i + 1 < count { x + step - 0.05 } else { x + 0.05 };
        model.centred([side, front + 0.035, handle_z], [0.02, 0.025, handle_high], metal);
    }
}

/// A board on a wall to put things on; its underside is at z = 0. It is of no class.
pub(crate) fn wall_board(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.5) { wood(rng) } else { painted(rng) };
    let (x, y) = (between(rng, 0.3, 1.0), between(rng, 0.08, 0.15));
    let thick = between(rng, 0.015, 0.04);
    let mut model = Model::new(ClassId::Bookshelf, color, 1.7);
    model.class = None;
    model.block([-x, -y, 0.0], [x, y, thick], body);
    model.support([-x, -y], [x, y], thick, 0.4);
    model.solid([-x, -y, 0.0], [x, y, thick]);
    model
}

/// A sideboard or chest of drawers.
pub(crate) fn cabinet(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.75) { wood(rng) } else { painted(rng) };
    let half = [between(rng, 0.35, 0.85), between(rng, 0.19, 0.28)];
    let high = between(rng, 0.72, 1.35);
    let rise = if chance(rng, 0.5) { between(rng, 0.06, 0.18) } else { 0.03 };
    let [x, y] = half;
    let mut model = Model::new(ClassId::Cabinet, color, 1.7);
    model.block([-x, -y, rise], [x, y, high], body);
    if chance(rng, 0.6) {
        model.block([-x - 0.02, -y, high], [x + 0.02, y + 0.025, high + 0.025], body.shaded(0.92));
    }
    let columns = whole(rng, 1, if x > 0.55 { 3 } else { 2 });
    let step = 2.0 * x / f64::from(columns);
    for i in 0..columns {
        let left = -x + f64::from(i) * step;
        let span = [left, left + step];
        if chance(rng, 0.5) {
            let count = whole(rng, 3, 5);
            drawer_fronts(&mut model, span, [rise + 0.02, high - 0.02], y, count, body, rng);
        } else {
            let count = if step > 0.5 { 2 } else { 1 };
            door_fronts(&mut model, span, [rise + 0.02, high - 0.02], y, count, body, rng);
        }
    }
    let frame = if chance(rng, 0.3) { metal(rng).1 } else { body.shaded(0.85) };
    legs(&mut model, [x - 0.04, y - 0.04], rise, 0.0, (0.04, chance(rng, 0.5)), frame);
    model.support([-x + 0.03, -y + 0.02], [x - 0.03, y - 0.02], high + 0.026, 0.9);
    model
}

pub(crate) fn wardrobe(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.75) { wood(rng) } else { painted(rng) };
    let doors = pick(rng, &[2, 2, 3, 4]);
    let x = f64::from(doors) * between(rng, 0.38, 0.55) / 2.0;
    let y = between(rng, 0.26, 0.34);
    let high = between(rng, 1.8, 2.18);
    let mut model = Model::new(ClassId::Wardrobe, color, 1.2);
    model.block([-x, -y, 0.03], [x, y, high], body);
    model.block([-x, -y, 0.0], [x, y - 0.03, 0.03], body.shaded(0.6));
    let low = if chance(rng, 0.3) {
        let split = between(rng, 0.35, 0.5);
        let step = 2.0 * x / 2.0;
        for i in 0..2 {
            let left = -x + f64::from(i) * step;
            drawer_fronts(&mut model, [left, left + step], [0.05, split], y, 2, body, rng);
        }
        split
    } else {
        0.05
    };
    door_fronts(&mut model, [-x, x], [low, high - 0.02], y, doors, body, rng);
    if chance(rng, 0.4) {
        model.block([-x - 0.025, -y, high], [x + 0.025, y + 0.03, high + 0.05], body.shaded(0.93));
    }
    model
}

pub(crate) fn bookshelf(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.85) { wood(rng) } else { metal(rng) };
    let (x, y) = (between(rng, 0.3, 0.75), between(rng, 0.12, 0.19));
    let high = between(rng, 0.9, 2.15);
    let thick = between(rng, 0.015, 0.035);
    let shelves = (high / between(rng, 0.27, 0.42)) as u32 + 1;
    let mut model = Model::new(ClassId::Bookshelf, color, 1.7);
    let has_back = chance(rng, 0.7);
    if has_back {
        let up = [0.0, 0.0, high - 0.03];
        model.face([-x, -y + 0.005, 0.03], up, [2.0 * x, 0.0, 0.0], body.shaded(0.85));
    }
    for side in SIDES {
        if has_back || chance(rng, 0.5) {
            model.block_between([side * x, -y, 0.0], [side * (x - thick), y, high], body);
        } else {
            for sy in SIDES {
                let [px, py] = [side * (x - 0.015), sy * (y - 0.015)];
                model.beam([px, py, 0.0], [px, py, high], 0.03, body);
            }
        }
    }
    let step = (high - thick - 0.04) / f64::from(shelves - 1).max(1.0);
    for i in 0..shelves {
        let z = 0.04 + f64::from(i) * step;
        model.block([-x + thick, -y, z], [x - thick, y, z + thick], body);
        if i + 1 < shelves {
            fill_shelf(&mut model, [x - thick, y, z + thick], step - thick, rng);
        }
    }
    model.solid([-x, -y, 0.0], [x, y, high + thick]);
    model
}

/// Rows of upright books, piles, and gaps; they belong to the shelf, as annotators have it.
fn fill_shelf(model: &mut Model, [x, y, z]: [f64; 3], clear: f64, rng: &mut SampleRng) {
    let mut left = -x + 0.01;
    while left < x - 0.08 {
        let wide = between(rng, 0.1, 0.5).min(x - left);
        let right = left + wide;
        let books =
            |width: f64, rng: &mut SampleRng| Material::new([150.0; 3], Texture::Books(width), rng);
        match whole(rng, 0, 5) {
            0 | 1 => {}
            2 => {
                let tall = clear * between(rng, 0.2, 0.45);
                let books = books(0.02, rng);
                // Lying books: the backs' stripes are level.
                let (a, b) = (left + 0.01, (left + 0.2).min(right));
                let front = y - between(rng, 0.01, 0.06);
                model.face([b, front, z], [0.0, 0.0, tall], [a - b, 0.0, 0.0], books);
                let (across, deep) = ([b - a, 0.0, 0.0], [0.0, front + y - 0.02, 0.0]);
                model.face([a, -y + 0.02, z + tall], across, deep, books.shaded(0.9));
            }
            _ => {
                let tall = clear * between(rng, 0.55, 0.9);
                let books = books(between(rng, 0.02, 0.045), rng);
                let front = y - between(rng, 0.01, 0.08);
                model.face([right, front, z], [left - right, 0.0, 0.0], [0.0, 0.0, tall], books);
                let deep = [0.0, front + y - 0.02, 0.0];
                model.face([left, -y + 0.02, z + tall], [wide, 0.0, 0.0], deep, books);
            }
        }
        left = right + between(rng, 0.0, 0.06);
    }
}

pub(crate) fn tv_stand(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.85) { wood(rng) } else { painted(rng) };
    let (x, y) = (between(rng, 0.55, 1.2), between(rng, 0.18, 0.28));
    let high = between(rng, 0.34, 0.6);
    let rise = if chance(rng, 0.5) { between(rng, 0.05, 0.15) } else { 0.02 };
    let thick = 0.025;
    let mut model = Model::new(ClassId::TvStand, color, 1.7);
    model.block([-x, -y, high - thick], [x, y, high], body);
    model.block([-x, -y, rise], [x, y, rise + thick], body);
    for side in SIDES {
        model.block_between([side * x, -y, rise], [side * (x - thick), y, high], body);
    }
    let inner = [rise + thick, high - thick];
    model.face(
        [-x, -y + 0.01, rise],
        [0.0, 0.0, high - rise],
        [2.0 * x, 0.0, 0.0],
        body.shaded(0.7),
    );
    let columns = whole(rng, 2, 4);
    let step = 2.0 * (x - thick) / f64::from(columns);
    for i in 0..columns {
        let left = -x + thick + f64::from(i) * step;
        let span = [left, left + step];
        match whole(rng, 0, 2) {
            0 => drawer_fronts(&mut model, span, inner, y - 0.01, whole(rng, 1, 2), body, rng),
            1 => door_fronts(&mut model, span, inner, y - 0.01, 1, body, rng),
            _ => {
                let z = (rise + high) / 2.0;
                let (low, top) = ([left, -y + 0.02, z], [left + step, y - 0.02, z + 0.015]);
                model.block(low, top, body.shaded(0.9));
            }
        }
    }
    legs(&mut model, [x - 0.05, y - 0.04], rise, 0.0, (0.04, chance(rng, 0.5)), body.shaded(0.85));
    model.support([-x + 0.03, -y + 0.02], [x - 0.03, y - 0.02], high + 0.001, 1.2);
    model.solid([-x, -y, 0.0], [x, y + 0.03, high]);
    model
}

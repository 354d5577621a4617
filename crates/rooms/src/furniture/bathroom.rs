//! Toilets, bathtubs and washbasins.

use super::kitchen::{basin, tap};
use super::storage::door_fronts;
use crate::classes::ClassId;
use crate::dice::{between, chance, pick};
use crate::material::{ceramic, metal, painted, wood};
use crate::model::{Model, strips};
use crate::shape::Shape;
use scenesplat_kernels::random::SampleRng;

pub(crate) fn toilet(rng: &mut SampleRng) -> Model {
    let (color, white) = ceramic(rng);
    let seat = between(rng, 0.38, 0.44);
    let (rx, ry) = (between(rng, 0.17, 0.2), between(rng, 0.22, 0.26));
    let mut model = Model::new(ClassId::Toilet, color, 2.6);
    // Bowl: a half ellipsoid outside and a smaller one inside, on a foot.
    let centre = [0.0, 0.1, seat - 0.02];
    model.dome(centre, [rx, ry, seat * 0.75], [-1.0, 0.0], 0.25, false, white);
    model.dome(centre, [rx * 0.72, ry * 0.74, 0.16], [-1.0, 0.0], 0.0, true, white.shaded(0.93));
    let foot = [rx * 0.62, ry * 0.8];
    model.dome([0.0, 0.04, 0.0], [foot[0], foot[1], seat * 0.6], [0.0, 0.75], 0.7, false, white);
    let lid = if chance(rng, 0.7) { white } else { painted(rng).1 };
    let rim = [0.0, 0.1, seat];
    let (u, v) = ([rx, 0.0, 0.0], [0.0, ry, 0.0]);
    if chance(rng, 0.5) {
        model.disc([0.0, 0.1, seat + 0.03], u, v, 0.0, lid);
        model.ring(rim, u, v, 0.02, lid);
    } else {
        model.disc([0.0, 0.1, seat + 0.015], u, v, 0.62, lid);
        model.ring(rim, u, v, 0.015, lid);
        // The lid stands up before the tank.
        let up = [0.0, -0.03, ry];
        let at = [0.0, 0.1 - ry - 0.02, seat + ry + 0.02];
        model.disc(at, u, up, 0.0, lid);
    }
    let back = 0.1 - ry;
    let tank_low = if chance(rng, 0.75) { seat - 0.04 } else { seat + 0.15 };
    let (wide, high) = (between(rng, 0.17, 0.22), tank_low + between(rng, 0.32, 0.42));
    let low_y = back - 0.24;
    model.soft_block([-wide, low_y, tank_low], [wide, back - 0.06, high], 0.01, white);
    let lid_low = [-wide - 0.012, low_y - 0.006, high];
    model.block(lid_low, [wide + 0.012, back - 0.05, high + 0.03], white);
    model.centred([0.0, back - 0.15, high + 0.036], [0.05, 0.04, 0.012], metal(rng).1);
    model.block([-rx * 0.6, low_y + 0.02, 0.0], [rx * 0.6, 0.0, tank_low.min(seat)], white);
    centre_front_to_back(model)
}

/// Moves surfaces so that the middle of the object is at y = 0.
fn centre_front_to_back(mut model: Model) -> Model {
    let block = model.bounds();
    let shift = -(block.low[1] + block.high[1]) / 2.0;
    for surface in &mut model.surfaces {
        surface.shape = surface.shape.moved([0.0, shift, 0.0]);
    }
    for block in &mut model.solids {
        block.low[1] += shift;
        block.high[1] += shift;
    }
    model
}

pub(crate) fn bathtub(rng: &mut SampleRng) -> Model {
    let (color, white) = ceramic(rng);
    let (x, y) = (between(rng, 0.72, 0.92), between(rng, 0.34, 0.42));
    let high = between(rng, 0.5, 0.62);
    let mut model = Model::new(ClassId::Bathtub, color, 1.5);
    let deep = high - 0.1;
    if chance(rng, 0.35) {
        // Free-standing: an oval shell, inside and outside.
        let centre = [0.0, 0.0, high];
        model.dome(centre, [x, y, high], [-0.97, 0.0], 0.35, false, white);
        model.dome(centre, [x - 0.05, y - 0.05, deep], [-1.0, 0.0], 0.35, true, white.shaded(0.97));
        let (u, v) = ([x, 0.0, 0.0], [0.0, y, 0.0]);
        model.disc(centre, u, v, 0.94, white);
    } else {
        let rim = between(rng, 0.05, 0.09);
        let panel = if chance(rng, 0.6) { white } else { super::openings::tiles(rng) };
        let (l, d) = (2.0 * x, 2.0 * y);
        for (corner, u) in [
            ([x, y, 0.0], [-l, 0.0, 0.0]),
            ([x, -y, 0.0], [0.0, d, 0.0]),
            ([-x, y, 0.0], [0.0, -d, 0.0]),
        ] {
            model.face(corner, u, [0.0, 0.0, high], panel);
        }
        model.add_hidden(Shape::flat([-x, -y, 0.0], [l, 0.0, 0.0], [0.0, 0.0, high]), panel);
        let (ix, iy) = (x - rim, y - rim);
        for [low, top] in strips([x, y], [ix, iy]) {
            let [w, h] = [top[0] - low[0], top[1] - low[1]];
            model.face([low[0], low[1], high], [w, 0.0, 0.0], [0.0, h, 0.0], white);
        }
        basin(&mut model, [ix, iy, high], deep, 0.85, white);
    }
    tap(&mut model, [x - 0.1, -y + 0.03, high], 0.12, metal(rng).1);
    model.solid([-x, -y, 0.0], [x, y, high + 0.13]);
    model
}

/// A washbasin on the wall, on a column, or on a small cupboard.
pub(crate) fn sink(rng: &mut SampleRng) -> Model {
    let (color, white) = ceramic(rng);
    let (x, y) = (between(rng, 0.24, 0.38), between(rng, 0.2, 0.26));
    let high = between(rng, 0.78, 0.88);
    let mut model = Model::new(ClassId::Sink, color, 2.4);
    let kind = pick(rng, &[0, 1, 2, 2]);
    if kind == 2 {
        let body = if chance(rng, 0.5) { wood(rng).1 } else { painted(rng).1 };
        model.block([-x, -y, 0.08], [x, y - 0.02, high - 0.12], body);
        door_fronts(&mut model, [-x, x], [0.1, high - 0.13], y - 0.02, 2, body, rng);
        model.block([-x + 0.03, -y, 0.0], [x - 0.03, y - 0.08, 0.08], body.shaded(0.6));
        basin(&mut model, [x - 0.05, y - 0.05, high], 0.1, 0.75, white);
        for [low, top] in strips([x, y], [x - 0.05, y - 0.05]) {
            model.block([low[0], low[1], high - 0.12], [top[0], top[1], high], white);
        }
    } else {
        let centre = [0.0, 0.0, high];
        model.dome(centre, [x, y, 0.17], [-1.0, 0.0], 0.4, false, white);
        model.dome(centre, [x - 0.05, y - 0.06, 0.12], [-1.0, 0.0], 0.2, true, white.shaded(0.96));
        let (u, v) = ([x, 0.0, 0.0], [0.0, y, 0.0]);
        model.disc(centre, u, v, 0.78, white);
        if kind == 1 {
            model.taper([0.0, -y * 0.4, 0.0], [0.0, -y * 0.4, high - 0.12], 0.1, 0.07, white);
        } else {
            let drain = metal(rng).1;
            model.rod([0.0, -y * 0.3, high - 0.4], [0.0, -y * 0.3, high - 0.14], 0.02, drain);
            model.rod([0.0, -y, high - 0.38], [0.0, -y * 0.3, high - 0.38], 0.02, drain);
        }
    }
    let steel = metal(rng).1;
    tap(&mut model, [0.0, -y + 0.03, high], between(rng, 0.15, 0.22), steel);
    model.solid([-x, -y, 0.0], [x, y + 0.02, high + 0.23]);
    model
}

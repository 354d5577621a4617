//! Tables, coffee tables and desks.

use super::seating::legs;
use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::{Material, Texture, metal, painted, wood};
use crate::model::{CORNERS, Model, SIDES};
use crate::vector::mix;
use scenesplat_kernels::random::SampleRng;

pub(crate) fn table(rng: &mut SampleRng) -> Model {
    let (color, top) = if chance(rng, 0.75) { wood(rng) } else { painted(rng) };
    let high = between(rng, 0.69, 0.8);
    let thick = between(rng, 0.02, 0.06);
    let mut model = Model::new(ClassId::Table, color, 1.8);
    let frame = if chance(rng, 0.6) { top.shaded(0.9) } else { metal(rng).1 };
    if chance(rng, 0.25) {
        let r = between(rng, 0.34, 0.65);
        model.taper([0.0, 0.0, high - thick], [0.0, 0.0, high], r, r, top);
        foot(&mut model, r, high - thick, frame);
        model.solid([-r, -r, high - thick], [r, r, high]);
        model.solid([-r * 0.5, -r * 0.5, 0.0], [r * 0.5, r * 0.5, high - thick]);
        let s = r * 0.68;
        model.support([-s, -s], [s, s], high, 0.6);
        return model;
    }
    let (w, d) = (between(rng, 0.7, 2.1), between(rng, 0.65, 1.0));
    let half = [w.max(d) / 2.0, d / 2.0];
    board(&mut model, half, high, thick, top);
    carry(&mut model, half, high - thick, frame, rng);
    model
}

pub(crate) fn coffee_table(rng: &mut SampleRng) -> Model {
    let (color, top) = if chance(rng, 0.75) { wood(rng) } else { painted(rng) };
    let high = between(rng, 0.3, 0.48);
    let thick = between(rng, 0.02, 0.07);
    let mut model = Model::new(ClassId::CoffeeTable, color, 1.8);
    let frame = if chance(rng, 0.6) { top.shaded(0.85) } else { metal(rng).1 };
    if chance(rng, 0.3) {
        let r = between(rng, 0.28, 0.5);
        model.taper([0.0, 0.0, high - thick], [0.0, 0.0, high], r, r, top);
        let leg = (between(rng, 0.025, 0.045), true);
        legs(&mut model, [r * 0.6, r * 0.6], high - thick, 0.06, leg, frame);
        model.support([-r * 0.65, -r * 0.65], [r * 0.65, r * 0.65], high, 0.6);
        return model;
    }
    let half = [between(rng, 0.4, 0.68), between(rng, 0.24, 0.4)];
    board(&mut model, half, high, thick, top);
    if chance(rng, 0.3) {
        let [x, y] = half.map(|side| side * 0.95);
        model.block([-x, -y, 0.02], [x, y, high - thick], frame);
    } else {
        let leg = (between(rng, 0.03, 0.07), chance(rng, 0.4));
        legs(&mut model, [half[0] - 0.05, half[1] - 0.05], high - thick, 0.0, leg, frame);
        if chance(rng, 0.5) {
            let z = between(rng, 0.08, 0.16);
            let [x, y] = half.map(|side| side - 0.05);
            model.block([-x, -y, z], [x, y, z + 0.02], frame);
        }
    }
    model.solid([-half[0], -half[1], 0.0], [half[0], half[1], high]);
    model
}

pub(crate) fn desk(rng: &mut SampleRng) -> Model {
    let (color, top) = if chance(rng, 0.75) { wood(rng) } else { painted(rng) };
    let half = [between(rng, 0.5, 0.9), between(rng, 0.26, 0.4)];
    let high = between(rng, 0.71, 0.78);
    let thick = between(rng, 0.02, 0.045);
    let mut model = Model::new(ClassId::Desk, color, 1.8);
    board(&mut model, half, high, thick, top);
    let [x, y] = half;
    let under = high - thick;
    let frame = if chance(rng, 0.6) { top.shaded(0.92) } else { metal(rng).1 };
    let pedestal = between(rng, 0.34, 0.44);
    let kind = whole(rng, 0, 3);
    // Sides closed by boards, or by pedestals of drawers, and a board at the back.
    for (side, drawers) in [(-1.0, kind == 1 || kind == 2), (1.0, kind == 2)] {
        if drawers {
            let (a, b) = (side * (x - pedestal), side * x);
            let (low, top_x) = (a.min(b), a.max(b));
            model.block([low, -y + 0.02, 0.03], [top_x, y - 0.02, under], frame);
            drawer_fronts(&mut model, [low, top_x], [0.06, under - 0.02], y - 0.02, 3, frame, rng);
            model.solid([low, -y, 0.0], [top_x, y, under]);
        } else if kind == 3 {
            let foot = [side * (x - 0.06), 0.0, 0.0];
            model.beam([foot[0], -y + 0.04, 0.02], [foot[0], y - 0.04, 0.02], 0.05, frame);
            model.beam(foot, [foot[0], 0.0, under], 0.06, frame);
            model.solid([foot[0] - 0.03, -y, 0.0], [foot[0] + 0.03, y, under]);
        } else if chance(rng, 0.5) {
            let (inner, outer) = ([side * (x - 0.03), -y, 0.0], [side * x, y, under]);
            model.block_between(inner, outer, frame);
            model.solid(inner, outer);
        } else {
            for sy in SIDES {
                let [px, py] = [side * (x - 0.03), sy * (y - 0.03)];
                model.beam([px, py, 0.0], [px, py, under], 0.045, frame);
            }
            model.solid([side * (x - 0.06), -y, 0.0], [side * x, y, under]);
        }
    }
    if chance(rng, 0.6) {
        let low = between(rng, 0.25, 0.5);
        model.block([-x + 0.03, -y + 0.03, low], [x - 0.03, -y + 0.05, under], frame);
    }
    model
}

/// Fronts of drawers with gaps and handles on the face `y = front`.
pub(super) fn drawer_fronts(
    model: &mut Model,
    [left, right]: [f64; 2],
    [low, high]: [f64; 2],
    front: f64,
    count: u32,
    material: Material,
    rng: &mut SampleRng,
) {
    let step = (high - low) / f64::from(count);
    let metal = pick(rng, &[[60.0; 3], [190.0; 3], [150.0, 120.0, 70.0]]);
    let handle = Material::plain(mix(metal, material.base, 0.1));
    let long = chance(rng, 0.6);
    for i in 0..count {
        let z = low + f64::from(i) * step;
        let low = [left + 0.008, front, z + 0.005];
        let high = [right - 0.008, front + 0.012, z + step - 0.005];
        model.block(low, high, material.shaded(1.04));
        let centre = [(left + right) / 2.0, front + 0.025, z + step * 0.6];
        let wide = if long { 0.12_f64.min((right - left) * 0.4) } else { 0.03 };
        model.centred(centre, [wide, 0.02, 0.02], handle);
    }
}

fn board(model: &mut Model, [x, y]: [f64; 2], high: f64, thick: f64, material: Material) {
    model.block([-x, -y, high - thick], [x, y, high], material);
    model.support([-x + 0.03, -y + 0.03], [x - 0.03, y - 0.03], high, 0.8);
    model.solid([-x, -y, high - thick], [x, y, high]);
}

fn foot(model: &mut Model, r: f64, high: f64, material: Material) {
    model.rod([0.0, 0.0, 0.03], [0.0, 0.0, high], r * 0.1 + 0.01, material);
    model.taper([0.0; 3], [0.0, 0.0, 0.04], r * 0.55, r * 0.45, material);
}

/// Legs at the corners, side boards, or trestles.
fn carry(model: &mut Model, [x, y]: [f64; 2], high: f64, material: Material, rng: &mut SampleRng) {
    let width = between(rng, 0.04, 0.09);
    match whole(rng, 0, 4) {
        0 => {
            for side in SIDES {
                let at = |y: f64, z: f64| [side * x * 0.72, y, z];
                let low = width / 2.0;
                model.beam(at(-y * 0.8, low), at(y * 0.8, low), width, material);
                model.beam(at(0.0, 0.0), at(0.0, high), width * 1.3, material);
                let a = side * x * 0.72;
                model.solid([a - width, -y * 0.8, 0.0], [a + width, y * 0.8, high]);
            }
            model.beam([-x * 0.72, 0.0, 0.2], [x * 0.72, 0.0, 0.2], width * 0.8, material);
        }
        1 => {
            for side in SIDES {
                let outer = [side * (x - 0.05), -y + 0.03, 0.0];
                let inner = [side * (x - 0.09), y - 0.03, high];
                model.block_between(outer, inner, material);
                model.solid(outer, inner);
            }
        }
        kind => {
            let is_round = kind == 4;
            let (lx, ly) = (x - width / 2.0 - 0.02, y - width / 2.0 - 0.02);
            legs(model, [lx, ly], high, 0.0, (width, is_round), material);
            for [sx, sy] in CORNERS {
                let (cx, cy, r) = (sx * lx, sy * ly, width / 2.0);
                model.solid([cx - r, cy - r, 0.0], [cx + r, cy + r, high]);
            }
            if chance(rng, 0.6) {
                let low = high - between(rng, 0.05, 0.1);
                for side in SIDES {
                    let (x, y) = (side * lx, side * ly);
                    model.block([-lx, y - 0.01, low], [lx, y + 0.01, high], material);
                    model.block([x - 0.01, -ly, low], [x + 0.01, ly, high], material);
                }
            }
        }
    }
}

/// A stone or wooden worktop.
pub(super) fn worktop(rng: &mut SampleRng) -> Material {
    if chance(rng, 0.4) {
        return wood(rng).1;
    }
    let stones = [[60.0; 3], [40.0, 42.0, 46.0], [205.0, 200.0, 192.0], [150.0, 146.0, 140.0]];
    Material::new(pick(rng, &stones), Texture::Mottled(between(rng, 0.02, 0.15)), rng)
}

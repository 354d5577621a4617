//! Chairs, stools and sofas.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::{Material, Named, fabric, metal, painted, wood};
use crate::model::{CORNERS, Model, SIDES};
use crate::shape::Shape;
use crate::vector::V3;
use scenesplat_kernels::random::SampleRng;

/// Five directions of equal angles: feet of an office chair.
const STAR: [[f64; 2]; 5] = [
    [0.0, 1.0],
    [0.951_056_516, 0.309_016_994],
    [0.587_785_252, -0.809_016_994],
    [-0.587_785_252, -0.809_016_994],
    [-0.951_056_516, 0.309_016_994],
];

pub(crate) fn chair(rng: &mut SampleRng) -> Model {
    match whole(rng, 0, 9) {
        0..=4 => dining_chair(rng),
        5..=7 => office_chair(rng),
        _ => tub_chair(rng),
    }
}

/// Wood, metal, plastic or cloth.
fn any(rng: &mut SampleRng) -> Named {
    match whole(rng, 0, 3) {
        0 => fabric(rng),
        1 => painted(rng),
        _ => wood(rng),
    }
}

/// Four legs at the given half distances, from `top` down, spread outwards by `splay`.
pub(super) fn legs(
    model: &mut Model,
    [x, y]: [f64; 2],
    top: f64,
    splay: f64,
    (width, is_round): (f64, bool),
    material: Material,
) {
    for [sx, sy] in CORNERS {
        let foot = [sx * (x + splay), sy * (y + splay), 0.0];
        let head = [sx * x, sy * y, top];
        if is_round {
            model.taper(foot, head, width * 0.4, width * 0.55, material);
        } else {
            model.beam(foot, head, width, material);
        }
    }
}

fn dining_chair(rng: &mut SampleRng) -> Model {
    let (color, body) = any(rng);
    let (w, d) = (between(rng, 0.36, 0.5), between(rng, 0.36, 0.48));
    let (seat, high) = (between(rng, 0.42, 0.5), between(rng, 0.74, 1.08));
    let thick = between(rng, 0.02, 0.08);
    let leg_material = if chance(rng, 0.5) { wood(rng).1 } else { metal(rng).1 };
    let leg_material = if chance(rng, 0.5) { body.shaded(0.8) } else { leg_material };
    let leg = (between(rng, 0.022, 0.045), chance(rng, 0.5));
    let mut model = Model::new(ClassId::Chair, color, 2.2);
    let (x, y) = (w / 2.0, d / 2.0);
    let soft = if chance(rng, 0.5) { 0.015 } else { 0.0 };
    model.soft_block([-x, -y, seat - thick], [x, y, seat], soft, body);
    let splay = between(rng, 0.0, 0.02);
    legs(&mut model, [x - 0.025, y - 0.025], seat - thick, splay, leg, leg_material);
    let lean = between(rng, 0.0, 0.09);
    back_rest(&mut model, [x, y, seat, high], lean, body, leg_material, rng);
    if chance(rng, 0.2) {
        let arm = seat + between(rng, 0.16, 0.24);
        for side in SIDES {
            let at = |y: f64, z: f64| [side * (x + 0.015), y, z];
            model.beam(at(-y, arm), at(y * 0.7, arm), 0.03, leg_material);
            model.beam(at(y * 0.7, seat - thick), at(y * 0.7, arm), 0.025, leg_material);
        }
        model.solid([-x - 0.03, -y - lean, 0.0], [x + 0.03, y, arm + 0.02]);
    } else {
        model.solid([-x - 0.02, -y, 0.0], [x + 0.02, y, seat]);
    }
    model.solid([-x - 0.02, -y - lean - 0.02, 0.0], [x + 0.02, -y + 0.06, high]);
    model
}

/// Whole, of slats across or upright, or a frame with a gap.
fn back_rest(
    model: &mut Model,
    [x, y, seat, high]: [f64; 4],
    lean: f64,
    body: Material,
    frame: Material,
    rng: &mut SampleRng,
) {
    let at = |x: f64, z: f64| -> V3 { [x, -y + 0.02 - lean * (z - seat) / (high - seat), z] };
    let thick = between(rng, 0.015, 0.04);
    let panel = |model: &mut Model, x0: f64, x1: f64, z0: f64, z1: f64, material| {
        let (a, b, c) = (at(x0, z0), at(x1, z0), at(x0, z1));
        let (across, up) = ([b[0] - a[0], 0.0, 0.0], [0.0, c[1] - a[1], c[2] - a[2]]);
        // The face of the back rest looks forwards: up × across.
        model.plate(a, up, across, thick, material);
    };
    match whole(rng, 0, 3) {
        0 => panel(model, -x, x, seat + 0.02, high, body),
        1 => {
            let count = whole(rng, 2, 4);
            let step = (high - seat - 0.1) / f64::from(count);
            for i in 0..count {
                let z = seat + 0.1 + f64::from(i) * step;
                panel(model, -x, x, z, z + 0.6 * step, body);
            }
            side_posts(model, at, [x, seat, high], frame);
        }
        2 => {
            let count = whole(rng, 4, 7);
            for i in 0..count {
                let to = -x + 2.0 * x * (f64::from(i) + 0.5) / f64::from(count);
                model.beam(at(to, seat), at(to, high - 0.04), 0.018, frame);
            }
            panel(model, -x, x, high - 0.09, high, body);
            side_posts(model, at, [x, seat, high], frame);
        }
        _ => {
            panel(model, -x, x, seat + 0.55 * (high - seat) - 0.08, high, body);
            side_posts(model, at, [x, seat, high], frame);
        }
    }
}

fn side_posts(
    model: &mut Model,
    at: impl Fn(f64, f64) -> V3,
    [x, seat, high]: [f64; 3],
    frame: Material,
) {
    for side in SIDES {
        model.beam(at(side * (x - 0.012), seat), at(side * (x - 0.012), high), 0.028, frame);
    }
}

fn office_chair(rng: &mut SampleRng) -> Model {
    let (color, cover) = if chance(rng, 0.6) { painted(rng) } else { fabric(rng) };
    let frame = if chance(rng, 0.7) { Material::plain([40.0; 3]) } else { metal(rng).1 };
    let (w, d) = (between(rng, 0.44, 0.54), between(rng, 0.42, 0.52));
    let (seat, high) = (between(rng, 0.44, 0.56), between(rng, 0.85, 1.25));
    let mut model = Model::new(ClassId::Chair, color, 2.2);
    let reach = between(rng, 0.28, 0.34);
    for [c, s] in STAR {
        let foot = [c * reach, s * reach, 0.07];
        model.beam([0.0, 0.0, 0.11], foot, 0.035, frame);
        model.ball([foot[0], foot[1], 0.03], [0.03; 3], 0.0, frame);
    }
    model.rod([0.0, 0.0, 0.08], [0.0, 0.0, seat - 0.06], 0.03, frame);
    let (x, y) = (w / 2.0, d / 2.0);
    model.ball([0.0, 0.0, seat - 0.04], [x, y, 0.05], 0.7, cover);
    // The back is a piece of a wide tube around the sitter.
    let radius = between(rng, 0.26, 0.5);
    let from = seat + between(rng, 0.04, 0.15);
    let arc = (1.0 - (x / radius).min(0.95) * (x / radius).min(0.95)).max(0.0).sqrt();
    for (r, material) in [(radius, cover.shaded(0.9)), (radius - 0.03, cover)] {
        let base = [0.0, radius - y - 0.02, from];
        let axis = [0.0, -between(rng, 0.0, 0.08), high - from];
        shell(&mut model, [base, axis], [r, r], arc.max(0.3), material);
    }
    model.beam([0.0, -y + 0.05, seat - 0.05], [0.0, -y - 0.02, from + 0.1], 0.05, frame);
    let arms = chance(rng, 0.6);
    let arm = seat + between(rng, 0.17, 0.24);
    let (wide, top) = if arms { (x + 0.06, arm + 0.02) } else { (x, seat + 0.02) };
    if arms {
        for side in SIDES {
            let at = |y: f64, z: f64| [side * (x + 0.02), y, z];
            model.beam(at(-0.02, seat - 0.04), at(-0.02, arm), 0.03, frame);
            model.centred(at(0.0, arm), [0.06, 0.24, 0.025], frame);
        }
    }
    model.solid([-wide, -y, 0.0], [wide, y, top]);
    model.solid([-x, -y - 0.13, from], [x, -y + 0.12, high]);
    model.solid([-reach, -reach, 0.0], [reach, reach, 0.15]);
    model
}

/// A piece of a cone at the back: its base and axis, its lower and upper radius.
fn shell(
    model: &mut Model,
    [base, axis]: [V3; 2],
    [bottom, top]: [f64; 2],
    arc: f64,
    material: Material,
) {
    let toward = [0.0, -1.0, 0.0];
    model.add(Shape::Frustum { base, axis, bottom, top, toward, arc }, material);
}

/// A shell around the sitter on four legs or a foot.
fn tub_chair(rng: &mut SampleRng) -> Model {
    let (color, cover) = if chance(rng, 0.5) { fabric(rng) } else { painted(rng) };
    let frame = if chance(rng, 0.5) { wood(rng).1 } else { metal(rng).1 };
    let r = between(rng, 0.24, 0.33);
    let (seat, high) = (between(rng, 0.4, 0.47), between(rng, 0.68, 0.84));
    let mut model = Model::new(ClassId::Chair, color, 2.0);
    model.ball([0.0, 0.0, seat - 0.05], [r * 0.92, r * 0.92, 0.07], 0.4, cover);
    let arc = between(rng, -0.1, 0.3);
    for (radius, shade) in [(r, 0.92), (r - 0.035, 1.0)] {
        let stands = [[0.0, 0.0, seat - 0.08], [0.0, 0.0, high - seat + 0.08]];
        shell(&mut model, stands, [radius * 0.9, radius], arc, cover.shaded(shade));
    }
    if chance(rng, 0.6) {
        let leg = (between(rng, 0.025, 0.04), true);
        legs(&mut model, [r * 0.5, r * 0.5], seat - 0.1, r * 0.2, leg, frame);
    } else {
        model.rod([0.0, 0.0, 0.02], [0.0, 0.0, seat - 0.1], 0.03, frame);
        model.taper([0.0; 3], [0.0, 0.0, 0.02], r * 0.8, r * 0.8, frame);
    }
    model.solid([-r, -r, 0.0], [r, r, high]);
    model
}

pub(crate) fn stool(rng: &mut SampleRng) -> Model {
    let (color, body) = any(rng);
    let r = between(rng, 0.15, 0.21);
    let high = pick(rng, &[0.42, 0.45, 0.5, 0.62, 0.68, 0.75]) + between(rng, -0.02, 0.02);
    let mut model = Model::new(ClassId::Stool, color, 2.5);
    let thick = between(rng, 0.03, 0.09);
    let is_round = chance(rng, 0.65);
    if is_round {
        let top = r * between(rng, 0.9, 1.0);
        model.taper([0.0, 0.0, high - thick], [0.0, 0.0, high], r, top, body);
    } else {
        model.soft_block([-r, -r, high - thick], [r, r, high], 0.01, body);
    }
    let frame = if chance(rng, 0.5) { body.shaded(0.85) } else { metal(rng).1 };
    if chance(rng, 0.75) {
        let leg = (between(rng, 0.025, 0.04), chance(rng, 0.6));
        legs(&mut model, [r * 0.62, r * 0.62], high - thick, between(rng, 0.0, 0.06), leg, frame);
        if high > 0.55 {
            let (u, v) = ([r * 0.9, 0.0, 0.0], [0.0, r * 0.9, 0.0]);
            model.ring([0.0, 0.0, 0.25], u, v, 0.01, frame);
        }
    } else {
        model.rod([0.0, 0.0, 0.02], [0.0, 0.0, high - thick], 0.035, frame);
        model.taper([0.0; 3], [0.0, 0.0, 0.03], r * 1.05, r * 0.95, frame);
    }
    model
}

pub(crate) fn sofa(rng: &mut SampleRng) -> Model {
    let (color, cover) = fabric(rng);
    let seats = pick(rng, &[2, 2, 3, 3, 4]);
    let arm = between(rng, 0.1, 0.26);
    let each = between(rng, 0.52, 0.72);
    let w = f64::from(seats) * each + 2.0 * arm;
    let d = between(rng, 0.78, 1.02);
    let (seat, high) = (between(rng, 0.38, 0.48), between(rng, 0.7, 0.98));
    let (rise, back) = (between(rng, 0.03, 0.14), between(rng, 0.16, 0.28));
    let arm_high = seat + between(rng, 0.08, 0.24);
    let mut model = Model::new(ClassId::Sofa, color, 1.4);
    let (x, y) = (w / 2.0, d / 2.0);
    let soft = between(rng, 0.0, 0.04);
    let cushion = cover.shaded(between(rng, 0.96, 1.08));
    let cushion_high = between(rng, 0.1, 0.2);
    model.block([-x, -y, rise], [x, y, seat - cushion_high], cover);
    model.soft_block([-x, -y, seat - cushion_high], [x, -y + back, high], soft, cover);
    for side in SIDES {
        let (inner, outer) = (side * (x - arm), side * x);
        if chance(rng, 0.35) {
            // A rolled arm.
            let r = arm * 0.55;
            let at = |y: f64| [side * (x - arm / 2.0), y, arm_high - r];
            model.rod(at(-y), at(y), r, cover);
            let low = [inner, -y, seat - cushion_high];
            model.block_between(low, [outer, y, arm_high - r], cover);
        } else {
            let (left, right) = (inner.min(outer), inner.max(outer));
            model.soft_block([left, -y, rise], [right, y, arm_high], soft * 0.6, cover);
        }
    }
    for i in 0..seats {
        let left = -x + arm + f64::from(i) * each;
        let low = [left + 0.008, -y + back, seat - cushion_high];
        model.soft_block(low, [left + each - 0.008, y + 0.01, seat], 0.03, cushion);
        if chance(rng, 0.7) {
            let low = [left + 0.01, -y + back, seat + 0.01];
            let top = high - between(rng, 0.0, 0.08);
            model.soft_block(low, [left + each - 0.01, -y + back + 0.13, top], 0.04, cushion);
        }
    }
    let leg = (0.045, chance(rng, 0.5));
    legs(&mut model, [x - 0.08, y - 0.08], rise, 0.0, leg, wood(rng).1);
    model.support([-x + arm, -y + back + 0.14], [x - arm, y - 0.04], seat + 0.03, high);
    model.solid([-x - soft, -y - soft, 0.0], [x + soft, y + 0.04, seat + 0.025]);
    model.solid([-x - soft, -y - soft, 0.0], [x + soft, -y + back + 0.13, high + soft]);
    for side in SIDES {
        model.solid([side * (x - arm), -y, 0.0], [side * (x + soft), y, arm_high + soft]);
    }
    if seats <= 3 && chance(rng, 0.35) {
        chaise(&mut model, [x, y, seat], [arm, each, rise], cushion_high, cushion, rng);
    }
    model
}

/// Makes a corner sofa: the last seat reaches forwards.
fn chaise(
    model: &mut Model,
    [x, y, seat]: [f64; 3],
    [arm, each, rise]: [f64; 3],
    cushion_high: f64,
    cushion: Material,
    rng: &mut SampleRng,
) {
    let reach = between(rng, 0.5, 0.95);
    let right = chance(rng, 0.5);
    let (left_x, right_x) = if right { (x - arm - each, x) } else { (-x, -x + arm + each) };
    model.block([left_x, y, rise], [right_x, y + reach, seat - cushion_high], cushion.shaded(0.95));
    let low = [left_x + 0.01, y + 0.01, seat - cushion_high];
    model.soft_block(low, [right_x - 0.01, y + reach, seat], 0.03, cushion);
    model.solid([left_x, y, 0.0], [right_x, y + reach + 0.03, seat + 0.03]);
}

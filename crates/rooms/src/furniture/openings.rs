//! Windows, doors, curtains, radiators: what belongs to a wall.
//!
//! Windows and doors have their middle in the plane of the wall, y = 0, and stand at z = 0.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::ColorName::{Beige, Blue, Green, Grey, White};
use crate::material::{Material, Texture, fabric, metal, painted, wood};
use crate::model::{Model, SIDES};
use crate::shape::Wave;
use scenesplat_kernels::random::SampleRng;

/// Tiles of a wall.
pub(crate) fn tiles(rng: &mut SampleRng) -> Material {
    let name = pick(rng, &[White, White, Grey, Beige, Blue, Green]);
    let base = name.sample(rng);
    let joint = if chance(rng, 0.5) { base.map(|c| c * 0.78) } else { [225.0; 3] };
    Material::new(base, Texture::Tiles(between(rng, 0.1, 0.35)), rng).with_second(joint)
}

/// What is seen through the panes: sky above, something green or gray below, or only light.
pub(crate) fn outside(rng: &mut SampleRng) -> Material {
    let (base, size, second) = match whole(rng, 0, 2) {
        0 => ([206.0, 222.0, 240.0], 1.2, [250.0; 3]),
        1 => ([120.0, 150.0, 110.0], 0.35, [196.0, 216.0, 240.0]),
        _ => ([238.0, 240.0, 240.0], 0.8, [212.0, 222.0, 236.0]),
    };
    Material::new(base, Texture::Sheen(size), rng).with_second(second)
}

/// Of the given size; `recess` meters behind the wall's face.
pub(crate) fn window([wide, high]: [f64; 2], recess: f64, rng: &mut SampleRng) -> Model {
    let (color, frame) = if chance(rng, 0.6) {
        (White, Material::plain(White.sample(rng)))
    } else if chance(rng, 0.5) {
        wood(rng)
    } else {
        painted(rng)
    };
    let mut model = Model::new(ClassId::Window, color, 1.2);
    let (x, rim) = (wide / 2.0, between(rng, 0.04, 0.09));
    let y = -recess;
    let bar = |model: &mut Model, a: [f64; 2], b: [f64; 2]| {
        model.block([a[0], y - 0.02, a[1]], [b[0], y + 0.03, b[1]], frame);
    };
    bar(&mut model, [-x, 0.0], [x, rim]);
    bar(&mut model, [-x, high - rim], [x, high]);
    bar(&mut model, [-x, rim], [-x + rim, high - rim]);
    bar(&mut model, [x - rim, rim], [x, high - rim]);
    let columns = whole(rng, 1, if wide > 1.3 { 3 } else { 2 });
    for i in 1..columns {
        let at = -x + wide * f64::from(i) / f64::from(columns);
        bar(&mut model, [at - rim * 0.6, rim], [at + rim * 0.6, high - rim]);
    }
    if chance(rng, 0.3) {
        let z = high * between(rng, 0.3, 0.7);
        bar(&mut model, [-x + rim, z - 0.02], [x - rim, z + 0.02]);
    }
    let glass = outside(rng);
    // Glass is seen badly: fewer Gaussians.
    model.density = 0.7;
    let (w, h) = (x - rim, high - 2.0 * rim);
    model.face([w, y, rim], [-2.0 * w, 0.0, 0.0], [0.0, 0.0, h], glass);
    model.density = 1.2;
    if recess > 0.03 {
        // The sides of the opening, and a sill.
        for (corner, u, v) in [
            ([-x, 0.0, 0.0], [0.0, 0.0, high], [0.0, y, 0.0]),
            ([x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, high]),
            ([-x, 0.0, high], [2.0 * x, 0.0, 0.0], [0.0, y, 0.0]),
        ] {
            model.face(corner, u, v, frame);
        }
    }
    if chance(rng, 0.6) {
        let out = between(rng, 0.03, 0.09);
        model.block([-x - 0.04, y, -0.03], [x + 0.04, out, 0.0], frame);
    }
    model
}

pub(crate) fn door([wide, high]: [f64; 2], rng: &mut SampleRng) -> Model {
    let (color, leaf) = if chance(rng, 0.65) { wood(rng) } else { painted(rng) };
    let frame =
        if chance(rng, 0.5) { leaf.shaded(0.92) } else { Material::plain([232.0, 230.0, 224.0]) };
    let mut model = Model::new(ClassId::Door, color, 1.3);
    let (x, rim) = (wide / 2.0, between(rng, 0.05, 0.09));
    for (left, right, low) in [(-x, -x + rim, 0.0), (x - rim, x, 0.0), (-x, x, high - rim)] {
        model.block([left, -0.03, low], [right, 0.025, high], frame);
    }
    let (w, top) = (x - rim, high - rim);
    let y = between(rng, -0.04, 0.0);
    model.face([w, y, 0.01], [-2.0 * w, 0.0, 0.0], [0.0, 0.0, top], leaf);
    let b = w * 0.72;
    let mut raised = |low: f64, top: f64, material: Material| {
        model.block([-b, y, low], [b, y + 0.015, top], material);
    };
    match whole(rng, 0, 3) {
        0 => {
            raised(0.15, top * 0.42, leaf.shaded(0.93));
            raised(top * 0.5, top - 0.12, leaf.shaded(0.93));
        }
        1 => {
            let glass = outside(rng);
            raised(0.15, top * 0.4, leaf.shaded(0.95));
            raised(top * 0.48, top - 0.12, glass);
        }
        2 => {
            for i in 0..4 {
                let z = 0.12 + f64::from(i) * (top - 0.2) / 4.0;
                raised(z, z + (top - 0.2) / 4.0 - 0.06, leaf.shaded(0.95));
            }
        }
        _ => {}
    }
    let side = if chance(rng, 0.5) { 1.0 } else { -1.0 };
    let handle = metal(rng).1;
    let at = [side * (w - 0.07), y, 1.02];
    model.rod(at, [at[0], y + 0.055, at[2]], 0.012, handle);
    model.beam([at[0], y + 0.055, at[2]], [at[0] - side * 0.12, y + 0.055, at[2]], 0.02, handle);
    model.centred([at[0], y + 0.005, at[2]], [0.05, 0.012, 0.2], handle);
    model
}

/// One cloth, or one to each side of a window; hangs from z = `high` to near z = 0.
pub(crate) fn curtain(half: f64, high: f64, rng: &mut SampleRng) -> Model {
    let (color, cloth) = fabric(rng);
    let mut model = Model::new(ClassId::Curtain, color, 1.2);
    let rod = metal(rng).1;
    model.rod([-half, 0.0, high + 0.02], [half, 0.0, high + 0.02], 0.014, rod);
    let share = between(rng, 0.16, 0.36);
    let low = between(rng, 0.01, 0.05);
    let amplitude = between(rng, 0.025, 0.045);
    let hang = |model: &mut Model, a: f64, b: f64, rng: &mut SampleRng| {
        let count = ((b - a) / between(rng, 0.09, 0.16)).max(2.0);
        let wave = Wave { amplitude, count, phase: between(rng, 0.0, 1.0) };
        let narrow = if b > a + 0.3 { between(rng, 0.0, 0.08) } else { 0.0 };
        // Looks into the room: left × up.
        let corners =
            [[b - narrow, 0.0, low], [a + narrow, 0.0, low], [b, 0.0, high], [a, 0.0, high]];
        model.patch(corners, Some(wave), cloth);
    };
    if chance(rng, 0.8) {
        hang(&mut model, -half, -half + 2.0 * half * share, rng);
        hang(&mut model, half - 2.0 * half * share, half, rng);
    } else {
        hang(&mut model, -half, half, rng);
    }
    if chance(rng, 0.3) {
        // A thin net between them.
        let net = Material::plain([236.0, 236.0, 232.0]);
        let wave = Wave { amplitude: 0.015, count: 2.0 * half / 0.08, phase: 0.0 };
        let corners =
            [[half, -0.02, low], [-half, -0.02, low], [half, -0.02, high], [-half, -0.02, high]];
        model.density = 0.6;
        model.patch(corners, Some(wave), net);
    }
    model
}

/// On the wall below windows; stands at z = 0 with a gap below.
pub(crate) fn radiator(wide: f64, rng: &mut SampleRng) -> Model {
    let color = pick(rng, &[White, White, White, Grey, Beige]);
    let paint = Material::plain(color.sample(rng));
    let mut model = Model::new(ClassId::Radiator, color, 2.2);
    let (x, low) = (wide / 2.0, between(rng, 0.08, 0.16));
    let high = low + between(rng, 0.4, 0.62);
    let deep = between(rng, 0.04, 0.09);
    if chance(rng, 0.6) {
        // Upright ribs.
        let count = (wide / between(rng, 0.05, 0.08)) as u32;
        let step = wide / f64::from(count.max(1));
        for i in 0..count {
            let at = -x + step * (f64::from(i) + 0.5);
            let r = step * 0.38;
            model.soft_block([at - r, -deep, low], [at + r, deep, high], 0.004, paint);
        }
    } else {
        let wave = Wave { amplitude: 0.008, count: wide / 0.07, phase: 0.0 };
        let corners = [[x, deep, low], [-x, deep, low], [x, deep, high], [-x, deep, high]];
        model.patch(corners, Some(wave), paint);
        model.face(
            [-x, -deep, high],
            [2.0 * x, 0.0, 0.0],
            [0.0, 2.0 * deep, 0.0],
            paint.shaded(0.85),
        );
        for side in SIDES {
            let u = [0.0, side * 2.0 * deep, 0.0];
            model.face([side * x, -side * deep, low], u, [0.0, 0.0, high - low], paint);
        }
    }
    let pipe = metal(rng).1;
    for side in SIDES {
        let at = side * (x - 0.04);
        model.rod([at, 0.0, 0.0], [at, 0.0, low + 0.02], 0.012, pipe);
    }
    model
}

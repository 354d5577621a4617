//! Lamps on the floor, on furniture, and on the ceiling.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::{ColorName, Material, metal, painted, wood};
use crate::model::Model;
use crate::vector::V3;
use scenesplat_kernels::random::SampleRng;

/// A shade: warm and bright, or of any color.
fn shade(rng: &mut SampleRng) -> (ColorName, Material) {
    if chance(rng, 0.6) {
        let base =
            [between(rng, 236.0, 252.0), between(rng, 222.0, 240.0), between(rng, 176.0, 222.0)];
        return (ColorName::White, Material::plain(base));
    }
    let name = pick(rng, &ColorName::ALL);
    (name, Material::plain(name.sample(rng)))
}

/// A cone or drum seen from outside and inside, its lower rim around `at`.
fn lamp_shade(model: &mut Model, at: V3, [low, high, tall]: [f64; 3], material: Material) {
    let top = [at[0], at[1], at[2] + tall];
    model.cone(at, top, low, high, material);
    model.cone(top, at, high * 0.97, low * 0.97, material.shaded(1.06));
}

fn stand(rng: &mut SampleRng) -> Material {
    if chance(rng, 0.6) { metal(rng).1 } else { wood(rng).1 }
}

pub(crate) fn floor_lamp(rng: &mut SampleRng) -> Model {
    let (color, cloth) = shade(rng);
    let rod = stand(rng);
    let high = between(rng, 1.25, 1.8);
    let mut model = Model::new(ClassId::Lamp, color, 2.8);
    let r = between(rng, 0.15, 0.25);
    let tall = between(rng, 0.18, 0.38);
    match whole(rng, 0, 2) {
        0 => {
            // A tripod.
            for [x, y] in [[0.0, 0.26], [0.225, -0.13], [-0.225, -0.13]] {
                model.beam([x, y, 0.0], [0.0, 0.0, high - tall - 0.02], 0.03, rod);
            }
            lamp_shade(&mut model, [0.0, 0.0, high - tall], [r, r * 0.9, tall], cloth);
        }
        1 => {
            // An arc over a seat.
            let reach = between(rng, 0.25, 0.5);
            model.taper([0.0; 3], [0.0, 0.0, 0.03], 0.16, 0.15, rod);
            model.rod([0.0, 0.0, 0.03], [0.0, 0.0, high - reach], 0.014, rod);
            let (u, v) = ([reach / 2.0, 0.0, 0.0], [0.0, 0.0, reach]);
            let centre = [reach / 2.0, 0.0, high - reach];
            model.arc(centre, u, v, 0.014, rod);
            let at = [reach, 0.0, high - reach - tall * 0.8];
            lamp_shade(&mut model, at, [r * 0.8, r * 0.3, tall * 0.8], cloth);
        }
        _ => {
            let foot = between(rng, 0.11, 0.17);
            model.taper([0.0; 3], [0.0, 0.0, 0.025], foot, foot * 0.9, rod);
            model.rod([0.0, 0.0, 0.02], [0.0, 0.0, high - tall], 0.014, rod);
            let top = r * between(rng, 0.5, 1.0);
            lamp_shade(&mut model, [0.0, 0.0, high - tall], [r, top, tall], cloth);
        }
    }
    model
}

pub(crate) fn table_lamp(rng: &mut SampleRng) -> Model {
    let (color, cloth) = shade(rng);
    let body = if chance(rng, 0.5) { painted(rng).1 } else { stand(rng) };
    let mut model = Model::new(ClassId::Lamp, color, 4.0);
    let (base, tall) = (between(rng, 0.1, 0.28), between(rng, 0.13, 0.24));
    let r = between(rng, 0.09, 0.18);
    if chance(rng, 0.3) {
        // A desk lamp: two arms and a small reflector.
        let metal = metal(rng).1;
        model.taper([0.0; 3], [0.0, 0.0, 0.02], 0.09, 0.085, metal);
        let elbow = [-0.1, 0.0, 0.24];
        let head = [0.06, 0.04, 0.4];
        model.rod([0.0, 0.0, 0.02], elbow, 0.01, metal);
        model.rod(elbow, head, 0.01, metal);
        let at = [head[0] + 0.05, head[1] + 0.02, head[2] - 0.11];
        model.cone(at, head, 0.08, 0.035, cloth);
        return model;
    }
    match whole(rng, 0, 2) {
        0 => model.ball([0.0, 0.0, base / 2.0], [base * 0.42, base * 0.42, base / 2.0], 0.0, body),
        1 => model.taper([0.0; 3], [0.0, 0.0, base], r * 0.65, r * 0.25, body),
        _ => {
            model.taper([0.0; 3], [0.0, 0.0, 0.02], r * 0.7, r * 0.6, body);
            model.rod([0.0, 0.0, 0.02], [0.0, 0.0, base], 0.018, body);
        }
    }
    model.rod([0.0, 0.0, base], [0.0, 0.0, base + 0.05], 0.01, body);
    let top = r * between(rng, 0.5, 0.95);
    lamp_shade(&mut model, [0.0, 0.0, base + 0.03], [r, top, tall], cloth);
    model
}

/// Hangs from z = 0 downwards.
pub(crate) fn ceiling_lamp(longest: f64, rng: &mut SampleRng) -> Model {
    let (color, cloth) = shade(rng);
    let rod = metal(rng).1;
    let mut model = Model::new(ClassId::Lamp, color, 3.0);
    let r = between(rng, 0.14, 0.28);
    let drop = between(rng, 0.25, longest.max(0.3));
    let cord = |model: &mut Model, to: V3| {
        model.rod([0.0, 0.0, -0.03], to, 0.008, rod);
        model.taper([0.0, 0.0, -0.03], [0.0, 0.0, 0.0], 0.05, 0.05, rod);
    };
    match whole(rng, 0, 4) {
        0 => model.dome([0.0; 3], [r, r, 0.12], [-1.0, 0.0], 0.1, false, cloth),
        1 => {
            cord(&mut model, [0.0, 0.0, -drop]);
            model.ball([0.0, 0.0, -drop - r * 0.8], [r * 0.8; 3], 0.0, cloth);
        }
        2 => {
            cord(&mut model, [0.0, 0.0, -drop]);
            let tall = between(rng, 0.15, 0.28);
            lamp_shade(&mut model, [0.0, 0.0, -drop - tall], [r, r * 0.5, tall], cloth);
        }
        3 => {
            // A chandelier: arms with small shades.
            cord(&mut model, [0.0, 0.0, -drop]);
            let centre = [0.0, 0.0, -drop];
            model.ball(centre, [0.06; 3], 0.0, rod);
            let reach = r * 1.4;
            let (half, sin) = (0.5, 0.866);
            let right = [[1.0, 0.0], [half, sin], [-half, sin]];
            let left = [[-1.0, 0.0], [-half, -sin], [half, -sin]];
            for [x, y] in right.into_iter().chain(left) {
                let end = [x * reach, y * reach, -drop - 0.05];
                model.rod(centre, end, 0.012, rod);
                let up = [end[0], end[1], end[2] + 0.03];
                lamp_shade(&mut model, up, [0.06, 0.045, 0.1], cloth);
            }
        }
        _ => {
            // A long bar.
            let half = between(rng, 0.4, 0.65);
            model.block([-half, -0.06, -0.09], [half, 0.06, 0.0], cloth);
        }
    }
    model
}

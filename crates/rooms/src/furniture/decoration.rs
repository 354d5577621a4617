//! Plants, pictures, mirrors and rugs.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::{ColorName, Material, Texture, fabric, metal, painted, wood};
use crate::model::{Model, strips};
use crate::shape::Shape;
use crate::vector::{V3, times};
use scenesplat_kernels::random::{SampleRng, cos_sin};

fn leaf_green(rng: &mut SampleRng) -> Material {
    let base = [between(rng, 34.0, 110.0), between(rng, 90.0, 160.0), between(rng, 30.0, 80.0)];
    Material::new(base, Texture::Mottled(0.05), rng)
}

/// A pot with earth; returns the height and radius of the earth.
fn pot(model: &mut Model, size: f64, rng: &mut SampleRng) -> [f64; 2] {
    let clay = if chance(rng, 0.5) {
        Material::new([172.0, 98.0, 64.0], Texture::Mottled(0.1), rng)
    } else {
        painted(rng).1
    };
    let (r, high) = (size * between(rng, 0.12, 0.17), size * between(rng, 0.2, 0.34));
    let top = r * between(rng, 1.0, 1.35);
    if chance(rng, 0.75) {
        model.taper([0.0; 3], [0.0, 0.0, high], r, top, clay);
    } else {
        model.block([-r, -r, 0.0], [r, r, high], clay);
    }
    let earth = Material::new([70.0, 52.0, 38.0], Texture::Mottled(0.03), rng);
    model.level_disc([0.0, 0.0, high - 0.01], top.min(r * 1.05), earth);
    [high, r]
}

/// In a pot on the floor.
pub(crate) fn plant(rng: &mut SampleRng) -> Model {
    let tall = between(rng, 0.6, 1.6);
    grown(tall, between(rng, 0.8, 1.4), 1.3, rng)
}

/// In a small pot on furniture.
pub(crate) fn pot_plant(rng: &mut SampleRng) -> Model {
    let tall = between(rng, 0.22, 0.5);
    grown(tall, between(rng, 0.42, 0.6), 3.2, rng)
}

fn grown(tall: f64, pot_size: f64, density: f64, rng: &mut SampleRng) -> Model {
    let green = leaf_green(rng);
    let mut model = Model::new(ClassId::Plant, ColorName::Green, density);
    let [earth, r] = pot(&mut model, pot_size, rng);
    let crown = tall - earth;
    match whole(rng, 0, 3) {
        0 => stem_and_crown(&mut model, earth, tall, green, rng),
        1 => {
            for _ in 0..whole(rng, 9, 16) {
                blade(&mut model, [earth, crown, r], green, rng);
            }
        }
        2 => {
            for _ in 0..whole(rng, 14, 24) {
                frond(&mut model, [earth, crown], green, rng);
            }
        }
        _ => {
            for _ in 0..whole(rng, 7, 13) {
                stalk(&mut model, [earth, crown], green, rng);
            }
        }
    }
    model
}

/// A stem with a crown of small leaves.
fn stem_and_crown(m: &mut Model, earth: f64, tall: f64, green: Material, rng: &mut SampleRng) {
    let crown = tall - earth;
    let bark = Material::plain([96.0, 74.0, 50.0]);
    let split = earth + crown * between(rng, 0.2, 0.5);
    m.rod([0.0, 0.0, earth], [0.0, 0.0, split + 0.1 * crown], 0.01 + 0.012 * tall, bark);
    let radius = crown * between(rng, 0.2, 0.3);
    for _ in 0..whole(rng, 4, 8) {
        let [c, s] = cos_sin(rng);
        let reach = radius * between(rng, 0.1, 0.9);
        let z = between(rng, split + radius * 0.5, tall - radius * 0.5);
        let centre = [reach * c, reach * s, z];
        let green = green.shaded(between(rng, 0.85, 1.15));
        m.add(Shape::Foliage { centre, radius }, green);
    }
}

/// An upright blade.
fn blade(m: &mut Model, [earth, crown, r]: V3, green: Material, rng: &mut SampleRng) {
    let [c, s] = cos_sin(rng);
    let base = [0.5 * r * c, 0.5 * r * s, earth - 0.01];
    let out = crown * between(rng, 0.02, 0.22);
    let along = [out * c, out * s, crown * between(rng, 0.6, 1.0)];
    let side = times([-s, c, 0.0], crown * between(rng, 0.025, 0.05));
    let green = green.shaded(between(rng, 0.85, 1.2));
    m.add(Shape::Leaf { base, along, side, droop: 0.0 }, green);
}

/// A hanging frond from the middle.
fn frond(m: &mut Model, [earth, crown]: [f64; 2], green: Material, rng: &mut SampleRng) {
    let [c, s] = cos_sin(rng);
    let out = crown * between(rng, 0.35, 0.6);
    let along = [out * c, out * s, crown * between(rng, 0.5, 1.1)];
    let side = times([-s, c, 0.0], crown * between(rng, 0.04, 0.08));
    let droop = crown * between(rng, 0.2, 0.7);
    let green = green.shaded(between(rng, 0.8, 1.2));
    m.add(Shape::Leaf { base: [0.0, 0.0, earth], along, side, droop }, green);
}

/// A stalk with one large leaf.
fn stalk(m: &mut Model, [earth, crown]: [f64; 2], green: Material, rng: &mut SampleRng) {
    let [c, s] = cos_sin(rng);
    let reach = crown * between(rng, 0.05, 0.3);
    let base: V3 = [reach * c, reach * s, earth + crown * between(rng, 0.35, 0.85)];
    m.beam([0.0, 0.0, earth], base, 0.008, green.shaded(0.8));
    let size = crown * between(rng, 0.22, 0.36);
    let along = [size * c, size * s, size * between(rng, -0.1, 0.5)];
    let side = times([-s, c, 0.0], size * between(rng, 0.25, 0.4));
    let droop = size * between(rng, 0.0, 0.5);
    let green = green.shaded(between(rng, 0.85, 1.2));
    m.add(Shape::Leaf { base, along, side, droop }, green);
}

/// A flat thing on a wall with a frame around it; its back is at −y, its middle at z = 0.
fn framed(model: &mut Model, [x, z]: [f64; 2], rim: f64, frame: Material, inside: Material) {
    let (thick, w, h) = (0.025, x - rim, z - rim);
    if rim > 0.0 {
        for [a, b] in strips([x, z], [w, h]) {
            model.block([a[0], 0.0, a[1]], [b[0], thick, b[1]], frame);
        }
    }
    model.face([w, thick * 0.6, -h], [-2.0 * w, 0.0, 0.0], [0.0, 0.0, 2.0 * h], inside);
    model.add_hidden(Shape::flat([-x, 0.0, -z], [2.0 * x, 0.0, 0.0], [0.0, 0.0, 2.0 * z]), frame);
    model.solid([-x, 0.0, -z], [x, thick + 0.005, z]);
}

pub(crate) fn picture(rng: &mut SampleRng) -> Model {
    let [name, other] = [0; 2].map(|_| pick(rng, &ColorName::ALL));
    let texture = Texture::Painting(between(rng, 0.08, 0.3));
    let [base, second] = [name, other].map(|color| color.sample(rng));
    let paint = Material::new(base, texture, rng).with_second(second);
    let (x, z) = (between(rng, 0.18, 0.6), between(rng, 0.18, 0.45));
    let mut model = Model::new(ClassId::Picture, name, 2.2);
    let frame = if chance(rng, 0.5) { wood(rng).1 } else { painted(rng).1 };
    let rim = if chance(rng, 0.8) { between(rng, 0.015, 0.05) } else { 0.0 };
    framed(&mut model, [x, z], rim, frame, paint);
    if rim > 0.0 && chance(rng, 0.35) {
        // A mount between frame and paper.
        let w = [x - rim, z - rim];
        let mount = Material::plain([240.0, 238.0, 230.0]);
        let b = 0.2 * w[0].min(w[1]);
        for (lo, hi) in [([-w[0], -w[1]], [w[0], -w[1] + b]), ([-w[0], w[1] - b], w)] {
            let u = [lo[0] - hi[0], 0.0, 0.0];
            model.face([hi[0], 0.018, lo[1]], u, [0.0, 0.0, hi[1] - lo[1]], mount);
        }
    }
    model
}

pub(crate) fn mirror(rng: &mut SampleRng) -> Model {
    let frame = if chance(rng, 0.5) { metal(rng).1 } else { wood(rng).1 };
    let tint = between(rng, 140.0, 195.0);
    let sheen = Texture::Sheen(between(rng, 0.3, 0.9));
    let glass = Material::new([tint, tint + 8.0, tint + 14.0], sheen, rng).with_second([
        tint + 50.0,
        tint + 54.0,
        tint + 58.0,
    ]);
    let mut model = Model::new(ClassId::Mirror, ColorName::Grey, 1.7);
    if chance(rng, 0.3) {
        let (x, z) = (between(rng, 0.25, 0.4), between(rng, 0.25, 0.5));
        let (u, v) = ([-x, 0.0, 0.0], [0.0, 0.0, z]);
        model.disc([0.0, 0.02, 0.0], u, v, 0.0, glass);
        model.ring([0.0, 0.016, 0.0], u, v, 0.015, frame);
    } else {
        let (x, z) = (between(rng, 0.22, 0.5), between(rng, 0.3, 0.62));
        framed(&mut model, [x, z], between(rng, 0.01, 0.04), frame, glass);
    }
    model
}

/// On the floor; its middle at the origin.
pub(crate) fn rug([x, y]: [f64; 2], rng: &mut SampleRng) -> Model {
    let (color, cloth) = fabric(rng);
    let texture = match whole(rng, 0, 3) {
        0 => Texture::Stripes(between(rng, 0.1, 0.4)),
        1 => Texture::Checks(between(rng, 0.15, 0.5)),
        2 => Texture::Painting(between(rng, 0.2, 0.6)),
        _ => Texture::Mottled(0.06),
    };
    let cloth = Material { texture, ..cloth };
    let mut model = Model::new(ClassId::Rug, color, 1.1);
    let z = between(rng, 0.008, 0.022);
    if chance(rng, 0.2) {
        let r = x.min(y);
        model.level_disc([0.0, 0.0, z], r, cloth);
        model.solid([-r, -r, 0.0], [r, r, z]);
        return model;
    }
    model.face([-x, -y, z], [2.0 * x, 0.0, 0.0], [0.0, 2.0 * y, 0.0], cloth);
    if chance(rng, 0.5) {
        let edge = Material::plain(cloth.shaded(0.7).base);
        let b = between(rng, 0.04, 0.14);
        for (corner, u, v) in [
            ([-x, -y], [2.0 * x, 0.0], [0.0, b]),
            ([-x, y - b], [2.0 * x, 0.0], [0.0, b]),
            ([-x, -y], [b, 0.0], [0.0, 2.0 * y]),
            ([x - b, -y], [b, 0.0], [0.0, 2.0 * y]),
        ] {
            let lift = [corner[0], corner[1], z + 0.001];
            model.face(lift, [u[0], u[1], 0.0], [v[0], v[1], 0.0], edge);
        }
    }
    model.solid([-x, -y, 0.0], [x, y, z]);
    model
}

//! Small things that lie about.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick, small_turn, whole};
use crate::material::{ColorName, Material, Texture, metal, painted, wood};
use crate::model::{Model, SIDES};
use crate::shape::Shape;
use scenesplat_kernels::random::SampleRng;

/// One lying book, or a pile of them.
pub(crate) fn book(rng: &mut SampleRng) -> Model {
    let name = pick(rng, &ColorName::ALL);
    let mut model = Model::new(ClassId::Book, name, 5.0);
    let count = pick(rng, &[1, 1, 2, 3, 4]);
    let pages = Material::new([226.0, 218.0, 198.0], Texture::Stripes(0.003), rng)
        .with_second([205.0, 196.0, 174.0]);
    let mut z = 0.0;
    for i in 0..count {
        let cover = if i + 1 == count { name } else { pick(rng, &ColorName::ALL) };
        let cover = Material::plain(cover.sample(rng));
        let (x, y) = (between(rng, 0.075, 0.12), between(rng, 0.1, 0.16));
        let (dx, dy) = (between(rng, -0.012, 0.012), between(rng, -0.012, 0.012));
        let thick = between(rng, 0.018, 0.045);
        let (low, high) = ([dx - x, dy - y, z], [dx + x, dy + y, z + thick]);
        let lid = 0.003;
        let inside = [low[0] + 0.004, low[1] + 0.004, z + lid];
        model.block(inside, [high[0] - 0.004, high[1] - 0.004, z + thick - lid], pages);
        model.block([low[0], low[1], z + thick - lid], high, cover);
        let back = [0.0, low[1] - high[1], 0.0];
        model.face([low[0], high[1], z], back, [0.0, 0.0, thick], cover);
        if i == 0 {
            model.add_hidden(Shape::flat(low, [0.0, 2.0 * y, 0.0], [2.0 * x, 0.0, 0.0]), cover);
        }
        z += thick;
    }
    model
}

/// Printed paper: a light or a dark ground with blots of other colors.
fn print(rng: &mut SampleRng) -> (ColorName, Material) {
    let name = pick(rng, &ColorName::ALL);
    let other = pick(rng, &[ColorName::White, ColorName::White, ColorName::Black]);
    let (base, second) = (name.sample(rng), other.sample(rng));
    let texture = match whole(rng, 0, 2) {
        0 => Texture::Plain,
        1 => Texture::Painting(between(rng, 0.03, 0.12)),
        _ => Texture::Stripes(between(rng, 0.01, 0.04)),
    };
    let is_white = chance(rng, 0.4);
    let (name, [base, second]) = if is_white {
        (ColorName::White, [ColorName::White.sample(rng), base])
    } else {
        (name, [base, second])
    };
    (name, Material::new(base, texture, rng).with_second(second))
}

/// Magazines or papers, some over each other.
pub(crate) fn magazines(rng: &mut SampleRng) -> Model {
    let (name, cover) = print(rng);
    let mut model = Model::new(ClassId::Book, name, 4.0);
    let mut z = 0.0;
    for i in 0..whole(rng, 1, 4) {
        let paper = if i == 0 { cover } else { print(rng).1 };
        let (x, y) = (between(rng, 0.08, 0.115), between(rng, 0.11, 0.155));
        let (dx, dy) = (between(rng, -0.06, 0.06), between(rng, -0.05, 0.05));
        let thick = between(rng, 0.002, 0.01);
        let [c, s] = small_turn(rng, 0.5);
        let at = |a: f64, b: f64, z: f64| [dx + c * a - s * b, dy + s * a + c * b, z];
        let top = z + thick;
        model.patch([at(-x, -y, top), at(x, -y, top), at(-x, y, top), at(x, y, top)], None, paper);
        for [[ax, ay], [bx, by]] in
            [[[-x, -y], [x, -y]], [[x, -y], [x, y]], [[x, y], [-x, y]], [[-x, y], [-x, -y]]]
        {
            model.patch(
                [at(ax, ay, z), at(bx, by, z), at(ax, ay, top), at(bx, by, top)],
                None,
                paper.shaded(0.9),
            );
        }
        z = top;
    }
    model
}

/// A book or a leaflet that stands, leaning back.
pub(crate) fn standing_book(rng: &mut SampleRng) -> Model {
    let (name, cover) = print(rng);
    let mut model = Model::new(ClassId::Book, name, 4.0);
    let (x, high) = (between(rng, 0.06, 0.13), between(rng, 0.16, 0.32));
    let (lean, thick) = (between(rng, 0.0, 0.1), between(rng, 0.003, 0.03));
    let at = |x: f64, z: f64| [x, 0.04 - lean * z / high, z];
    let (low, across, up) = (at(-x, 0.0), [2.0 * x, 0.0, 0.0], [0.0, -lean, high]);
    // Up × across looks forwards.
    model.plate(low, up, across, thick, cover);
    if thick > 0.01 {
        for side in SIDES {
            let (a, b) = (at(side * x, 0.0), at(side * x, high));
            let back = |p: [f64; 3]| [p[0], p[1] - thick, p[2]];
            model.patch([a, back(a), b, back(b)], None, Material::plain([226.0, 218.0, 198.0]));
        }
    }
    model
}

/// A box of plastic with a lid, clear, white or colored.
pub(crate) fn lidded_box(rng: &mut SampleRng) -> Model {
    let (color, body) = match chance(rng, 0.5) {
        true => (
            ColorName::White,
            Material::new(ColorName::White.sample(rng), Texture::Sheen(0.1), rng),
        ),
        false => painted(rng),
    };
    let mut model = Model::new(ClassId::Box, color, 3.0);
    let (x, y, high) =
        (between(rng, 0.06, 0.18), between(rng, 0.05, 0.13), between(rng, 0.05, 0.14));
    model.soft_block([-x, -y, 0.0], [x, y, high], 0.004, body);
    let lid = if chance(rng, 0.5) { body.shaded(0.93) } else { painted(rng).1 };
    model.block([-x - 0.008, -y - 0.008, high], [x + 0.008, y + 0.008, high + 0.012], lid);
    model
}

/// A cardboard or plastic box, closed or with open flaps.
pub(crate) fn carton(rng: &mut SampleRng) -> Model {
    let half = [between(rng, 0.13, 0.3), between(rng, 0.12, 0.24)];
    carton_of(half, between(rng, 0.15, 0.45), rng)
}

/// A box that goes on a shelf or table.
pub(crate) fn small_carton(rng: &mut SampleRng) -> Model {
    let half = [between(rng, 0.07, 0.15), between(rng, 0.06, 0.11)];
    carton_of(half, between(rng, 0.06, 0.18), rng)
}

fn carton_of([x, y]: [f64; 2], high: f64, rng: &mut SampleRng) -> Model {
    let (color, card) = if chance(rng, 0.65) {
        let base =
            [between(rng, 168.0, 200.0), between(rng, 126.0, 150.0), between(rng, 84.0, 104.0)];
        (ColorName::Brown, Material::new(base, Texture::Mottled(0.08), rng))
    } else {
        painted(rng)
    };
    let mut model = Model::new(ClassId::Box, color, 2.2);
    let tape = Material::plain(card.base.map(|c| c * 1.12 + 8.0));
    if chance(rng, 0.7) {
        model.block([-x, -y, 0.0], [x, y, high], card);
        model.block([-x - 0.001, -0.025, high - 0.05], [x + 0.001, 0.025, high + 0.001], tape);
        return model;
    }
    for (corner, u) in [
        ([x, y, 0.0], [-2.0 * x, 0.0, 0.0]),
        ([-x, -y, 0.0], [2.0 * x, 0.0, 0.0]),
        ([-x, y, 0.0], [0.0, -2.0 * y, 0.0]),
        ([x, -y, 0.0], [0.0, 2.0 * y, 0.0]),
    ] {
        model.plate(corner, u, [0.0, 0.0, high], 0.005, card);
    }
    model.face([-x, -y, 0.01], [2.0 * x, 0.0, 0.0], [0.0, 2.0 * y, 0.0], card.shaded(0.8));
    // Flaps that stand outwards.
    let reach = y * between(rng, 0.5, 0.9);
    let rise = reach * between(rng, -0.5, 0.6);
    for side in SIDES {
        let (along, out) = ([2.0 * side * x, 0.0, 0.0], [0.0, side * reach, rise]);
        model.plate([-side * x, side * y, high], along, out, 0.004, card);
        let (along, out) = ([0.0, -2.0 * side * y, 0.0], [side * reach, 0.0, rise]);
        model.plate([side * x, side * y, high], along, out, 0.004, card);
    }
    model
}

pub(crate) fn trash_can(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.5) { painted(rng) } else { metal(rng) };
    let r = between(rng, 0.11, 0.18);
    let high = between(rng, 0.26, 0.6);
    let mut model = Model::new(ClassId::TrashCan, color, 3.0);
    let (dark, lid) = (body.shaded(0.55), body.shaded(0.8));
    if chance(rng, 0.7) {
        let top = r * between(rng, 1.0, 1.25);
        model.cone([0.0; 3], [0.0, 0.0, high], r, top, body);
        match whole(rng, 0, 2) {
            0 => {
                // Open: the inside and a bag's edge.
                model.cone([0.0, 0.0, high], [0.0, 0.0, 0.04], top * 0.97, r * 0.97, dark);
                let ground = 0.05 + 0.4 * high * between(rng, 0.0, 1.0);
                model.level_disc([0.0, 0.0, ground], r * 0.9, dark);
                let (u, v) = ([top, 0.0, 0.0], [0.0, top, 0.0]);
                model.ring([0.0, 0.0, high], u, v, 0.012, body.shaded(1.1));
            }
            1 => model.dome([0.0, 0.0, high], [top, top, 0.09], [0.0, 1.0], 0.0, false, lid),
            _ => {
                let upper = [0.0, 0.0, high + 0.03];
                model.taper([0.0, 0.0, high], upper, top * 1.03, top * 0.95, lid);
                model.block([-0.04, top * 0.9, 0.0], [0.04, top + 0.05, 0.03], dark);
            }
        }
    } else {
        let y = r * between(rng, 0.75, 1.0);
        model.soft_block([-r, -y, 0.0], [r, y, high], 0.006, body);
        model.block([-r - 0.008, -y - 0.008, high], [r + 0.008, y + 0.008, high + 0.03], lid);
        model.block([-r * 0.6, y, high * 0.72], [r * 0.6, y + 0.006, high * 0.9], dark);
    }
    model
}

/// With a handle; filled.
pub(crate) fn mug(rng: &mut SampleRng) -> Model {
    let name = pick(rng, &ColorName::ALL);
    let glaze = Material::plain(name.sample(rng));
    let mut model = Model::new(ClassId::Mug, name, 9.0);
    let (r, high) = (between(rng, 0.038, 0.052), between(rng, 0.085, 0.125));
    let top = r * between(rng, 0.98, 1.25);
    model.cone([0.0; 3], [0.0, 0.0, high], r, top, glaze);
    model.cone([0.0, 0.0, high], [0.0, 0.0, high * 0.2], top * 0.92, r * 0.9, glaze.shaded(0.9));
    let drinks = [[58.0, 36.0, 22.0], [150.0, 100.0, 50.0], [235.0, 230.0, 220.0]];
    let drink = Material::plain(pick(rng, &drinks));
    model.level_disc([0.0, 0.0, high * 0.8], top * 0.9, drink);
    let (u, v) = ([0.0, 0.0, high * 0.3], [high * 0.28, 0.0, 0.0]);
    model.arc([r * 0.98, 0.0, high * 0.5], u, v, 0.008, glaze);
    model
}

fn dial(rng: &mut SampleRng) -> (ColorName, Material, Material) {
    let (color, rim) = if chance(rng, 0.5) { wood(rng) } else { painted(rng) };
    let face = if chance(rng, 0.75) { [244.0, 242.0, 234.0] } else { [34.0, 34.0, 38.0] };
    (color, rim, Material::plain(face))
}

/// Hands and marks on a dial in the plane y = `front`.
fn hands(model: &mut Model, r: f64, front: f64, middle: f64, face: Material, rng: &mut SampleRng) {
    let ink = Material::plain(if face.base[0] > 128.0 { [24.0; 3] } else { [235.0; 3] });
    for long in [0.8, 0.5] {
        let [c, s] = scenesplat_kernels::random::cos_sin(rng);
        let end = [long * r * c, front, middle + long * r * s];
        model.beam([0.0, front, middle], end, 0.012, ink);
    }
    let quarters = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
    let between = |cos: f64, sin: f64| [[cos, sin], [-cos, sin], [cos, -sin], [-cos, -sin]];
    for [c, s] in [quarters, between(0.5, 0.866), between(0.866, 0.5)].into_iter().flatten() {
        let at = |k: f64| [k * r * c, front - 0.002, middle + k * r * s];
        model.beam(at(0.84), at(0.95), 0.01, ink);
    }
}

/// To hang on a wall; its back is at −y, its middle at z = 0.
pub(crate) fn wall_clock(rng: &mut SampleRng) -> Model {
    let (color, rim, face) = dial(rng);
    let r = between(rng, 0.13, 0.24);
    let mut model = Model::new(ClassId::Clock, color, 5.0);
    let thick = 0.035;
    if chance(rng, 0.75) {
        model.cone([0.0; 3], [0.0, thick, 0.0], r, r, rim);
        let (u, v) = ([-r, 0.0, 0.0], [0.0, 0.0, r]);
        model.disc([0.0, thick * 0.7, 0.0], u, v, 0.0, face);
        model.ring([0.0, thick, 0.0], u, v, 0.012, rim);
    } else {
        model.block([-r, 0.0, -r], [r, thick, r], rim);
        let b = r * 0.9;
        model.face([b, thick + 0.002, -b], [-2.0 * b, 0.0, 0.0], [0.0, 0.0, 2.0 * b], face);
    }
    hands(&mut model, r * 0.88, thick + 0.008, 0.0, face, rng);
    model
}

/// To stand on furniture.
pub(crate) fn standing_clock(rng: &mut SampleRng) -> Model {
    let (color, rim, face) = dial(rng);
    let r = between(rng, 0.055, 0.09);
    let mut model = Model::new(ClassId::Clock, color, 7.0);
    let middle = r + 0.025;
    let (u, v) = ([-r, 0.0, 0.0], [0.0, 0.0, r]);
    model.rod([0.0, -0.03, middle], [0.0, 0.02, middle], r, rim);
    model.disc([0.0, 0.022, middle], u, v, 0.0, face);
    hands(&mut model, r * 0.9, 0.026, middle, face, rng);
    for side in SIDES {
        let foot = [side * r * 0.7, 0.0, 0.0];
        model.rod(foot, [side * r * 0.5, 0.0, middle - r * 0.8], 0.01, rim);
        model.ball([side * r * 0.6, 0.0, middle + r * 0.95], [0.02; 3], 0.0, metal(rng).1);
    }
    model
}

//! Televisions, monitors, keyboards and laptops.

use crate::classes::ClassId;
use crate::dice::{between, chance, pick};
use crate::material::{ColorName, Material, Texture, casing};
use crate::model::{Model, SIDES};
use scenesplat_kernels::random::SampleRng;

/// Dark glass, or a lit picture or desktop.
fn screen(size: f64, rng: &mut SampleRng) -> Material {
    if chance(rng, 0.5) {
        let glass = between(rng, 12.0, 42.0);
        let glow = [glass + 40.0, glass + 44.0, glass + 50.0];
        return Material::new([glass; 3], Texture::Sheen(size), rng).with_second(glow);
    }
    let grounds =
        [[30.0, 34.0, 44.0], [36.0, 70.0, 120.0], [225.0, 228.0, 232.0], [60.0, 90.0, 70.0]];
    let base = pick(rng, &grounds);
    let second = if base[0] > 200.0 { [70.0, 90.0, 130.0] } else { [220.0, 222.0, 226.0] };
    Material::new(base, Texture::Screen(size * between(rng, 0.12, 0.25)), rng).with_second(second)
}

/// A flat box with a screen in front: `half` its width, z from `low` to `high`, front at `front`.
fn panel(
    model: &mut Model,
    half: f64,
    [low, high]: [f64; 2],
    front: f64,
    (body, rim, deep): (Material, f64, f64),
    rng: &mut SampleRng,
) {
    model.block([-half, front - deep, low], [half, front, high], body);
    let glass = screen(2.0 * half, rng);
    let (x, z) = (half - rim, [low + rim * 1.4, high - rim]);
    // Looks to the front: up × left.
    let corner = [x, front + 0.003, z[0]];
    model.face(corner, [-2.0 * x, 0.0, 0.0], [0.0, 0.0, z[1] - z[0]], glass);
}

/// On feet, to stand on furniture.
pub(crate) fn standing_tv(wide: f64, rng: &mut SampleRng) -> Model {
    let (color, body) = casing(rng);
    let mut model = Model::new(ClassId::Tv, color, 1.7);
    let high = wide * between(rng, 0.55, 0.62);
    let low = between(rng, 0.04, 0.09);
    panel(&mut model, wide / 2.0, [low, low + high], 0.03, (body, 0.012, 0.05), rng);
    for side in SIDES {
        let x = side * wide * between(rng, 0.15, 0.4);
        model.beam([x, 0.0, low], [x, -0.1, 0.01], 0.02, body);
        model.beam([x, 0.0, low], [x, 0.1, 0.01], 0.02, body);
    }
    model
}

/// To hang on a wall; its lower edge is at z = 0.
pub(crate) fn wall_tv(wide: f64, rng: &mut SampleRng) -> Model {
    let (color, body) = casing(rng);
    let mut model = Model::new(ClassId::Tv, color, 1.7);
    let high = wide * between(rng, 0.55, 0.62);
    panel(&mut model, wide / 2.0, [0.0, high], 0.03, (body, 0.012, 0.05), rng);
    model
}

pub(crate) fn monitor(rng: &mut SampleRng) -> Model {
    let (color, body) = casing(rng);
    let mut model = Model::new(ClassId::Monitor, color, 3.0);
    let half = between(rng, 0.2, 0.36);
    let high = 2.0 * half * between(rng, 0.56, 0.68);
    let low = between(rng, 0.07, 0.16);
    let rim = between(rng, 0.008, 0.025);
    panel(&mut model, half, [low, low + high], 0.03, (body, rim, between(rng, 0.03, 0.06)), rng);
    model.beam([0.0, -0.04, 0.01], [0.0, -0.03, low + high * 0.4], 0.045, body);
    let (bx, by) = (half * between(rng, 0.35, 0.6), between(rng, 0.08, 0.12));
    if chance(rng, 0.5) {
        model.block([-bx, -0.03 - by, 0.0], [bx, -0.03 + by, 0.012], body);
    } else {
        let (u, v) = ([bx, 0.0, 0.0], [0.0, by, 0.0]);
        model.disc([0.0, -0.03, 0.012], u, v, 0.0, body);
    }
    model
}

pub(crate) fn keyboard(rng: &mut SampleRng) -> Model {
    let (color, body) = casing(rng);
    let keys = keys_on(body, rng);
    let (x, y) = (between(rng, 0.17, 0.24), between(rng, 0.06, 0.085));
    let (front, back) = (between(rng, 0.012, 0.02), between(rng, 0.022, 0.04));
    let mut model = Model::new(ClassId::Keyboard, color, 7.0);
    let corners = [[-x, -y, back], [x, -y, back], [-x, y, front], [x, y, front]];
    model.patch(corners, None, keys);
    let sides = [
        [[x, y, 0.0], [-x, y, 0.0], [x, y, front], [-x, y, front]],
        [[-x, -y, 0.0], [x, -y, 0.0], [-x, -y, back], [x, -y, back]],
        [[x, -y, 0.0], [x, y, 0.0], [x, -y, back], [x, y, front]],
        [[-x, y, 0.0], [-x, -y, 0.0], [-x, y, front], [-x, -y, back]],
    ];
    for corners in sides {
        model.patch(corners, None, body);
    }
    model
}

fn keys_on(body: Material, rng: &mut SampleRng) -> Material {
    let contrast = if body.base[0] > 120.0 { 0.7 } else { 1.9 };
    let base = if chance(rng, 0.5) { body.base } else { body.base.map(|c| c * contrast + 4.0) };
    let keys = Material::new(base, Texture::Keys(between(rng, 0.017, 0.021)), rng);
    keys.with_second(body.base.map(|c| c * 0.7))
}

/// Open, its screen leaning backwards.
pub(crate) fn laptop(rng: &mut SampleRng) -> Model {
    let color = pick(rng, &[ColorName::Black, ColorName::Grey, ColorName::Grey, ColorName::White]);
    let body = Material::plain(color.sample(rng));
    let (x, y) = (between(rng, 0.15, 0.2), between(rng, 0.105, 0.14));
    let mut model = Model::new(ClassId::Laptop, color, 6.0);
    model.block([-x, -y, 0.0], [x, y, 0.018], body);
    let keys = keys_on(body, rng);
    let (kx, ky) = (x - 0.02, y * 0.55);
    model.face([-kx, -y + 0.015, 0.02], [2.0 * kx, 0.0, 0.0], [0.0, 2.0 * ky, 0.0], keys);
    let lean = between(rng, 0.03, 0.12);
    let up = [0.0, -lean, 2.0 * y * 0.95];
    let across = [-2.0 * x, 0.0, 0.0];
    model.plate([x, -y, 0.015], across, up, 0.012, body);
    let inset = 0.012;
    let corner = [x - inset, -y + 0.002, 0.015 + 2.0 * inset];
    let glass = screen(2.0 * x, rng);
    let across = [-2.0 * (x - inset), 0.0, 0.0];
    model.face(corner, across, [0.0, up[1] * 0.86, up[2] * 0.86], glass);
    model
}

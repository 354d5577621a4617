//! Kitchen runs, refrigerators, stoves and range hoods.

use super::storage::door_fronts;
use super::tables::{drawer_fronts, worktop};
use crate::classes::ClassId;
use crate::dice::{between, chance, pick};
use crate::material::ColorName::{Black, Green, Grey, Red, White};
use crate::material::{ColorName, Material, metal, painted, wood};
use crate::model::{Model, SIDES, strips};
use scenesplat_kernels::random::SampleRng;

/// What all units of a kitchen share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Style {
    pub(crate) color: ColorName,
    pub(crate) front: Material,
    pub(crate) top: Material,
    pub(crate) deep: f64,
    pub(crate) high: f64,
}

impl Style {
    pub(crate) fn new(rng: &mut SampleRng) -> Self {
        let (color, front) = if chance(rng, 0.6) { painted(rng) } else { wood(rng) };
        Self {
            color,
            front,
            top: worktop(rng),
            deep: between(rng, 0.56, 0.64),
            high: between(rng, 0.86, 0.94),
        }
    }
}

impl Style {
    /// Mostly in a strong color, with a dark worktop as often as not.
    pub(crate) fn bold(rng: &mut SampleRng) -> Self {
        let usual = Self::new(rng);
        let (color, front) = match chance(rng, 0.6) {
            true => {
                let name = pick(rng, &ColorName::ALL);
                (name, Material::plain(name.sample(rng)))
            }
            false => (usual.color, usual.front),
        };
        let top = match chance(rng, 0.5) {
            true => Material::plain(pick(rng, &[Black, Black, Grey]).sample(rng)),
            false => usual.top,
        };
        Self { color, front, top, ..usual }
    }
}

/// A base unit of the given width with its worktop; with a basin if a sink goes in.
pub(crate) fn base_unit(style: &Style, wide: f64, has_sink: bool, rng: &mut SampleRng) -> Model {
    let (x, y) = (wide / 2.0, style.deep / 2.0);
    let high = style.high;
    let mut model = Model::new(ClassId::KitchenCabinet, style.color, 1.4);
    if has_sink {
        // Open above, so that the basin is seen and not a lid under it.
        let (low, rim) = (high - 0.25, high - 0.04);
        model.block([-x, -y, 0.1], [x, y - 0.03, low], style.front);
        model.block([-x, y - 0.05, low], [x, y - 0.03, rim], style.front);
        model.block([-x, -y, low], [-x + 0.02, y - 0.05, rim], style.front);
        model.block([x - 0.02, -y, low], [x, y - 0.05, rim], style.front);
    } else {
        model.block([-x, -y, 0.1], [x, y - 0.03, high - 0.04], style.front);
    }
    model.block([-x, -y, 0.0], [x, y - 0.08, 0.1], style.front.shaded(0.4));
    let span = [-x, x];
    if !has_sink && chance(rng, 0.4) {
        let count = pick(rng, &[3, 4]);
        drawer_fronts(&mut model, span, [0.11, high - 0.05], y - 0.03, count, style.front, rng);
    } else {
        let count = (wide / 0.5).round().max(1.0) as u32;
        door_fronts(&mut model, span, [0.11, high - 0.05], y - 0.03, count, style.front, rng);
    }
    if has_sink {
        // The worktop leaves room for the basin.
        let (bx, by) = (0.27, 0.21);
        model.block([-x, -y, high - 0.04], [-bx, y, high], style.top);
        model.block([bx, -y, high - 0.04], [x, y, high], style.top);
        model.block([-bx, -y, high - 0.04], [bx, -by, high], style.top);
        model.block([-bx, by, high - 0.04], [bx, y, high], style.top);
    } else {
        model.block([-x, -y, high - 0.04], [x, y, high], style.top);
        model.support([-x + 0.03, -y + 0.03], [x - 0.03, y - 0.05], high, 0.45);
    }
    model.solid([-x, -y, 0.0], [x, y, high]);
    model
}

/// The basin of a base unit with its tap; its rim is at z = 0.
pub(crate) fn kitchen_sink(rng: &mut SampleRng) -> Model {
    let (color, steel) = if chance(rng, 0.75) {
        let base = between(rng, 150.0, 195.0);
        (Grey, Material::plain([base, base, base + 3.0]))
    } else {
        (White, Material::plain(White.sample(rng)))
    };
    let (x, y, deep) = (0.26, 0.2, between(rng, 0.14, 0.2));
    let mut model = Model::new(ClassId::Sink, color, 3.5);
    basin(&mut model, [x, y, 0.0], deep, 0.94, steel);
    // A rim that lies on the worktop.
    for [low, high] in strips([x + 0.02, y + 0.02], [x, y]) {
        model.block([low[0], low[1], 0.0], [high[0], high[1], 0.008], steel);
    }
    tap(&mut model, [0.0, -y - 0.045, 0.0], between(rng, 0.18, 0.3), metal(rng).1);
    model.solid([-x - 0.02, -y - 0.07, 0.001], [x + 0.02, y + 0.02, 0.31]);
    model
}

/// Four walls and a floor that look inwards, open above `high`.
pub(super) fn basin(
    model: &mut Model,
    [x, y, high]: [f64; 3],
    deep: f64,
    taper: f64,
    material: Material,
) {
    let (bx, by) = (x * taper, y * taper);
    let ring = |x: f64, y: f64, z: f64| [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]];
    let (rim, low) = (ring(x, y, high), ring(bx, by, -deep + high));
    for i in 0..4 {
        let j = (i + 1) % 4;
        // Along the rim times downwards looks inwards in this order.
        model.patch([rim[j], rim[i], low[j], low[i]], None, material);
    }
    model.face(low[0], [2.0 * bx, 0.0, 0.0], [0.0, 2.0 * by, 0.0], material.shaded(0.92));
}

/// A bent tap that reaches forwards from `at`.
pub(super) fn tap(model: &mut Model, at: [f64; 3], high: f64, material: Material) {
    let r = 0.07;
    let neck = [at[0], at[1], at[2] + high - r];
    model.rod(at, neck, 0.014, material);
    let centre = [at[0], at[1] + r, neck[2]];
    model.arc(centre, [0.0, r, 0.0], [0.0, 0.0, r], 0.012, material);
    let end = [at[0], at[1] + 2.0 * r, neck[2]];
    model.rod([end[0], end[1], end[2] - 0.03], end, 0.013, material);
}

/// A cupboard on the wall; its underside is at z = 0.
pub(crate) fn wall_unit(style: &Style, wide: f64, rng: &mut SampleRng) -> Model {
    let (x, y) = (wide / 2.0, 0.17);
    let high = 0.68;
    let mut model = Model::new(ClassId::KitchenCabinet, style.color, 1.4);
    model.block([-x, -y, 0.0], [x, y, high], style.front);
    let (deep, across) = ([0.0, 2.0 * y, 0.0], [2.0 * x, 0.0, 0.0]);
    model.face([-x, -y, -0.001], deep, across, style.front.shaded(0.8));
    let count = (wide / 0.5).round().max(1.0) as u32;
    door_fronts(&mut model, [-x, x], [0.0, high], y, count, style.front, rng);
    model
}

pub(crate) fn refrigerator(rng: &mut SampleRng) -> Model {
    let color = pick(rng, &[White, White, Grey, Grey, Black, Red, Green]);
    let body = Material::plain(color.sample(rng));
    let wide = pick(rng, &[0.55, 0.6, 0.7, 0.9]);
    let (x, y) = (wide / 2.0, between(rng, 0.3, 0.37));
    let high = between(rng, 1.4, 1.98);
    let mut model = Model::new(ClassId::Refrigerator, color, 1.4);
    model.block([-x, -y, 0.03], [x, y - 0.06, high], body);
    let (handle, front) = (metal(rng).1, body.shaded(1.04));
    let side = if chance(rng, 0.5) { 1.0 } else { -1.0 };
    if wide > 0.8 {
        for i in SIDES {
            let (a, b) = (i * 0.004, i * x);
            let (low, top) = ([a.min(b), y - 0.05, 0.05], [a.max(b), y, high]);
            model.soft_block(low, top, 0.004, front);
            let at = |z: f64| [i * 0.05, y + 0.03, z];
            model.beam(at(high * 0.45), at(high * 0.75), 0.025, handle);
        }
    } else {
        let split = high
            * if chance(rng, 0.5) { between(rng, 0.3, 0.42) } else { between(rng, 0.62, 0.72) };
        for (low, top) in [(0.05, split - 0.006), (split + 0.006, high)] {
            model.soft_block([-x, y - 0.05, low], [x, y, top], 0.004, front);
            let (middle, long) = ((low + top) / 2.0, (top - low) * 0.3);
            let at = |z: f64| [side * (x - 0.05), y + 0.03, z];
            model.beam(at(middle - long), at(middle + long * 0.5), 0.025, handle);
        }
    }
    model.solid([-x - 0.005, -y, 0.0], [x + 0.005, y + 0.05, high + 0.005]);
    model
}

pub(crate) fn stove(style: &Style, rng: &mut SampleRng) -> Model {
    let color = pick(rng, &[White, Grey, Black, Black]);
    let body = Material::plain(color.sample(rng));
    let dark = Material::plain([26.0, 26.0, 28.0]);
    let (x, y) = (0.3, style.deep / 2.0);
    let high = style.high;
    let mut model = Model::new(ClassId::Stove, color, 2.0);
    model.block([-x, -y, 0.03], [x, y - 0.03, high], body);
    model.block([-x + 0.01, y - 0.03, 0.16], [x - 0.01, y, high - 0.16], dark);
    model.block([-x + 0.01, y - 0.03, 0.04], [x - 0.01, y - 0.01, 0.15], body);
    let at = |x: f64| [x, y + 0.035, high - 0.2];
    model.beam(at(-x + 0.06), at(x - 0.06), 0.02, metal(rng).1);
    for i in 0..5 {
        let at = [-0.22 + 0.11 * f64::from(i), y - 0.03, high - 0.08];
        model.rod(at, [at[0], at[1] + 0.03, at[2]], 0.02, dark);
    }
    let plate = if chance(rng, 0.5) { dark } else { body };
    model.block([-x + 0.01, -y + 0.02, high], [x - 0.01, y - 0.03, high + 0.012], plate);
    let gas = chance(rng, 0.5);
    let ring = Material::plain(if gas { [45.0; 3] } else { [120.0, 60.0, 50.0] });
    for (cx, cy) in [(-0.14, -0.12), (0.14, -0.12), (-0.14, 0.12), (0.14, 0.12)] {
        let z = high + if gas { 0.035 } else { 0.016 };
        let r = 0.095;
        let (u, v) = ([r, 0.0, 0.0], [0.0, r, 0.0]);
        model.ring([cx, cy, z], u, v, 0.008, ring);
        if gas {
            model.beam([cx - r, cy, z], [cx + r, cy, z], 0.012, ring);
            model.beam([cx, cy - r, z], [cx, cy + r, z], 0.012, ring);
        }
    }
    model.solid([-x, -y, 0.0], [x, y + 0.05, high + 0.06]);
    model
}

/// Hangs over a stove; its lower edge is at z = 0.
pub(crate) fn range_hood(reach_up: f64, rng: &mut SampleRng) -> Model {
    let color = pick(rng, &[Grey, Grey, White, Black]);
    let body = Material::plain(color.sample(rng));
    let mut model = Model::new(ClassId::RangeHood, color, 2.2);
    let (x, y, low) = (0.3, 0.25, between(rng, 0.04, 0.1));
    model.block([-x, -y, 0.0], [x, y, low], body);
    model.face([-x, -y, -0.001], [0.0, 2.0 * y, 0.0], [2.0 * x, 0.0, 0.0], body.shaded(0.6));
    let (cx, cy) = (0.14, 0.13);
    let neck = low + between(rng, 0.12, 0.26);
    let ring =
        |x: f64, front: f64, z: f64| [[-x, -y, z], [x, -y, z], [x, front, z], [-x, front, z]];
    let (wide, tight) = (ring(x, y, low), ring(cx, -y + 2.0 * cy, neck));
    for i in 0..4 {
        let j = (i + 1) % 4;
        let corners = [wide[i], wide[j], tight[i], tight[j]];
        model.patch(corners, None, body);
    }
    let top = (neck + between(rng, 0.3, 0.8)).min(reach_up);
    if top > neck + 0.05 {
        model.block([-cx, -y, neck], [cx, -y + 2.0 * cy, top], body.shaded(0.97));
    }
    model
}

//! Beds, nightstands and pillows.

use super::seating::legs;
use super::tables::drawer_fronts;
use crate::classes::ClassId;
use crate::dice::{between, chance, pick, whole};
use crate::material::{ColorName, Material, fabric, metal, painted, wood};
use crate::model::Model;
use crate::shape::{Shape, Wave};
use scenesplat_kernels::random::SampleRng;

/// The head is at the back (−y), so that a bed stands with its head to the wall.
pub(crate) fn bed(rng: &mut SampleRng) -> Model {
    let w = pick(rng, &[0.9, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0]);
    let long = between(rng, 1.95, 2.15);
    let (rise, seat) = (between(rng, 0.2, 0.34), between(rng, 0.42, 0.62));
    let head = between(rng, 0.75, 1.3);
    let (x, y) = (w / 2.0, long / 2.0);
    let (cover_color, cover) = fabric(rng);
    let (frame_color, frame) = if chance(rng, 0.7) { wood(rng) } else { fabric(rng) };
    let has_cover = chance(rng, 0.8);
    let color = if has_cover { cover_color } else { frame_color };
    let mut model = Model::new(ClassId::Bed, color, 1.3);
    let sheet = Material::plain(ColorName::White.sample(rng));
    model.block([-x - 0.03, -y, rise - 0.14], [x + 0.03, y + 0.03, rise], frame);
    if chance(rng, 0.4) {
        model.block([-x, -y, 0.0], [x, y, rise - 0.14], frame.shaded(0.85));
    } else {
        legs(&mut model, [x - 0.05, y - 0.05], rise - 0.14, 0.0, (0.06, chance(rng, 0.5)), frame);
    }
    let from = -y + between(rng, 0.5, 0.75);
    if has_cover {
        model.soft_block([-x, -y + 0.02, rise], [x, from + 0.05, seat], 0.02, sheet);
        let first = model.surfaces.len();
        model.soft_block([-x, from + 0.05, rise], [x, y, seat], 0.0, sheet);
        model.surfaces[first..].iter_mut().for_each(|s| s.hidden = true);
    } else {
        model.soft_block([-x, -y + 0.02, rise], [x, y, seat], 0.02, cover);
    }
    if chance(rng, 0.9) {
        let soft = if chance(rng, 0.4) { 0.04 } else { 0.0 };
        model.soft_block([-x - 0.04, -y - 0.07, rise - 0.12], [x + 0.04, -y, head], soft, frame);
    }
    if chance(rng, 0.25) {
        model.block([-x - 0.03, y + 0.03, rise - 0.14], [x + 0.03, y + 0.08, seat + 0.12], frame);
    }
    if has_cover {
        blanket(&mut model, [x, y, seat], [from, rise], cover, rng);
    }
    model.support([-x + 0.03, -y + 0.04], [x - 0.03, -y + 0.5], seat + 0.025, 0.6);
    model.support([-x + 0.1, -y + 0.65], [x - 0.1, y - 0.15], seat + 0.075, 0.6);
    let end = y + 0.09;
    model.solid([-x - 0.05, -y - 0.11, 0.0], [x + 0.05, end, seat + 0.02]);
    model.solid([-x - 0.04, -y - 0.11, 0.0], [x + 0.04, -y + 0.03, head + 0.04]);
    model
}

/// A duvet over the lower part, hanging over both sides.
fn blanket(
    model: &mut Model,
    [x, y, seat]: [f64; 3],
    [from, rise]: [f64; 2],
    cover: Material,
    rng: &mut SampleRng,
) {
    let top = seat + between(rng, 0.03, 0.06);
    let end = y + 0.03;
    let amplitude = between(rng, 0.004, 0.014);
    let wave = Wave { amplitude, count: between(rng, 2.0, 6.0), phase: between(rng, 0.0, 1.0) };
    let (l, r) = (-x - 0.03, x + 0.03);
    let corners = [[l, from, top], [r, from, top], [l, end, top], [r, end, top]];
    model.patch(corners, Some(wave), cover);
    let low = (rise - 0.1).max(0.08);
    for side in [l, r] {
        let (a, b) = ([side, from, low], [side, end, low]);
        let (c, d) = ([side, from, top], [side, end, top]);
        let corners = if side > 0.0 { [a, b, c, d] } else { [b, a, d, c] };
        model.patch(corners, Some(wave), cover);
    }
    let corners = [[r, end, low], [l, end, low], [r, end, top], [l, end, top]];
    model.patch(corners, Some(wave), cover);
    // The turned-down edge.
    model.soft_block([l, from - 0.02, seat], [r, from + 0.2, top + 0.012], 0.0, cover.shaded(1.06));
}

pub(crate) fn nightstand(rng: &mut SampleRng) -> Model {
    let (color, body) = if chance(rng, 0.8) { wood(rng) } else { painted(rng) };
    let half = [between(rng, 0.19, 0.32), between(rng, 0.17, 0.25)];
    let high = between(rng, 0.42, 0.68);
    let rise = if chance(rng, 0.5) { between(rng, 0.08, 0.2) } else { 0.02 };
    let [x, y] = half;
    let mut model = Model::new(ClassId::Nightstand, color, 2.2);
    model.block([-x, -y, rise], [x, y, high], body);
    if chance(rng, 0.5) {
        model.block([-x - 0.015, -y, high], [x + 0.015, y + 0.02, high + 0.02], body.shaded(0.93));
    }
    let count = whole(rng, 1, 3);
    drawer_fronts(&mut model, [-x, x], [rise + 0.02, high - 0.02], y, count, body, rng);
    let frame = if chance(rng, 0.3) { metal(rng).1 } else { body.shaded(0.85) };
    legs(&mut model, [x - 0.03, y - 0.03], rise, 0.0, (0.035, chance(rng, 0.5)), frame);
    model.support([-x + 0.02, -y + 0.02], [x - 0.02, y - 0.02], high + 0.021, 0.8);
    model
}

/// Lies flat; its longer side along x.
pub(crate) fn pillow(rng: &mut SampleRng) -> Model {
    let (color, cover) = fabric(rng);
    let square = chance(rng, 0.5);
    let x = between(rng, 0.2, 0.34);
    let y = if square { x } else { between(rng, 0.18, 0.23) };
    let thick = between(rng, 0.05, 0.08);
    let mut model = Model::new(ClassId::Pillow, color, 2.2);
    let (corner, u, v) = ([-x, -y, thick], [2.0 * x, 0.0, 0.0], [0.0, 2.0 * y, 0.0]);
    model.add(Shape::bulging(corner, u, v, thick), cover);
    model.add_hidden(Shape::bulging(corner, v, u, thick), cover);
    model
}

//! What the charts of measurements share.

use scenesplat::page_kit::drawing::{Anchor, Color, Drawing};
use scenesplat::page_kit::scale::Scale;

pub(crate) const INK: Color = [40, 44, 52];
pub(crate) const SOFT: Color = [120, 126, 136];
const GRID: Color = [228, 229, 231];

/// The axes of a plot from left, top to right, bottom, and a grid whose values stand `apart` from them.
pub(crate) fn axes(
    d: &mut Drawing,
    [x, y]: [&Scale; 2],
    [left, top, right, bottom]: [f64; 4],
    apart: [f64; 2],
    (text_x, text_y): (impl Fn(f64) -> String, impl Fn(f64) -> String),
) {
    for tick in x.ticks() {
        let at = x.at(tick);
        d.line([at, top], [at, bottom], 1.0, GRID);
        d.text([at, bottom + apart[0]], 2, SOFT, Anchor::Middle, &text_x(tick));
    }
    for tick in y.ticks() {
        let at = y.at(tick);
        d.line([left, at], [right, at], 1.0, GRID);
        d.text([left - apart[1], at - 8.0], 2, SOFT, Anchor::End, &text_y(tick));
    }
    d.line([left, top], [left, bottom], 1.5, INK);
    d.line([left, bottom], [right, bottom], 1.5, INK);
}

/// Points with lines from each to the next.
pub(crate) fn curve(
    d: &mut Drawing,
    points: impl Iterator<Item = [f64; 2]> + Clone,
    width: f64,
    color: Color,
) {
    for (from, to) in points.clone().zip(points.clone().skip(1)) {
        d.line(from, to, width, color);
    }
    points.for_each(|at| d.disc(at, 4.0, color, [255; 3]));
}

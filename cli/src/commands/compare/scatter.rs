//! A picture of two evaluations: each class and each scene as a disc, the first evaluation to the right, the second upward.

use super::evaluations::{Comparison, Row};
use scenesplat::page_kit::drawing::{Anchor, Color, Drawing};
use scenesplat::page_kit::scale::Scale;

const PANEL: f64 = 560.0;
const LEFT: f64 = 70.0;
const TOP: f64 = 60.0;
const GAP: f64 = 110.0;
const INK: Color = [40, 40, 44];
const GRID: Color = [225, 225, 222];
const BETTER: Color = [31, 119, 180];
const WORSE: Color = [214, 85, 40];
/// Discs with a name: those that changed most.
const NAMED: usize = 10;
/// Width of a letter of a name, pixels.
const LETTER: f64 = 8.0;

/// Draws classes, and scenes if there are any.
pub(super) fn scatter(comparison: &Comparison) -> Drawing {
    let panels = [("IoU by class", &comparison.classes), ("f-mIoU by scene", &comparison.scenes)];
    let panels: Vec<_> = panels.into_iter().filter(|(_, rows)| !rows.is_empty()).collect();
    let width = LEFT + panels.len() as f64 * (PANEL + GAP);
    let mut drawing = Drawing::new(width as u32, (TOP + PANEL + 70.0) as u32);
    for (i, (title, rows)) in panels.into_iter().enumerate() {
        panel(&mut drawing, LEFT + i as f64 * (PANEL + GAP), title, rows);
    }
    drawing
}

fn panel(d: &mut Drawing, left: f64, title: &str, rows: &[Row]) {
    let [right, bottom] = [left + PANEL, TOP + PANEL];
    // Both axes are the same, so that the diagonal is one.
    let x = Scale::over(&[0.0, 1.0], false, [left, right]);
    let y = Scale::over(&[0.0, 1.0], false, [bottom, TOP]);
    for tick in x.ticks() {
        let text = format!("{:.0}%", 100.0 * tick);
        d.line([x.at(tick), TOP], [x.at(tick), bottom], 1.0, GRID);
        d.line([left, y.at(tick)], [right, y.at(tick)], 1.0, GRID);
        d.text([x.at(tick), bottom + 8.0], 1, INK, Anchor::Middle, &text);
        d.text([left - 8.0, y.at(tick) - 4.0], 1, INK, Anchor::End, &text);
    }
    d.dashes([left, bottom], [right, TOP], INK);
    d.text([left, TOP - 34.0], 2, INK, Anchor::Start, title);
    d.text([right, bottom + 26.0], 1, INK, Anchor::End, "a (first)");
    d.text([left, TOP - 12.0], 1, INK, Anchor::Start, "b (second); above the line: better in b");
    let most = rows.iter().map(|row| row.labelled).max().unwrap_or(1).max(1) as f64;
    let mut placed: Vec<(&Row, [f64; 2])> =
        rows.iter().filter_map(|row| Some((row, [x.at(row.iou[0]?), y.at(row.iou[1]?)]))).collect();
    // Large discs first, so that small ones lie on them.
    placed.sort_by_key(|(row, _)| std::cmp::Reverse(row.labelled));
    for (row, at) in &placed {
        let radius = 4.0 + 10.0 * (row.labelled as f64 / most).sqrt();
        let color = if row.change().is_some_and(|c| c < 0.0) { WORSE } else { BETTER };
        d.disc(*at, radius, color, [255; 3]);
    }
    placed.sort_by(|(a, _), (b, _)| {
        let far = |row: &Row| row.change().map_or(0.0, f64::abs);
        far(b).total_cmp(&far(a))
    });
    let mut taken: Vec<[f64; 2]> = Vec::new();
    for (row, at) in placed.iter().take(NAMED) {
        // Right of its disc or left of it, where no other name stands; a line leads there.
        let length = LETTER * row.name.chars().count() as f64;
        let free = |[x, y]: &[f64; 2]| {
            let inside = *x > left && x + length < right && *y > TOP && *y < bottom;
            let apart = |t: &[f64; 2]| (t[1] - y).abs() > 13.0 || (t[0] - x).abs() > 120.0;
            inside && taken.iter().all(apart)
        };
        let beside = (0..12).flat_map(|step| {
            let down = 14.0 * f64::from(step) - 20.0;
            [[at[0] + 26.0, at[1] + down], [at[0] - 26.0 - length, at[1] + down]]
        });
        let Some(place) = beside.into_iter().find(free) else { continue };
        taken.push(place);
        let edge = if place[0] > at[0] { place[0] - 3.0 } else { place[0] + length + 3.0 };
        d.line(*at, [edge, place[1] + 4.0], 1.0, INK);
        d.text(place, 1, INK, Anchor::Start, &row.name);
    }
}

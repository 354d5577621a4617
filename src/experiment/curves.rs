//! Curves of a run as a picture: one panel for each thing that was measured.

use super::ExperimentError;
use crate::preview::{text, write_png};
use scenesplat_scene::picture::RgbPicture;
use scenesplat_trainers::callbacks::LoggedValue;
use std::collections::BTreeMap;
use std::path::Path;

/// Size of a panel, pixels.
const PANEL: [u32; 2] = [520, 320];
/// Space around the plot inside a panel: left, top, right, bottom.
const MARGIN: [u32; 4] = [78, 34, 18, 32];
const BACKGROUND: [u8; 3] = [250, 250, 248];
const FRAME: [u8; 3] = [198, 200, 204];
const INK: [u8; 3] = [52, 56, 64];
const RAW: [u8; 3] = [176, 200, 232];
const SMOOTH: [u8; 3] = [24, 92, 180];

/// One curve.
#[derive(Debug, Clone, PartialEq)]
struct Curve {
    name: String,
    /// Step and value; finite ones only.
    points: Vec<[f64; 2]>,
    /// Values that are not finite.
    bad: usize,
}

/// Draws the values of a log, panels in the order of names: training first, then evaluations, then
/// the rest. Beside each noisy curve runs a smooth one.
///
/// # Errors
/// If there is nothing to draw or the picture cannot be written.
pub fn write_curves(log: &[LoggedValue], title: &str, path: &Path) -> Result<(), ExperimentError> {
    let curves = curves(log);
    if curves.is_empty() {
        return Err(ExperimentError::EmptyLog { path: path.to_owned() });
    }
    let columns = (curves.len() as u32).min(3);
    let rows = (curves.len() as u32).div_ceil(columns);
    let mut picture = RgbPicture::filled(columns * PANEL[0], rows * PANEL[1] + 36, BACKGROUND);
    text::draw(&mut picture, 14, 10, 2, INK, title, columns * PANEL[0] - 28);
    for (i, curve) in (0..).zip(&curves) {
        let corner = [i % columns * PANEL[0], i / columns * PANEL[1] + 36];
        panel(&mut picture, corner, curve);
    }
    write_png(path, &picture)?;
    Ok(())
}

fn curves(log: &[LoggedValue]) -> Vec<Curve> {
    let mut by_name: BTreeMap<(u8, &str), Curve> = BTreeMap::new();
    for value in log {
        let kind = match value.name.split('/').next() {
            Some("train") => 0,
            Some("health" | "data") => 2,
            _ => 1,
        };
        if value.name.ends_with("seconds_per_step") {
            continue;
        }
        let curve = by_name.entry((kind, &value.name)).or_insert_with(|| Curve {
            name: value.name.clone(),
            points: Vec::new(),
            bad: 0,
        });
        if value.value.is_finite() {
            curve.points.push([value.step as f64, value.value]);
        } else {
            curve.bad += 1;
        }
    }
    by_name.into_values().filter(|c| !c.points.is_empty()).collect()
}

fn panel(picture: &mut RgbPicture, corner: [u32; 2], curve: &Curve) {
    let [left, top, right, bottom] = MARGIN;
    let (x0, y0) = (corner[0] + left, corner[1] + top);
    let (width, height) = (PANEL[0] - left - right, PANEL[1] - top - bottom);
    let last = curve.points.last().map_or(f64::NAN, |p| p[1]);
    let bad = if curve.bad > 0 { format!(", {} not finite", curve.bad) } else { String::new() };
    let heading = format!("{}  (last {}{bad})", curve.name, short(last));
    text::draw(picture, x0, corner[1] + 14, 1, INK, &heading, width);

    let steps = range(curve.points.iter().map(|p| p[0]));
    let values = range(curve.points.iter().map(|p| p[1]));
    let ticks_x = ticks(steps);
    let ticks_y = ticks(values);
    let place = |p: [f64; 2]| {
        let x = f64::from(x0) + (p[0] - steps[0]) / (steps[1] - steps[0]) * f64::from(width);
        let y = f64::from(y0 + height)
            - (p[1] - values[0]) / (values[1] - values[0]) * f64::from(height);
        [x, y]
    };
    for tick in ticks_y {
        let [_, y] = place([steps[0], tick]);
        line(picture, [f64::from(x0), y], [f64::from(x0 + width), y], FRAME, 1);
        let label = short(tick);
        let at = x0.saturating_sub(text::width(&label, 1) + 6);
        text::draw(picture, at, (y as u32).saturating_sub(4), 1, INK, &label, left);
    }
    for tick in ticks_x {
        let [x, _] = place([tick, values[0]]);
        line(picture, [x, f64::from(y0)], [x, f64::from(y0 + height)], FRAME, 1);
        let label = short(tick);
        let at = (x as u32).saturating_sub(text::width(&label, 1) / 2);
        text::draw(picture, at, y0 + height + 8, 1, INK, &label, left);
    }
    let noisy = curve.points.len() > 60;
    let (color, thick) = if noisy { (RAW, 1) } else { (SMOOTH, 2) };
    draw_curve(picture, &curve.points, place, color, thick);
    if noisy {
        draw_curve(picture, &smoothed(&curve.points), place, SMOOTH, 2);
    } else if let [only] = curve.points.as_slice() {
        let at = place(*only);
        line(picture, [at[0] - 2.0, at[1]], [at[0] + 2.0, at[1]], SMOOTH, 4);
    }
}

fn draw_curve(
    picture: &mut RgbPicture,
    points: &[[f64; 2]],
    place: impl Fn([f64; 2]) -> [f64; 2],
    color: [u8; 3],
    thick: i64,
) {
    for pair in points.windows(2) {
        line(picture, place(pair[0]), place(pair[1]), color, thick);
    }
}

/// Mean of the values within a fiftieth of the curve on both sides.
fn smoothed(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let reach = (points.len() / 50).max(2);
    let mean = |i: usize| {
        let near = &points[i.saturating_sub(reach)..(i + reach + 1).min(points.len())];
        near.iter().map(|p| p[1]).sum::<f64>() / near.len() as f64
    };
    (0..points.len()).map(|i| [points[i][0], mean(i)]).collect()
}

/// Least and largest value, apart from each other even if they are equal.
fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let room = if high > low { 0.0 } else { (low.abs() * 0.1).max(1e-6) };
    [low - room, high + room]
}

/// Three to seven round numbers inside a range.
fn ticks([low, high]: [f64; 2]) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let power = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].into_iter().find(|s| s * power >= rough).unwrap_or(10.0) * power;
    let first = (low / step).ceil() as i64;
    (first..).map(|i| i as f64 * step).take_while(|v| *v <= high).take(12).collect()
}

/// A number in few characters.
fn short(value: f64) -> String {
    let size = value.abs();
    if size != 0.0 && !(1e-3..1e5).contains(&size) {
        return format!("{value:.1e}");
    }
    let digits = if size >= 100.0 {
        0
    } else if size >= 10.0 {
        1
    } else {
        4
    };
    let text = format!("{value:.digits$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

fn line(picture: &mut RgbPicture, from: [f64; 2], to: [f64; 2], color: [u8; 3], thick: i64) {
    let length = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().max(1.0);
    for i in 0..=length as u32 {
        let part = f64::from(i) / length;
        let [x, y] = [0, 1].map(|a| (from[a] + (to[a] - from[a]) * part).round() as i64);
        for dx in 0..thick {
            for dy in 0..thick {
                if let (Ok(x), Ok(y)) = (u32::try_from(x + dx), u32::try_from(y + dy)) {
                    picture.set(x, y, color);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn logged(name: &str, values: &[f64]) -> Vec<LoggedValue> {
        let value = |(step, &value): (u64, &f64)| LoggedValue {
            step,
            epoch: 0,
            name: name.to_owned(),
            value,
        };
        (0..).zip(values).map(value).collect()
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks([0.0, 1.0]), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(ticks([3.0, 14.0]), [5.0, 10.0]);
        for range in [[1e-9, 2e-9], [-5.0, 5e8], [0.1, 0.1000001]] {
            let found = ticks(range);
            assert!((1..=7).contains(&found.len()), "{range:?} {found:?}");
        }
    }

    #[test]
    fn every_series_gets_a_panel_and_nothing_else() {
        let mut log = logged("train/loss", &[3.0, 2.0, f64::NAN, 1.0]);
        log.extend(logged("zero_shot/f-mIoU", &[0.1]));
        log.extend(logged("train/seconds_per_step", &[0.5]));
        log.extend(logged("train/nothing", &[f64::NAN]));
        let found = curves(&log);
        let names: Vec<&str> = found.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["train/loss", "zero_shot/f-mIoU"]);
        assert_eq!((found[0].points.len(), found[0].bad), (3, 1));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("curves.png");
        write_curves(&log, "a run", &path).unwrap();
        let picture = scenesplat_scene::picture::read_picture(&path).unwrap().to_rgb8();
        assert_eq!((picture.width(), picture.height()), (2 * PANEL[0], PANEL[1] + 36));
        assert!(picture.pixels().contains(&SMOOTH));
        assert!(write_curves(&log[4..4], "", &path).is_err());
    }

    #[test]
    fn equal_values_have_a_range() {
        for v in [0.0, 5.0, -1e20] {
            let [low, high] = range([v, v].into_iter());
            assert!(low < v && v < high);
        }
    }
}

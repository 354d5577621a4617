//! Curves of a run as a picture and as a page: one panel for each thing that was measured.

use super::ExperimentError;
use crate::page_kit::drawing::{Anchor, Color, Drawing};
use crate::page_kit::scale::Scale;
use crate::page_kit::{Block, Document, REPORT_STYLE, Rights};
use crate::preview::write_png;
use scenesplat_scene::AtomicFile;
use scenesplat_trainers::callbacks::LoggedValue;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

/// Size of a panel, pixels.
const PANEL: [u32; 2] = [520, 320];
/// Height of the title, pixels.
const TITLE: u32 = 36;
/// Space around the plot inside a panel: left, top, right, bottom.
const MARGIN: [f64; 4] = [78.0, 34.0, 18.0, 32.0];
const FRAME: Color = [198, 200, 204];
const INK: Color = [52, 56, 64];
const RAW: Color = [176, 200, 232];
const SMOOTH: Color = [24, 92, 180];
/// Parts of a long curve, of which the page has two points each.
const PARTS: usize = 1000;

const BODY: &str = include_str!("../../page/src/reports/curves.html");
/// The bundle; made by `npm run build` in the folder `page`.
const SCRIPT: &str = include_str!("../../page/dist/curves.js");

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
    let curves = of_log(log, path)?;
    let columns = (curves.len() as u32).min(3);
    let rows = (curves.len() as u32).div_ceil(columns);
    let mut d = Drawing::new(columns * PANEL[0], rows * PANEL[1] + TITLE);
    let title = first_letters(title, columns * PANEL[0] - 28, 2);
    d.text([14.0, 10.0], 2, INK, Anchor::Start, &title);
    for (i, curve) in (0..).zip(&curves) {
        let corner = [i % columns * PANEL[0], i / columns * PANEL[1] + TITLE];
        panel(&mut d, corner.map(f64::from), curve);
    }
    write_png(path, &d.to_picture())?;
    Ok(())
}

/// Writes the same curves as a page that shows the values below the pointer; it loads nothing. Of long curves it has
/// the least and the largest value of each of a thousand parts, and says so.
///
/// # Errors
/// If there is nothing to draw or the page cannot be written.
pub fn write_curves_page(
    log: &[LoggedValue],
    title: &str,
    path: &Path,
) -> Result<(), ExperimentError> {
    let curves: Vec<DrawnCurve> = of_log(log, path)?.iter().map(DrawnCurve::of).collect();
    let data = json!({ "title": title, "curves": curves });
    let document = Document {
        title,
        class: "",
        style: REPORT_STYLE,
        body: BODY,
        blocks: &[Block::json("data", &data)?],
        script: SCRIPT,
        rights: Rights::None,
    };
    AtomicFile::write(path, document.html().as_bytes())?;
    Ok(())
}

fn of_log(log: &[LoggedValue], path: &Path) -> Result<Vec<Curve>, ExperimentError> {
    let curves = curves(log);
    if curves.is_empty() {
        return Err(ExperimentError::EmptyLog { path: path.to_owned() });
    }
    Ok(curves)
}

/// What the page has of a curve.
#[derive(Serialize)]
struct DrawnCurve {
    name: String,
    points: Vec<[f64; 2]>,
    /// At the same steps; empty for a curve that is not noisy.
    smooth: Vec<[f64; 2]>,
    logged: usize,
    bad: usize,
    last: f64,
}

impl DrawnCurve {
    fn of(curve: &Curve) -> Self {
        let Curve { name, points, bad } = curve;
        let kept = thinned(points);
        let take = |from: &[[f64; 2]]| kept.iter().map(|&i| from[i]).collect();
        let smooth = if is_noisy(points) { take(&smoothed(points)) } else { Vec::new() };
        Self {
            name: name.clone(),
            points: take(points),
            smooth,
            logged: points.len() + bad,
            bad: *bad,
            last: points.last().map_or(0.0, |p| p[1]),
        }
    }
}

/// Places of all points, or of the lowest and highest of each of `PARTS` parts, and of the ends.
fn thinned(points: &[[f64; 2]]) -> Vec<usize> {
    if points.len() <= 2 * PARTS {
        return (0..points.len()).collect();
    }
    let mut kept = vec![0, points.len() - 1];
    for part in 0..PARTS {
        let range = part * points.len() / PARTS..(part + 1) * points.len() / PARTS;
        let by_value = |a: &usize, b: &usize| points[*a][1].total_cmp(&points[*b][1]);
        kept.extend(range.clone().min_by(by_value));
        kept.extend(range.max_by(by_value));
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// What fits into so many pixels.
fn first_letters(text: &str, pixels: u32, size: u32) -> String {
    text.chars().take((pixels / (8 * size)) as usize).collect()
}

fn is_noisy(points: &[[f64; 2]]) -> bool {
    points.len() > 60
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

fn panel(d: &mut Drawing, corner: [f64; 2], curve: &Curve) {
    let [left, top, right, bottom] = MARGIN;
    let plot = [corner[0] + left, corner[1] + top];
    let end = [corner[0] + f64::from(PANEL[0]) - right, corner[1] + f64::from(PANEL[1]) - bottom];
    let last = curve.points.last().map_or(f64::NAN, |p| p[1]);
    let bad = if curve.bad > 0 { format!(", {} not finite", curve.bad) } else { String::new() };
    let tail = format!("  (last {}{bad})", short(last));
    let room = ((end[0] - plot[0]) as u32).saturating_sub(8 * tail.chars().count() as u32);
    let heading = first_letters(&curve.name, room, 1) + &tail;
    d.text([plot[0], corner[1] + 14.0], 1, INK, Anchor::Start, &heading);

    let of = |axis: usize| curve.points.iter().map(|p| p[axis]).collect::<Vec<_>>();
    let x = Scale::over(&of(0), false, [plot[0], end[0]]);
    let y = Scale::over(&of(1), false, [end[1], plot[1]]);
    for tick in y.ticks() {
        d.line([plot[0], y.at(tick)], [end[0], y.at(tick)], 1.0, FRAME);
        d.text([plot[0] - 6.0, y.at(tick) - 4.0], 1, INK, Anchor::End, &short(tick));
    }
    for tick in x.ticks() {
        d.line([x.at(tick), plot[1]], [x.at(tick), end[1]], 1.0, FRAME);
        d.text([x.at(tick), end[1] + 8.0], 1, INK, Anchor::Middle, &short(tick));
    }
    let mut draw = |points: &[[f64; 2]], color, width| {
        for pair in points.windows(2) {
            let at = |p: [f64; 2]| [x.at(p[0]), y.at(p[1])];
            d.line(at(pair[0]), at(pair[1]), width, color);
        }
    };
    if is_noisy(&curve.points) {
        draw(&curve.points, RAW, 1.0);
        draw(&smoothed(&curve.points), SMOOTH, 2.0);
    } else if let [only] = curve.points.as_slice() {
        d.disc([x.at(only[0]), y.at(only[1])], 3.0, SMOOTH, SMOOTH);
    } else {
        draw(&curve.points, SMOOTH, 2.0);
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
        assert_eq!((picture.width(), picture.height()), (2 * PANEL[0], PANEL[1] + TITLE));
        assert!(picture.pixels().contains(&SMOOTH));
        assert!(write_curves(&log[4..4], "", &path).is_err());
    }

    #[test]
    fn the_page_has_what_the_picture_has_and_says_what_it_leaves_out() {
        let noisy: Vec<f64> = (0..5000).map(|i| f64::from(i % 7) + 0.001 * f64::from(i)).collect();
        let mut log = logged("train/</script><script>attacked", &noisy);
        log.extend(logged("eval/mIoU", &[0.25, f64::INFINITY]));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("curves.html");
        write_curves_page(&log, "<b>run</b>", &path).unwrap();
        let page = std::fs::read_to_string(&path).unwrap();
        crate::page_kit::is_closed(&page, 2);
        assert!(page.contains("<title>&lt;b&gt;run"));
        let begin = page.find("id=\"data\">").unwrap() + 10;
        let end = begin + page[begin..].find("</script>").unwrap();
        let data: serde_json::Value = serde_json::from_str(&page[begin..end]).unwrap();
        let [long, short] = [0, 1].map(|i| &data["curves"][i]);
        let points = long["points"].as_array().unwrap();
        assert!(points.len() <= 2 * PARTS + 2 && points.len() > PARTS, "{}", points.len());
        assert_eq!((long["logged"].as_u64(), long["bad"].as_u64()), (Some(5000), Some(0)));
        assert_eq!(long["smooth"].as_array().unwrap().len(), points.len());
        // The ends and the extremes are there.
        assert_eq!(
            (points[0][0].as_f64(), points[points.len() - 1][0].as_f64()),
            (Some(0.0), Some(4999.0))
        );
        let most = points.iter().filter_map(|p| p[1].as_f64()).fold(0.0, f64::max);
        assert_eq!(most, noisy.iter().copied().fold(0.0, f64::max));
        assert_eq!(short["points"], json!([[0.0, 0.25]]));
        assert_eq!((short["bad"].as_u64(), short["last"].as_f64()), (Some(1), Some(0.25)));
        assert_eq!(short["smooth"], json!([]));
        assert!(write_curves_page(&[], "", &path).is_err());
    }
}

//! Curves as shapes of one picture.

use super::shown::{Curve, Shown};
use crate::page_kit::drawing::{Anchor, Color, Drawing};
use crate::page_kit::scale::{Scale, labels};

/// Width of the picture, pixels.
const WIDTH: u32 = 1560;
/// Height of the large panels, of which one or two fill the width.
const LARGE: u32 = 560;
/// Panels beside each other, and their height.
const SMALL: (u32, u32) = (3, 320);
/// Height of the title, pixels.
const TITLE: u32 = 36;
/// Space around the plot inside a panel: left at least, top, right, bottom.
const MARGIN: [f64; 4] = [78.0, 50.0, 18.0, 32.0];
/// Edge beside texts, and height of a line of them.
const EDGE: u32 = 14;
const LINE: u32 = 18;
/// The most lines for curves without a panel of one kind: below panels, and where there are none.
const LINES: [usize; 2] = [4, 20];
const FRAME: Color = [198, 200, 204];
const INK: Color = [52, 56, 64];
const RAW: Color = [176, 200, 232];
const SMOOTH: Color = [24, 92, 180];

/// Panels in their order, and below them the last values of what has none.
pub(super) fn drawn(shown: &Shown, title: &str) -> Drawing {
    let (panels, base) = panels(shown);
    let most = LINES[usize::from(panels.is_empty())];
    let mut lines = left_out(shown, ((WIDTH - 2 * EDGE) / 8) as usize, most);
    if panels.is_empty() {
        lines.insert(0, "Nothing changes from step to step; the last values:".to_owned());
    }
    let height = if lines.is_empty() { base } else { base + LINE * (lines.len() as u32 + 1) };
    let mut d = Drawing::new(WIDTH, height);
    let title = first_letters(title, WIDTH - 2 * EDGE, 2);
    d.text([f64::from(EDGE), 10.0], 2, INK, Anchor::Start, &title);
    for (at, curve) in panels.into_iter().zip(&shown.curves) {
        panel(&mut d, at.map(f64::from), curve);
    }
    for (i, line) in (0..).zip(&lines) {
        let at = [EDGE, base + LINE / 2 + LINE * i].map(f64::from);
        d.text(at, 1, INK, Anchor::Start, line);
    }
    d
}

/// Left, top, width and height of the panels, and where they end.
fn panels(shown: &Shown) -> (Vec<[u32; 4]>, u32) {
    let large = shown.large as u32;
    let small = shown.curves.len() as u32 - large;
    let top = TITLE + if large > 0 { LARGE } else { 0 };
    let (columns, height) = SMALL;
    let wide = WIDTH / columns;
    let first = (0..large).map(|i| [i * WIDTH / large, TITLE, WIDTH / large, LARGE]);
    let rest = (0..small).map(|i| [i % columns * wide, top + i / columns * height, wide, height]);
    (first.chain(rest).collect(), top + small.div_ceil(columns) * height)
}

/// Curves without a panel, for each reason at most so many lines of so many letters.
fn left_out(shown: &Shown, letters: usize, most: usize) -> Vec<String> {
    let mut lines = Vec::new();
    for group in shown.left_out.chunk_by(|a, b| a.0 == b.0) {
        let (reason, _) = group[0];
        let mut line = format!("{}:", reason.name());
        let end = lines.len() + most;
        for (i, (_, curve)) in group.iter().enumerate() {
            let more = if i + 1 < group.len() { "," } else { "" };
            let said = format!(" {}{more}", entry(curve));
            // Room for the number of the others.
            if line.chars().count() + said.chars().count() + 16 > letters {
                if lines.len() + 1 == end {
                    line += &format!(" and {} more", group.len() - i);
                    break;
                }
                lines.push(std::mem::replace(&mut line, "   ".to_owned()));
            }
            line += &said;
        }
        lines.push(line);
    }
    lines
}

fn entry(curve: &Curve) -> String {
    let name = first_letters(&curve.name, 60 * 8, 1);
    match (curve.last(), curve.bad) {
        (Some(last), 0) => format!("{name} {}", short(last, digits(curve))),
        (Some(last), bad) => format!("{name} {} ({bad} not finite)", short(last, digits(curve))),
        (None, bad) => format!("{name} ({bad})"),
    }
}

/// What fits into so many pixels.
fn first_letters(text: &str, pixels: u32, size: u32) -> String {
    text.chars().take((pixels / (8 * size)) as usize).collect()
}

fn panel(d: &mut Drawing, [left, top, width, height]: [f64; 4], curve: &Curve) {
    let of = |axis: usize| curve.points.iter().map(|p| p[axis]).collect::<Vec<_>>();
    let end = [left + width - MARGIN[2], top + height - MARGIN[3]];
    let y = Scale::over(&of(1), false, [end[1], top + MARGIN[1]]);
    let marks = y.ticks();
    let texts = labels(&marks);
    let widest = texts.iter().map(String::len).max().unwrap_or(0);
    let plot = [left + MARGIN[0].max(8.0 * widest as f64 + 14.0), top + MARGIN[1]];
    let x = Scale::over(&of(0), false, [plot[0], end[0]]);
    for (tick, text) in marks.into_iter().zip(&texts) {
        d.line([plot[0], y.at(tick)], [end[0], y.at(tick)], 1.0, FRAME);
        d.text([plot[0] - 6.0, y.at(tick) - 4.0], 1, INK, Anchor::End, text);
    }
    steps(d, &x, [plot[1], end[1]]);

    heading(d, [plot[0], top + 14.0], end[0], curve);
    let mut draw = |points: &[[f64; 2]], color, width| {
        for pair in points.windows(2) {
            let at = |p: [f64; 2]| [x.at(p[0]), y.at(p[1])];
            d.line(at(pair[0]), at(pair[1]), width, color);
        }
    };
    if let Some(smooth) = curve.smooth() {
        draw(&curve.points, RAW, 1.0);
        draw(&smooth, SMOOTH, 2.0);
        legend(d, [end[0], top + 32.0]);
    } else {
        draw(&curve.points, SMOOTH, 2.0);
    }
}

/// Lines over the height, and below them as many of their texts as stand apart.
fn steps(d: &mut Drawing, x: &Scale, [top, base]: [f64; 2]) {
    let ticks = x.ticks();
    let texts = labels(&ticks);
    let widest = texts.iter().map(String::len).max().unwrap_or(0);
    let apart = ticks.get(..2).map_or(f64::INFINITY, |two| x.at(two[1]) - x.at(two[0]));
    let every = (8.0 * (widest as f64 + 1.0) / apart).ceil().max(1.0) as usize;
    for (i, (tick, text)) in ticks.into_iter().zip(&texts).enumerate() {
        d.line([x.at(tick), top], [x.at(tick), base], 1.0, FRAME);
        if i.is_multiple_of(every) {
            d.text([x.at(tick), base + 8.0], 1, INK, Anchor::Middle, text);
        }
    }
}

/// Name and last value of a curve.
fn heading(d: &mut Drawing, at: [f64; 2], end: f64, curve: &Curve) {
    let bad = if curve.bad > 0 { format!(", {} not finite", curve.bad) } else { String::new() };
    let tail = curve
        .last()
        .map_or(String::new(), |last| format!("  (last {}{bad})", short(last, digits(curve))));
    let room = ((end - at[0]) as u32).saturating_sub(8 * tail.chars().count() as u32);
    d.text(at, 1, INK, Anchor::Start, &(first_letters(&curve.name, room, 1) + &tail));
}

/// Which line is which, up to a right end.
fn legend(d: &mut Drawing, [mut x, y]: [f64; 2]) {
    for (name, color) in [("mean", SMOOTH), ("single values", RAW)] {
        x -= 8.0 * name.len() as f64;
        d.text([x, y], 1, INK, Anchor::Start, name);
        d.line([x - 24.0, y + 4.0], [x - 6.0, y + 4.0], 2.0, color);
        x -= 40.0;
    }
}

/// Five digits, or as many as tell a thousandth of the curve's range.
fn digits(curve: &Curve) -> usize {
    let values = || curve.points.iter().map(|point| point[1]);
    let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
    if high <= low {
        return 5;
    }
    let size = low.abs().max(high.abs());
    ((size / (high - low)).log10().ceil().max(0.0) as usize + 3).clamp(5, 15)
}

/// A number of so many digits; a count as it is.
fn short(value: f64, digits: usize) -> String {
    let size = value.abs();
    if value.fract() == 0.0 && size < 1e9 {
        return format!("{value:.0}");
    }
    if !(1e-3..1e9).contains(&size) {
        return format!("{value:.*e}", digits - 1);
    }
    let places = (digits as f64 - 1.0 - size.log10().floor()).max(0.0) as usize;
    let text = format!("{value:.places$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::shown::tests::{logged, of_everything};
    use super::*;

    /// What is written in a picture, from its SVG: place, anchor and text.
    fn written(d: &Drawing) -> Vec<(f64, f64, String, String)> {
        let svg = d.to_svg();
        let value = |line: &str, name: &str| {
            let begin = line.split_once(&format!(" {name}=\"")).unwrap().1;
            begin.split_once('"').unwrap().0.to_owned()
        };
        let text = |line: &str| {
            let place = |name| value(line, name).parse::<f64>().unwrap();
            let words = line.split_once('>').unwrap().1.trim_end_matches("</text>").to_owned();
            (place("x"), place("y"), value(line, "text-anchor"), words)
        };
        svg.lines().filter(|line| line.starts_with("<text")).map(text).collect()
    }

    /// Names of panels, in the order in which they are drawn.
    pub(crate) fn headings(d: &Drawing) -> Vec<String> {
        let name = |(_, _, _, text): (_, _, _, String)| Some(text.split_once("  (last ")?.0.into());
        written(d).into_iter().filter_map(name).collect()
    }

    #[test]
    fn two_large_panels_are_above_three_in_a_row() {
        let shown = Shown::of(&of_everything(), None);
        let (places, base) = panels(&shown);
        let [half, third, row] = [WIDTH / 2, WIDTH / 3, TITLE + LARGE];
        assert_eq!(places[..2], [[0, TITLE, half, LARGE], [half, TITLE, half, LARGE]]);
        assert_eq!(places[2..4], [[0, row, third, 320], [third, row, third, 320]]);
        assert_eq!((places[5], base), ([0, row + 320, third, 320], row + 640));
        // One alone has the width.
        let loss = Shown::of(&logged("train/loss", &[2.0, 1.0]), None);
        assert_eq!(panels(&loss), (vec![[0, TITLE, WIDTH, LARGE]], row));
        let picture = drawn(&loss, "").to_picture();
        assert_eq!((picture.width(), picture.height()), (WIDTH, row));
        assert!(picture.pixels().contains(&SMOOTH) && !picture.pixels().contains(&RAW));
    }

    #[test]
    fn what_has_no_panel_is_written_below() {
        let shown = Shown::of(&of_everything(), None);
        let d = drawn(&shown, "a run");
        let below: Vec<_> = written(&d).into_iter().rev().take(4).map(|(_, _, _, t)| t).collect();
        assert_eq!(
            below,
            [
                "not finite: train/bad (2)",
                "oracle: unseen/oracle/f-mIoU 0.3",
                "one value: seen/once 0.31",
                "constant: train/counted_rows 400, seen/zero 0 (1 not finite)",
            ]
        );
        let end = d.to_picture().height();
        assert!(written(&d).iter().all(|(_, y, _, _)| *y < f64::from(end)));
        // Too many are counted, and lines are not wider than the picture.
        let many: Vec<_> =
            (0..300).flat_map(|i| logged(&format!("a/{}{i}", "long".repeat(i)), &[0.5])).collect();
        let shown = Shown::of(&many, None);
        let lines = left_out(&shown, 100, 4);
        assert_eq!(lines.len(), 4);
        assert!(lines.iter().all(|line| line.chars().count() <= 100), "{lines:#?}");
        let named = lines.join("").matches("0.5").count();
        assert!(named > 3 && lines[3].ends_with(&format!("and {} more", 300 - named)));
        // A log of nothing else says so and shows the values.
        let d = drawn(&shown, "a run");
        assert!(headings(&d).is_empty());
        assert!(
            written(&d).iter().any(|(_, _, _, t)| t.starts_with("one value: a/0 0.5, a/long1"))
        );
    }

    #[test]
    fn a_noisy_curve_has_both_lines_and_says_which_is_which() {
        let values: Vec<f64> = (0..100).map(|i| f64::from(i % 7)).collect();
        let name = "train/".to_owned() + &"long".repeat(80);
        let d = drawn(&Shown::of(&logged(&name, &values), None), "");
        // More of both than in the legend.
        let picture = d.to_picture();
        for color in [RAW, SMOOTH] {
            assert!(picture.pixels().iter().filter(|pixel| **pixel == color).count() > 100);
        }
        let found = written(&d);
        let at = |text: &str| found.iter().find(|t| t.3 == text).unwrap();
        let heading = found.iter().find(|t| t.3.contains("(last")).unwrap();
        // Below the name, above the plot, inside the panel.
        let end = f64::from(WIDTH / 3);
        assert!(heading.0 + 8.0 * heading.3.len() as f64 <= end - MARGIN[2]);
        for text in ["single values", "mean"] {
            let (x, y, ..) = *at(text);
            assert!(x > heading.0 && x + 8.0 * text.len() as f64 <= end - MARGIN[2], "{text} {x}");
            assert!(y >= heading.1 + 10.0 && y < f64::from(TITLE) + MARGIN[1], "{text} {y}");
        }
        assert!(heading.3.ends_with("(last 1)"), "{}", heading.3);
        let few = drawn(&Shown::of(&logged(&name, &values[..50]), None), "");
        assert!(!written(&few).iter().any(|t| t.3 == "mean"));
    }

    #[test]
    fn neighboring_ticks_of_a_panel_differ_and_stand_apart() {
        for values in [[0.99998, 1.00002], [1e6, 1e6 + 1.0], [-1e6 - 1.0, -1e6], [-0.2, 0.2]] {
            let mut log = logged("a/x", &values);
            log[1].step = 1_370_000;
            let mut d = Drawing::new(WIDTH, LARGE);
            panel(&mut d, [0.0, 0.0, 520.0, 320.0], &Shown::of(&log, None).curves[0]);
            let texts = written(&d);
            let of = |anchor| texts.iter().filter(|t| t.2 == anchor).collect::<Vec<_>>();
            let (side, below) = (of("end"), of("middle"));
            assert!(side.len() >= 4 && below.len() >= 3, "{texts:?}");
            for two in side.windows(2).chain(below.windows(2)) {
                assert_ne!(two[0].3, two[1].3, "{values:?}: {texts:?}");
            }
            assert!(side.iter().all(|t| t.0 >= 8.0 * t.3.len() as f64), "{texts:?}");
            for two in below.windows(2) {
                let wide = 4.0 * (two[0].3.len() + two[1].3.len()) as f64;
                assert!(two[1].0 - two[0].0 > wide, "{texts:?}");
            }
        }
    }

    #[test]
    fn numbers_are_short() {
        let found = [0.0, 1.0, -3.0, 123_456.0, 0.31, 0.99998, 12.345_678, 2.5e-7, 1.5e12];
        let texts =
            ["0", "1", "-3", "123456", "0.31", "0.99998", "12.346", "2.5000e-7", "1.5000e12"];
        assert_eq!(found.map(|value| short(value, 5)), texts);
        // Where a curve hardly changes, what changes is seen.
        let last = |values: &[f64]| {
            let shown = Shown::of(&logged("a/x", values), None);
            entry(shown.curves.first().unwrap_or_else(|| &shown.left_out[0].1))
        };
        assert_eq!(last(&[1.0, 1.000_010_1, 1.000_005_4]), "a/x 1.0000054");
        assert_eq!(last(&[1e6, 1e6 + 1.0, 1e6 + 0.25]), "a/x 1000000.25");
        assert_eq!(last(&[0.123_456_789; 2]), "a/x 0.12346");
    }
}

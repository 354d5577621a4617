//! The picture of a front: time against quality, and quality against training time.

use super::point::Point;
use super::summary::{Summary, place};
use super::training::TrainingCurve;
use crate::charts::{INK, SOFT, axes, curve};
use scenesplat::page_kit::drawing::{Anchor, Color, Drawing};
use scenesplat::page_kit::scale::Scale;

const FRONT: Color = [20, 98, 190];
const KNEE: Color = [226, 106, 20];
const BEATEN: Color = [186, 189, 194];
const BEATEN_FILL: Color = [222, 224, 227];
const CEILING: Color = [34, 140, 80];
const CHANCE: Color = [190, 60, 60];
const CURVES: [Color; 6] =
    [[20, 98, 190], [226, 106, 20], [34, 140, 80], [160, 70, 170], [190, 60, 60], [90, 100, 110]];

const SIZE: [u32; 2] = [1600, 900];
/// Left, top, right and bottom of the plot.
const PLOT: [f64; 4] = [110.0, 90.0, 1010.0, 810.0];
/// Left edge of the list of settings.
const LIST: f64 = 1045.0;

/// Draws the front with all that was measured; below it, the training curves if there are any.
pub(crate) fn chart(summary: &Summary) -> Drawing {
    if summary.points.is_empty() {
        return training_chart(&summary.training);
    }
    let mut drawing = front_chart(summary);
    if !summary.training.is_empty() {
        drawing.append(training_chart(&summary.training));
    }
    drawing
}

fn front_chart(summary: &Summary) -> Drawing {
    let mut d = Drawing::new(SIZE[0], SIZE[1]);
    let scenes = if summary.num_scenes == 1 { "scene" } else { "scenes" };
    let title =
        format!("What accuracy costs: f-mIoU against seconds, {} {scenes}", summary.num_scenes);
    d.text([PLOT[0], 22.0], 3, INK, Anchor::Start, &title);
    let machine = summary.machine.to_string();
    d.text([PLOT[0], 58.0], 1, SOFT, Anchor::Start, &machine);
    let all: Vec<&Point> = summary.all().collect();
    let times: Vec<f64> =
        all.iter().flat_map(|p| [p.seconds_low, p.seconds_p50, p.seconds_high]).collect();
    let mut worths: Vec<f64> =
        all.iter().flat_map(|p| [p.f_miou, p.f_miou_low, p.f_miou_high]).flatten().collect();
    let ceiling = summary.oracle.as_ref().and_then(|p| p.f_miou);
    let chance = summary.random_labels.as_ref().and_then(|p| p.f_miou);
    worths.extend(ceiling.into_iter().chain(chance));
    let plot = Plot {
        x: Scale::over(&times, true, [PLOT[0], PLOT[2]]),
        y: Scale::over(&worths, false, [PLOT[3], PLOT[1]]),
    };
    plot.axes(&mut d, PLOT, "seconds a scene (median)", seconds_text);
    for (value, name, color) in [(ceiling, "oracle", CEILING), (chance, "random labels", CHANCE)] {
        let Some(at) = value.map(|value| plot.y.at(value)) else { continue };
        d.dashes([PLOT[0], at], [PLOT[2], at], color);
        d.text([PLOT[2] - 6.0, at - 22.0], 2, color, Anchor::End, name);
    }
    plot.points(&mut d, summary);
    list(&mut d, summary);
    d
}

/// Cost across, worth upwards.
struct Plot {
    x: Scale,
    y: Scale,
}

impl Plot {
    fn axes(&self, d: &mut Drawing, plot: [f64; 4], name: &str, text: fn(f64) -> String) {
        axes(d, [&self.x, &self.y], plot, [12.0, 10.0], (text, percent));
        d.text([(plot[0] + plot[2]) / 2.0, plot[3] + 42.0], 2, INK, Anchor::Middle, name);
    }

    fn at(&self, [cost, worth]: [f64; 2]) -> [f64; 2] {
        [self.x.at(cost), self.y.at(worth)]
    }

    fn bars(&self, d: &mut Drawing, p: &Point, color: Color) {
        let [px, py] = self.at(place(p));
        d.line([self.x.at(p.seconds_low), py], [self.x.at(p.seconds_high), py], 1.5, color);
        if let (Some(low), Some(high)) = (p.f_miou_low, p.f_miou_high) {
            d.line([px, self.y.at(low)], [px, self.y.at(high)], 1.5, color);
        }
    }

    /// The beaten ones, and the front with its numbers over them.
    fn points(&self, d: &mut Drawing, summary: &Summary) {
        let beaten = || summary.dominated.iter().filter(|p| p.f_miou.is_some());
        beaten().for_each(|p| self.bars(d, p, BEATEN_FILL));
        beaten().for_each(|p| d.disc(self.at(place(p)), 5.0, BEATEN_FILL, BEATEN));
        for pair in summary.points.windows(2) {
            let ([x0, y0], [x1, y1]) = (self.at(place(&pair[0])), self.at(place(&pair[1])));
            d.line([x0, y0], [x1, y0], 2.0, FRONT);
            d.line([x1, y0], [x1, y1], 2.0, FRONT);
        }
        summary.points.iter().for_each(|p| self.bars(d, p, [130, 170, 220]));
        let mut last = f64::NEG_INFINITY;
        for (i, p) in summary.points.iter().enumerate() {
            let (radius, color) = if is_knee(summary, p) { (9.0, KNEE) } else { (7.0, FRONT) };
            let [px, py] = self.at(place(p));
            d.disc([px, py], radius, color, [255; 3]);
            // A number that would stand on the one before goes below.
            let below = px - last < 34.0;
            let (side, up, anchor) =
                if below { (12.0, 12.0, Anchor::Start) } else { (-12.0, -28.0, Anchor::End) };
            d.text([px + side, py + up], 2, color, anchor, &format!("{}", i + 1));
            last = px;
        }
    }
}

fn is_knee(summary: &Summary, p: &Point) -> bool {
    summary.knee.as_deref() == Some(&p.setting)
}

/// The front's settings by number, then the classes.
fn list(d: &mut Drawing, summary: &Summary) {
    let mut y = 90.0;
    let shared = shared_parts(summary);
    d.text([LIST, y], 2, INK, Anchor::Start, "the front");
    y += 28.0;
    const MOST: usize = 11;
    for (i, p) in summary.points.iter().enumerate().take(MOST) {
        let (color, mark) = if is_knee(summary, p) { (KNEE, " knee") } else { (FRONT, "") };
        let quality = 100.0 * p.f_miou.unwrap_or(f64::NAN);
        let text = format!("{:2} {} {quality:.1} %{mark}", i + 1, seconds_text(p.seconds_p50));
        d.text([LIST, y], 2, color, Anchor::Start, &text);
        let own: Vec<&str> = p.setting.split(',').filter(|part| !shared.contains(part)).collect();
        d.text([LIST + 48.0, y + 21.0], 1, SOFT, Anchor::Start, &own.join(","));
        y += 40.0;
    }
    if summary.points.len() > MOST {
        let text = format!("and {} more", summary.points.len() - MOST);
        d.text([LIST + 48.0, y], 2, SOFT, Anchor::Start, &text);
        y += 28.0;
    }
    if !shared.is_empty() {
        d.text([LIST, y], 1, SOFT, Anchor::Start, &format!("all: {}", shared.join(",")));
    }
    y += 28.0;
    d.text([LIST, y], 2, INK, Anchor::Start, "cheapest of each class");
    y += 28.0;
    for class in &summary.classes {
        let head = format!(">= {:.1} %", 100.0 * class.share);
        let text = match class.seconds_p50 {
            Some(seconds) => format!("{head}: {}", seconds_text(seconds)),
            None => format!("{head}: none"),
        };
        d.text([LIST, y], 2, INK, Anchor::Start, &text);
        let setting = class.setting.as_deref().unwrap_or_default();
        let own: Vec<&str> = setting.split(',').filter(|part| !shared.contains(part)).collect();
        d.text([LIST + 48.0, y + 21.0], 1, SOFT, Anchor::Start, &own.join(","));
        y += 40.0;
    }
    let bottom = f64::from(SIZE[1]);
    d.disc([LIST + 6.0, bottom - 56.0], 5.0, BEATEN_FILL, BEATEN);
    d.text([LIST + 20.0, bottom - 60.0], 1, SOFT, Anchor::Start, "beaten by one of the front");
    let bars = "bars: spread of repeats; 95 % over scenes";
    d.text([LIST, bottom - 36.0], 1, SOFT, Anchor::Start, bars);
}

/// Parts that all measured settings share.
fn shared_parts(summary: &Summary) -> Vec<&str> {
    let mut all = summary.all();
    let Some(first) = all.next() else { return Vec::new() };
    let rest: Vec<&Point> = all.collect();
    let has = |p: &Point, part: &str| p.setting.split(',').any(|own| own == part);
    first.setting.split(',').filter(|part| rest.iter().all(|p| has(p, part))).collect()
}

fn training_chart(curves: &[TrainingCurve]) -> Drawing {
    let mut d = Drawing::new(SIZE[0], 620);
    let [left, top, right, bottom] = [PLOT[0], 70.0, PLOT[2], 540.0];
    let title = "What training costs: quality against seconds of training";
    d.text([left, 22.0], 2, INK, Anchor::Start, title);
    let of =
        |i: usize| curves.iter().flat_map(|c| c.points.iter()).map(|p| p[i]).collect::<Vec<_>>();
    let plot = Plot {
        x: Scale::over(&of(0), true, [left, right]),
        y: Scale::over(&of(1), false, [bottom, top]),
    };
    let seconds = |seconds: f64| format!("{seconds:.0}");
    plot.axes(&mut d, [left, top, right, bottom], "seconds of training", seconds);
    for (i, of_training) in curves.iter().enumerate() {
        let color = CURVES[i % CURVES.len()];
        curve(&mut d, of_training.points.iter().map(|p| plot.at(*p)), 2.0, color);
        let top = top + 52.0 * i as f64;
        d.text([LIST, top], 2, color, Anchor::Start, &of_training.name);
        let (best, until) = (100.0 * of_training.best, seconds_text(of_training.seconds_to_99));
        let text = format!("{}: best {best:.1} %, 99 % of it after {until}", of_training.metric);
        d.text([LIST, top + 22.0], 1, SOFT, Anchor::Start, &text);
    }
    d
}

fn percent(value: f64) -> String {
    let percent = 100.0 * value;
    if (percent - percent.round()).abs() < 1e-6 {
        format!("{percent:.0} %")
    } else {
        format!("{percent:.1} %")
    }
}

/// Seconds as people say them.
pub fn seconds_text(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() => "-".to_owned(),
        s if s < 0.001 => format!("{:.0} us", 1e6 * s),
        s if s < 0.0995 => format!("{} ms", significant(1e3 * s)),
        s if s < 120.0 => format!("{} s", significant(s)),
        s if s < 7200.0 => format!("{} min", significant(s / 60.0)),
        s => format!("{} h", significant(s / 3600.0)),
    }
}

/// Three digits at most, without zeros at the end.
fn significant(value: f64) -> String {
    let digits = match value {
        v if v < 10.0 => 2,
        v if v < 100.0 => 1,
        _ => 0,
    };
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod by_hand;
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_said_as_people_say_them() {
        let texts = [0.0000123, 0.01234, 0.5, 1.0, 12.34, 119.0, 600.0, 50_000.0].map(seconds_text);
        assert_eq!(
            texts,
            ["12 us", "12.3 ms", "0.5 s", "1 s", "12.3 s", "119 s", "10 min", "13.9 h"]
        );
        assert_eq!((percent(0.25), percent(0.125)), ("25 %".to_owned(), "12.5 %".to_owned()));
    }
}

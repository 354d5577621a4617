//! The curves as a picture: one panel for each figure, one line for each effect.

use super::SeverityError;
use super::report::{SeverityPoint, SeverityReport};
use crate::charts::{INK, axes, curve};
use scenesplat::page_kit::drawing::{Anchor, Color, Drawing};
use scenesplat::page_kit::scale::Scale;
use scenesplat_scene::AtomicFile;
use std::path::{Path, PathBuf};

const CURVES: [Color; 8] = [
    [20, 98, 190],
    [226, 106, 20],
    [34, 140, 80],
    [160, 70, 170],
    [190, 60, 60],
    [90, 100, 110],
    [180, 150, 20],
    [20, 160, 170],
];
const SIZE: [u32; 2] = [1500, 1060];
/// Left and top edge of the first panel, and from one panel to the next.
const FIRST: [f64; 2] = [90.0, 110.0];
const NEXT: [f64; 2] = [640.0, 470.0];
const PANEL: [f64; 2] = [540.0, 370.0];
const LEGEND: f64 = 1300.0;

impl SeverityReport {
    /// Writes `severity.json`, `severity.svg` and `severity.png`. Gives their paths and sizes.
    ///
    /// # Errors
    /// If one cannot be written.
    pub fn write(&self, folder: &Path) -> Result<Vec<(PathBuf, u64)>, SeverityError> {
        std::fs::create_dir_all(folder)?;
        let paths = ["severity.json", "severity.svg", "severity.png"].map(|n| folder.join(n));
        let json = serde_json::to_string_pretty(self)? + "\n";
        AtomicFile::write(&paths[0], json.as_bytes())?;
        let [svg, png] = chart(self).write(&paths[1], &paths[2])?;
        Ok(paths.into_iter().zip([json.len() as u64, svg, png]).collect())
    }
}

type Figure = fn(&SeverityPoint) -> f64;

fn chart(report: &SeverityReport) -> Drawing {
    let mut d = Drawing::new(SIZE[0], SIZE[1]);
    let title = format!(
        "Labels of {} unseen rooms of {} Gaussians against the severity of each effect",
        report.rooms, report.gaussians
    );
    d.text([FIRST[0], 24.0], 2, INK, Anchor::Start, &title);
    let figures: [(&str, Figure); 4] = [
        ("f-mIoU", |p| p.f_miou),
        ("calibration error (ECE)", |p| p.ece),
        ("mean confidence", |p| p.confidence),
        ("unknown (less certain than 95 % of undamaged)", |p| p.unknown),
    ];
    for (i, (name, figure)) in figures.into_iter().enumerate() {
        let left = FIRST[0] + NEXT[0] * (i % 2) as f64;
        let top = FIRST[1] + NEXT[1] * (i / 2) as f64;
        panel(&mut d, report, [left, top], name, figure);
    }
    for (i, curve) in report.curves.iter().enumerate() {
        let at = [LEGEND, FIRST[1] + 30.0 * i as f64];
        let color = CURVES[i % CURVES.len()];
        d.disc([at[0] + 6.0, at[1] + 8.0], 6.0, color, [255; 3]);
        d.text([at[0] + 24.0, at[1]], 2, color, Anchor::Start, &curve.effect);
    }
    d
}

fn panel(d: &mut Drawing, report: &SeverityReport, [left, top]: [f64; 2], name: &str, of: Figure) {
    let [right, bottom] = [left + PANEL[0], top + PANEL[1]];
    let points = || report.curves.iter().flat_map(|curve| &curve.points);
    let x = Scale::over(&points().map(|p| p.severity).collect::<Vec<_>>(), false, [left, right]);
    let y = Scale::over(&points().map(of).collect::<Vec<_>>(), false, [bottom, top]);
    // Steps below one percent need their decimals.
    let step = y.ticks().windows(2).map(|pair| pair[1] - pair[0]).fold(1.0, f64::min);
    let digits = usize::from(step < 0.0099) + usize::from(step < 0.00099);
    let percent = |tick: f64| format!("{:.digits$}%", 100.0 * tick);
    let texts = (|tick: f64| format!("{tick}"), percent);
    axes(d, [&x, &y], [left, top, right, bottom], [10.0, 8.0], texts);
    d.text([left, top - 28.0], 2, INK, Anchor::Start, name);
    for (i, of_effect) in report.curves.iter().enumerate() {
        let at = |p: &SeverityPoint| [x.at(p.severity), y.at(of(p))];
        curve(d, of_effect.points.iter().map(at), 2.5, CURVES[i % CURVES.len()]);
    }
}

//! The curves as numbers, with what is expected of them.

use super::chart::chart;
use super::measure::Bench;
use super::{CurveSettings, SeverityError};
use scenesplat_metrics::rank_correlation;
use scenesplat_scene::AtomicFile;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};

/// What quality may fall by from one severity to the next, as a share: 10 points.
const LARGEST_STEP: f64 = 0.1;
/// Least rank correlation of confidence and quality.
const LEAST_CORRELATION: f64 = 0.7;
/// What of the labels far away may change when a corner is damaged.
const FAR_CHANGED: f64 = 0.01;

/// All rooms at one severity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeverityPoint {
    /// 0 to 5.
    pub severity: f64,
    /// Mean intersection over union of the classes but for wall, floor and ceiling, 0..=1.
    pub f_miou: f64,
    /// Expected calibration error of the labels' probabilities, 0..=1.
    pub ece: f64,
    /// Their mean.
    pub confidence: f64,
    /// Share of the Gaussians whose likeliest class, by their own feature, is less probable than that of all but
    /// 5 % in undamaged rooms.
    pub unknown: f64,
    /// Gaussians with a true label.
    pub scored: usize,
}

/// The curve of an effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EffectCurve {
    /// Its name.
    pub effect: String,
    /// From the undamaged rooms on.
    pub points: Vec<SeverityPoint>,
    /// Share of the labels farther than 1.5 m from a corner of 1 m that change when the effect is at its
    /// worst in that corner alone.
    pub far_changed: f64,
}

/// Something that is expected of a curve.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// Of which effect; `all` of all points together.
    pub effect: String,
    /// What.
    pub what: String,
    /// What was found; `None` where it has no meaning, as the correlation with a constant.
    pub value: Option<f64>,
    /// What it is compared with.
    pub bound: f64,
    /// Whether it is within.
    pub passed: bool,
}

/// The curves of all effects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeverityReport {
    /// How many rooms.
    pub rooms: usize,
    /// Gaussians of each.
    pub gaussians: usize,
    /// Seed of the rooms.
    pub room_seed: u64,
    /// Seed of the damage.
    pub seed: u64,
    /// Probability of the likeliest class below which a Gaussian counts as unknown.
    pub unknown_below: f32,
    /// One for each effect.
    pub curves: Vec<EffectCurve>,
    /// What is expected of them.
    pub checks: Vec<Check>,
    /// How long it took.
    pub seconds: f64,
}

impl SeverityReport {
    pub(super) fn new(
        settings: &CurveSettings,
        bench: &Bench,
        curves: Vec<EffectCurve>,
        seconds: f64,
    ) -> Self {
        Self {
            rooms: settings.rooms,
            gaussians: settings.gaussians,
            room_seed: settings.room_seed,
            seed: settings.seed,
            unknown_below: bench.threshold,
            checks: checks(&curves),
            curves,
            seconds,
        }
    }

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

pub(super) fn checks(curves: &[EffectCurve]) -> Vec<Check> {
    let check = |effect: &str, what: &str, value: Option<f64>, bound: f64, least: bool| Check {
        effect: effect.to_owned(),
        what: what.to_owned(),
        value,
        bound,
        passed: value.is_none_or(|v| if least { v >= bound } else { v <= bound }),
    };
    let mut all = Vec::new();
    for EffectCurve { effect, points, far_changed } in curves {
        let steps = points.windows(2).map(|pair| pair[0].f_miou - pair[1].f_miou);
        let step = steps.fold(0.0, f64::max);
        all.push(check(effect, "largest fall of f-mIoU", Some(step), LARGEST_STEP, false));
        let correlation = correlation_of(points);
        let what = "rank correlation of confidence and f-mIoU";
        all.push(check(effect, what, correlation, LEAST_CORRELATION, true));
        let what = "labels far away that change";
        all.push(check(effect, what, Some(*far_changed), FAR_CHANGED, false));
    }
    let points: Vec<SeverityPoint> = curves.iter().flat_map(|curve| curve.points.clone()).collect();
    let what = "rank correlation of confidence and f-mIoU";
    all.push(check("all", what, correlation_of(&points), LEAST_CORRELATION, true));
    all
}

/// Of confidence and quality.
pub(super) fn correlation_of(points: &[SeverityPoint]) -> Option<f64> {
    let column = |value: fn(&SeverityPoint) -> f64| points.iter().map(value).collect::<Vec<_>>();
    rank_correlation(&column(|p| p.confidence), &column(|p| p.f_miou))
}

impl fmt::Display for SeverityReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rooms, gaussians, seconds, .. } = self;
        writeln!(f, "{rooms} unseen rooms of {gaussians} Gaussians, {seconds:.1} s")?;
        for EffectCurve { effect, points, .. } in &self.curves {
            writeln!(f, "{effect}")?;
            for SeverityPoint { severity, f_miou, ece, confidence, unknown, .. } in points {
                writeln!(
                    f,
                    "  {severity:>4}  f-mIoU {:5.1} %  ECE {:4.1} %  confidence {confidence:.3}  \
                     unknown {:4.1} %",
                    100.0 * f_miou,
                    100.0 * ece,
                    100.0 * unknown
                )?;
            }
        }
        for (i, Check { effect, what, value, bound, passed }) in self.checks.iter().enumerate() {
            let value = value.map_or("-".to_owned(), |v| format!("{v:.3}"));
            let mark = if *passed { "ok" } else { "NOT MET" };
            let end = if i + 1 < self.checks.len() { "\n" } else { "" };
            write!(f, "{effect}: {what}: {value} (bound {bound})  {mark}{end}")?;
        }
        Ok(())
    }
}

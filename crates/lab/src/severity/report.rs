//! The curves as numbers, with what is expected of them.

use super::CurveSettings;
use scenesplat_metrics::rank_correlation;
use serde::{Deserialize, Serialize};
use std::fmt;

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
    /// Means of other measures of how sure labels are, see [`OTHERS`](Self::OTHERS).
    #[serde(default)]
    pub others: [f64; 4],
    /// Gaussians with a true label.
    pub scored: usize,
}

impl SeverityPoint {
    /// Of each Gaussian's own feature: probability of its likeliest class less that of the second; one less the
    /// entropy over the classes, of the largest; of its label: the probability at twice the temperature; the share
    /// of the labels that are what the Gaussian's own feature says, without the vote.
    pub const OTHERS: [&'static str; 4] = ["margin", "order", "tempered", "agreement"];
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
    /// The same with voxels that are counted from the scene's origin (`anchor=world`).
    #[serde(default)]
    pub far_changed_anchored: f64,
}

/// How well a measure of confidence follows quality.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ConfidenceRow {
    /// `confidence`, or one of [`SeverityPoint::OTHERS`].
    pub measure: String,
    /// Rank correlation with f-mIoU along the curve of each effect, in their order; `None` where it has no meaning.
    pub curves: Vec<Option<f64>>,
    /// Of all points together.
    pub all: Option<f64>,
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
    /// How well measures of confidence follow quality.
    #[serde(default)]
    pub confidences: Vec<ConfidenceRow>,
    /// How long it took.
    pub seconds: f64,
}

impl SeverityReport {
    pub(super) fn new(
        settings: &CurveSettings,
        unknown_below: f32,
        curves: Vec<EffectCurve>,
        seconds: f64,
    ) -> Self {
        Self {
            rooms: settings.rooms,
            gaussians: settings.gaussians,
            room_seed: settings.room_seed,
            seed: settings.seed,
            unknown_below,
            checks: checks(&curves),
            confidences: confidences(&curves),
            curves,
            seconds,
        }
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
    for EffectCurve { effect, points, far_changed, .. } in curves {
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
    correlation_by(points, None)
}

/// Of confidence, or another measure of it, and quality.
fn correlation_by(points: &[SeverityPoint], other: Option<usize>) -> Option<f64> {
    let measure = |p: &SeverityPoint| other.map_or(p.confidence, |k| p.others[k]);
    let quality: Vec<f64> = points.iter().map(|p| p.f_miou).collect();
    rank_correlation(&points.iter().map(measure).collect::<Vec<_>>(), &quality)
}

pub(super) fn confidences(curves: &[EffectCurve]) -> Vec<ConfidenceRow> {
    let all: Vec<SeverityPoint> = curves.iter().flat_map(|curve| curve.points.clone()).collect();
    let others = SeverityPoint::OTHERS.iter().enumerate().map(|(k, name)| (*name, Some(k)));
    let row = |(name, other): (&str, Option<usize>)| ConfidenceRow {
        measure: name.to_owned(),
        curves: curves.iter().map(|curve| correlation_by(&curve.points, other)).collect(),
        all: correlation_by(&all, other),
    };
    std::iter::once(("confidence", None)).chain(others).map(row).collect()
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
        writeln!(f, "rank correlation with f-mIoU along each curve, and of all points")?;
        for ConfidenceRow { measure, curves, all } in &self.confidences {
            write!(f, "  {measure:<10}")?;
            for value in curves.iter().chain([all]) {
                write!(f, " {:>6}", value.map_or("-".to_owned(), |v| format!("{v:.2}")))?;
            }
            writeln!(f)?;
        }
        for EffectCurve { effect, far_changed_anchored, .. } in &self.curves {
            let far = 100.0 * far_changed_anchored;
            writeln!(f, "{effect}: labels far away that change with anchor=world: {far:.2} %")?;
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

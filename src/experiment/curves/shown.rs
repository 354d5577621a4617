//! What is drawn of a log, and in which order.

use scenesplat_metrics::Measurement;
use scenesplat_trainers::Criterion;
use scenesplat_trainers::callbacks::LoggedValue;
use std::collections::{BTreeMap, HashMap};

/// The sum that is minimized.
pub(in crate::experiment) const LOSS: &str = "train/loss";
const EVALUATION: u8 = 1;

/// One curve.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Curve {
    pub(super) name: String,
    /// Step and value; finite ones only.
    pub(super) points: Vec<[f64; 2]>,
    /// Values that are not finite.
    pub(super) bad: usize,
}

/// Why a curve has no panel; in the order in which they are named.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Reason {
    Constant,
    OneValue,
    Oracle,
    NotFinite,
}

impl Reason {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::OneValue => "one value",
            Self::Oracle => "oracle",
            Self::NotFinite => "not finite",
        }
    }
}

/// What a picture and a page show of a log.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shown {
    /// Curves with a panel: the loss, the measurement that decides, the rest of the training, the other evaluations,
    /// the rest; within each of these as they were logged first.
    pub(super) curves: Vec<Curve>,
    /// So many of the first ones are large.
    pub(super) large: usize,
    /// Curves without a panel, by reason, in the same order.
    pub(super) left_out: Vec<(Reason, Curve)>,
}

impl Shown {
    /// `selected`: what marks the best checkpoint; without, the first evaluation that has a panel stands in its place.
    pub(super) fn of(log: &[LoggedValue], selected: Option<&Criterion>) -> Self {
        let mut all = of_log(log);
        all.extend(selected.and_then(|criterion| mean_curve(log, criterion)));
        let mut deciding = selected.map(|criterion| match criterion.names() {
            [only] => only.clone(),
            _ => criterion.to_string(),
        });
        let (mut curves, mut left_out) = (Vec::new(), Vec::new());
        for curve in all {
            match curve.reason(deciding.as_ref() == Some(&curve.name)) {
                Some(reason) => left_out.push((reason, curve)),
                None => curves.push(curve),
            }
        }
        if deciding.is_none() {
            let evaluation = curves.iter().find(|curve| group(&curve.name) == EVALUATION);
            deciding = evaluation.map(|curve| curve.name.clone());
        }
        let rank = |curve: &Curve| match &curve.name {
            name if name == LOSS => 0,
            name if Some(name) == deciding.as_ref() => 1,
            name => 2 + group(name),
        };
        curves.sort_by_key(rank);
        left_out.sort_by_key(|(reason, curve)| (*reason, rank(curve)));
        let large = curves.iter().take_while(|curve| rank(curve) < 2).count();
        Self { curves, large, left_out }
    }
}

/// Training, evaluations, the rest.
fn group(name: &str) -> u8 {
    match name.split('/').next() {
        Some("train") => 0,
        Some("health" | "data") => 2,
        _ => EVALUATION,
    }
}

impl Curve {
    fn new(name: String) -> Self {
        Self { name, points: Vec::new(), bad: 0 }
    }

    fn push(&mut self, step: u64, value: f64) {
        if value.is_finite() {
            self.points.push([step as f64, value]);
        } else {
            self.bad += 1;
        }
    }

    pub(super) fn last(&self) -> Option<f64> {
        self.points.last().map(|point| point[1])
    }

    /// Why it has no panel. What decides is never hidden for its name.
    fn reason(&self, decides: bool) -> Option<Reason> {
        let Some(([_, first], rest)) = self.points.split_first() else {
            return Some(Reason::NotFinite);
        };
        if !decides && self.name.split('/').any(|part| part == "oracle") {
            Some(Reason::Oracle)
        } else if rest.is_empty() {
            Some(Reason::OneValue)
        } else {
            rest.iter().all(|[_, value]| value == first).then_some(Reason::Constant)
        }
    }

    /// Means of the values within a fiftieth of the curve on both sides; `None` for a curve of few values.
    pub(super) fn smooth(&self) -> Option<Vec<[f64; 2]>> {
        let points = &self.points;
        if points.len() <= 60 {
            return None;
        }
        let reach = (points.len() / 50).max(2);
        let mean = |i: usize| {
            let near = &points[i.saturating_sub(reach)..(i + reach + 1).min(points.len())];
            near.iter().map(|p| p[1]).sum::<f64>() / near.len() as f64
        };
        Some((0..points.len()).map(|i| [points[i][0], mean(i)]).collect())
    }
}

/// The curves of a log, as they were logged first. Times are not of the training, but of the machine.
fn of_log(log: &[LoggedValue]) -> Vec<Curve> {
    let (mut curves, mut places) = (Vec::new(), HashMap::new());
    for value in log.iter().filter(|value| !value.name.ends_with("seconds_per_step")) {
        let place = *places.entry(value.name.as_str()).or_insert_with(|| {
            curves.push(Curve::new(value.name.clone()));
            curves.len() - 1
        });
        curves[place].push(value.step, value.value);
    }
    curves
}

/// The values of a criterion, with their steps; where one of its measurements is missing there is none.
pub(in crate::experiment) fn values_of(
    log: &[LoggedValue],
    criterion: &Criterion,
) -> Vec<(u64, f64)> {
    let mut found: BTreeMap<u64, Vec<Measurement>> = BTreeMap::new();
    for value in log.iter().filter(|value| criterion.names().contains(&value.name)) {
        let measurement = Measurement::new(value.name.clone(), value.value);
        found.entry(value.step).or_default().push(measurement);
    }
    found.iter().filter_map(|(step, found)| Some((*step, criterion.value(found)?))).collect()
}

/// The curve of a mean of measurements, which nobody logs.
fn mean_curve(log: &[LoggedValue], criterion: &Criterion) -> Option<Curve> {
    if criterion.names().len() < 2 {
        return None;
    }
    let mut curve = Curve::new(criterion.to_string());
    values_of(log, criterion).into_iter().for_each(|(step, value)| curve.push(step, value));
    (!curve.points.is_empty() || curve.bad > 0).then_some(curve)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) fn logged(name: &str, values: &[f64]) -> Vec<LoggedValue> {
        let value = |(step, &value): (u64, &f64)| LoggedValue {
            step,
            epoch: 0,
            name: name.to_owned(),
            value,
        };
        (0..).zip(values).map(value).collect()
    }

    /// A log of everything, in an order that is not the one wanted.
    pub(crate) fn of_everything() -> Vec<LoggedValue> {
        let rising = [0.1, 0.2, 0.3];
        [
            logged("data/train/skipped_scenes", &[1.0, 2.0]),
            logged("health/rank", &[5.0, 6.0]),
            logged("unseen/mIoU", &rising),
            logged("unseen/f-mIoU", &rising),
            logged("unseen/oracle/f-mIoU", &rising),
            logged("train/seconds_per_step", &[0.5, 0.6]),
            logged("train/loss", &[3.0, f64::NAN, 2.0, 1.0]),
            logged("train/cosine", &[2.0, 1.0]),
            logged("train/lr_factor", &[0.0, 1.0]),
            logged("train/counted_rows", &[400.0, 400.0, 400.0]),
            logged("train/bad", &[f64::NAN, f64::INFINITY]),
            logged("seen/f-mIoU", &[0.5, 0.4, 0.9]),
            logged("seen/once", &[0.31]),
            logged("seen/zero", &[0.0, 0.0, f64::NAN]),
        ]
        .concat()
    }

    fn names(shown: &Shown) -> Vec<&str> {
        shown.curves.iter().map(|curve| curve.name.as_str()).collect()
    }

    #[test]
    fn the_loss_and_what_decides_come_first_and_large() {
        let log = of_everything();
        let one = Criterion::from("seen/f-mIoU");
        let shown = Shown::of(&log, Some(&one));
        assert_eq!(
            names(&shown),
            [
                "train/loss",
                "seen/f-mIoU",
                "train/cosine",
                "train/lr_factor",
                "unseen/mIoU",
                "unseen/f-mIoU",
                "data/train/skipped_scenes",
                "health/rank",
            ]
        );
        assert_eq!(shown.large, 2);
        assert_eq!((shown.curves[0].points.len(), shown.curves[0].bad), (3, 1));
        // Without, the first evaluation that was logged.
        let shown = Shown::of(&log, None);
        assert_eq!((names(&shown)[1], shown.large), ("unseen/mIoU", 2));
        assert_eq!(names(&shown)[4..6], ["unseen/f-mIoU", "seen/f-mIoU"]);
        // A mean is a curve of its own, where all of its parts were measured.
        let mean = Criterion::Mean(vec!["seen/f-mIoU".into(), "unseen/f-mIoU".into()]);
        let mut longer = log.clone();
        longer.push(LoggedValue { step: 9, ..logged("seen/f-mIoU", &[0.7]).remove(0) });
        let shown = Shown::of(&longer, Some(&mean));
        assert_eq!((shown.curves[1].name.clone(), shown.large), (mean.to_string(), 2));
        assert_eq!(
            shown.curves[1].points.iter().map(|p| p[0]).collect::<Vec<_>>(),
            [0.0, 1.0, 2.0]
        );
        assert!((shown.curves[1].points[2][1] - 0.6).abs() < 1e-12);
        assert!(names(&shown).contains(&"seen/f-mIoU"));
        // An oracle is drawn where the run asks for it.
        let oracle = Criterion::from("unseen/oracle/f-mIoU");
        assert_eq!(names(&Shown::of(&log, Some(&oracle)))[1], "unseen/oracle/f-mIoU");
        // What decides and does not change is left out; nothing else takes its place.
        let shown = Shown::of(&log, Some(&"seen/zero".into()));
        assert_eq!((names(&shown)[1], shown.large), ("train/cosine", 1));
    }

    #[test]
    fn what_never_changes_is_left_out_and_named() {
        let shown = Shown::of(&of_everything(), None);
        let found: Vec<_> =
            shown.left_out.iter().map(|(r, c)| (r.name(), c.name.as_str(), c.last())).collect();
        assert_eq!(
            found,
            [
                ("constant", "train/counted_rows", Some(400.0)),
                ("constant", "seen/zero", Some(0.0)),
                ("one value", "seen/once", Some(0.31)),
                ("oracle", "unseen/oracle/f-mIoU", Some(0.3)),
                ("not finite", "train/bad", None),
            ]
        );
        // In the order of panels.
        let once = [logged("a/x", &[1.0]), logged("a/y", &[1.0]), logged("train/loss", &[1.0])];
        let shown = Shown::of(&once.concat(), Some(&"a/y".into()));
        let names_of: Vec<_> = shown.left_out.iter().map(|(_, c)| c.name.as_str()).collect();
        assert_eq!(names_of, ["train/loss", "a/y", "a/x"]);
        // Neither a small change nor a name like an oracle's is a reason.
        let mut log = logged("a/oracles", &[1.0, 1.0 + f64::EPSILON]);
        assert_eq!(names(&Shown::of(&log, None)), ["a/oracles"]);
        log[1].value = 1.0;
        assert!(Shown::of(&log, None).curves.is_empty());
    }

    #[test]
    fn long_curves_have_a_mean_beside_them() {
        let curve = |n: u32| {
            let values: Vec<f64> = (0..n).map(|i| f64::from(i % 2)).collect();
            of_log(&logged("train/loss", &values)).remove(0)
        };
        assert_eq!(curve(60).smooth(), None);
        let smooth = curve(200).smooth().unwrap();
        assert_eq!((smooth.len(), smooth[199][0]), (200, 199.0));
        assert!(smooth.iter().all(|p| (p[1] - 0.5).abs() < 0.11), "{smooth:?}");
    }
}

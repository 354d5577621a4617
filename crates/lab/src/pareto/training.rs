//! What training costs: quality against its seconds, from the logs of runs.

use super::ParetoError;
use scenesplat_trainers::callbacks::{LoggedValue, read_json_lines};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Quality of a run over its training time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingCurve {
    /// Name of the run: that of its folder.
    pub name: String,
    /// What was measured, such as `zero_shot/f-mIoU`.
    pub metric: String,
    /// Seconds of training, and the value then. Time of evaluations is not counted.
    pub points: Vec<[f64; 2]>,
    /// The best value.
    pub best: f64,
    /// Seconds until the first value of at least 99 % of the best.
    pub seconds_to_99: f64,
}

/// Names of the quality that is shown, the first that a log has by their ending.
const ENDINGS: [&str; 3] = ["/f-mIoU", "/mIoU", "/allAcc"];

impl TrainingCurve {
    /// Reads the log of a run.
    ///
    /// The time of a step between two logged ones is taken to be that of the later. Values that are not
    /// finite are left out.
    ///
    /// # Errors
    /// If there is no log, it cannot be read, or it holds no quality or no time.
    pub fn read(run: &Path) -> Result<Self, ParetoError> {
        let path = run.join("metrics.jsonl");
        let log = read_json_lines(&path).map_err(|error| ParetoError::Training {
            path: path.clone(),
            text: error.to_string(),
        })?;
        let name = run.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self::of(&name, &log).map_err(|text| ParetoError::Training { path, text: text.to_owned() })
    }

    fn of(name: &str, log: &[LoggedValue]) -> Result<Self, &'static str> {
        let metric = ENDINGS
            .iter()
            .find_map(|ending| {
                let fits =
                    |v: &&LoggedValue| v.name.ends_with(ending) && !v.name.contains("oracle/");
                log.iter().find(fits)
            })
            .map(|v| v.name.clone())
            .ok_or("no evaluation was logged: no f-mIoU, mIoU or allAcc")?;
        let (mut step, mut seconds) = (0, 0.0);
        // Step and seconds so far, ascending.
        let mut clock = vec![(0, 0.0)];
        for value in log.iter().filter(|v| v.name == "train/seconds_per_step") {
            if value.value.is_finite() && value.step > step {
                seconds += (value.step - step) as f64 * value.value;
                step = value.step;
                clock.push((step, seconds));
            }
        }
        if seconds <= 0.0 {
            return Err("no train/seconds_per_step was logged");
        }
        let at = |step: u64| {
            let after =
                clock.iter().position(|(s, _)| *s >= step).unwrap_or(clock.len() - 1).max(1);
            let ((s0, t0), (s1, t1)) = (clock[after - 1], clock[after]);
            t0 + (t1 - t0) * (step - s0) as f64 / (s1 - s0) as f64
        };
        let points: Vec<[f64; 2]> = log
            .iter()
            .filter(|v| v.name == metric && v.value.is_finite())
            .map(|v| [at(v.step), v.value])
            .collect();
        let best = points.iter().map(|p| p[1]).fold(f64::NEG_INFINITY, f64::max);
        let reached = points.iter().find(|p| p[1] >= 0.99 * best);
        let seconds_to_99 = reached.ok_or("no evaluation is finite")?[0];
        Ok(Self { name: name.to_owned(), metric, points, best, seconds_to_99 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(step: u64, name: &str, value: f64) -> LoggedValue {
        LoggedValue { step, epoch: 0, name: name.to_owned(), value }
    }

    #[test]
    fn quality_stands_at_the_seconds_that_its_steps_took() {
        let time = "train/seconds_per_step";
        let log = [
            value(10, time, 1.0),
            value(15, "zero_shot/f-mIoU", 0.5),
            value(15, "zero_shot/oracle/f-mIoU", 1.0),
            value(20, time, 2.0),
            value(20, "zero_shot/f-mIoU", 0.8),
            value(30, time, 1.0),
            value(30, "zero_shot/f-mIoU", 0.795),
        ];
        let curve = TrainingCurve::of("run", &log).unwrap();
        assert_eq!(curve.metric, "zero_shot/f-mIoU");
        assert_eq!(curve.points, [[20.0, 0.5], [30.0, 0.8], [40.0, 0.795]]);
        assert_eq!((curve.best, curve.seconds_to_99), (0.8, 30.0));
        assert!(TrainingCurve::of("run", &log[..1]).unwrap_err().contains("evaluation"));
        assert!(TrainingCurve::of("run", &log[1..2]).unwrap_err().contains("seconds_per_step"));
        let error = TrainingCurve::read(Path::new("no/such/run")).unwrap_err().to_string();
        assert!(error.contains("metrics.jsonl"), "{error}");
    }

    #[test]
    fn times_lie_between_logged_steps_and_qualities_have_an_order() {
        let time = "train/seconds_per_step";
        let of = |more: &[LoggedValue]| {
            // 10 steps of 2 s, a step that goes back, one without a number, 10 of 4 s: 20 s at step 10, 60 s at 20.
            let mut log = vec![
                value(10, time, 2.0),
                value(5, time, 9.0),
                value(15, time, f64::NAN),
                value(20, time, 4.0),
            ];
            log.extend_from_slice(more);
            TrainingCurve::of("run", &log)
        };
        let curve = of(&[
            value(1, "a/allAcc", 0.9),
            value(2, "a/mIoU", 0.8),
            value(0, "b/f-mIoU", 0.1),
            value(5, "b/f-mIoU", 0.2),
            value(7, "b/f-mIoU", f64::NAN),
            value(15, "b/f-mIoU", 0.4),
            value(20, "c/f-mIoU", 0.7),
            value(25, "b/f-mIoU", 0.3),
        ])
        .unwrap();
        // The first f-mIoU there is, at 0, 10, 40 and, beyond the last step, 80 s.
        let want = vec![[0.0, 0.1], [10.0, 0.2], [40.0, 0.4], [80.0, 0.3]];
        assert_eq!(
            (curve.name.as_str(), curve.metric.as_str(), curve.points),
            ("run", "b/f-mIoU", want)
        );
        assert_eq!((curve.best, curve.seconds_to_99), (0.4, 40.0));
        let metric = |more: &[LoggedValue]| of(more).unwrap().metric;
        assert_eq!(metric(&[value(1, "a/allAcc", 0.9), value(2, "a/mIoU", 0.8)]), "a/mIoU");
        assert_eq!(
            metric(&[value(1, "oracle/f-mIoU", 1.0), value(2, "a/allAcc", 0.8)]),
            "a/allAcc"
        );
        // 0.99 of the best is enough, less is not.
        let until = |early: f64| {
            of(&[value(5, "a/mIoU", early), value(20, "a/mIoU", 0.5)]).unwrap().seconds_to_99
        };
        assert_eq!((until(0.496), until(0.494)), (10.0, 60.0));
        assert_eq!(of(&[value(1, "a/mIoU", f64::NAN)]).unwrap_err(), "no evaluation is finite");
        let folder = tempfile::tempdir().unwrap();
        let lines = [value(10, time, 2.0), value(5, "a/mIoU", 0.5)]
            .map(|v| serde_json::to_string(&v).unwrap());
        let run = folder.path().join("my_run");
        std::fs::create_dir(&run).unwrap();
        std::fs::write(run.join("metrics.jsonl"), lines.join("\n") + "\n").unwrap();
        let read = TrainingCurve::read(&run).unwrap();
        assert_eq!((read.name.as_str(), read.points), ("my_run", vec![[10.0, 0.5]]));
    }
}

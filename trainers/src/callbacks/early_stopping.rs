//! Stops a run that no longer gets better.

use crate::event::{Callback, Event, Flow, Progress};
use crate::{Criterion, TrainError};
use serde::{Deserialize, Serialize};

/// Stops after `patience` evaluations in a row that were no better than the best one before.
#[derive(Debug, Clone, PartialEq)]
pub struct EarlyStopping {
    measurement: Criterion,
    patience: u64,
    smaller_is_better: bool,
    min_delta: f64,
    state: State,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    best: Option<f64>,
    waited: u64,
}

impl EarlyStopping {
    /// Watches a measurement by its full name, such as `zero_shot/f-mIoU`, or the mean of several.
    pub fn new(measurement: impl Into<Criterion>, patience: u64, smaller_is_better: bool) -> Self {
        let measurement = measurement.into();
        Self { measurement, patience, smaller_is_better, min_delta: 0.0, state: State::default() }
    }

    /// Only what is better than the best one by more than this counts as better.
    #[must_use]
    pub fn with_min_delta(mut self, min_delta: f64) -> Self {
        self.min_delta = min_delta;
        self
    }
}

impl Callback for EarlyStopping {
    fn on_event(&mut self, event: &Event<'_>, _: Progress) -> Result<Flow, TrainError> {
        let Event::Evaluated { measurements } = event else { return Ok(Flow::Continue) };
        // One that is undefined this time is no better.
        let value = self.measurement.value(measurements).unwrap_or(f64::NAN);
        let better = match self.state.best {
            // Any number is better than none; NaN never is.
            None => !value.is_nan(),
            Some(best) if self.smaller_is_better => value < best - self.min_delta,
            Some(best) => value > best + self.min_delta,
        };
        if better {
            self.state = State { best: Some(value), waited: 0 };
            return Ok(Flow::Continue);
        }
        self.state.waited += 1;
        Ok(if self.state.waited >= self.patience { Flow::Stop } else { Flow::Continue })
    }

    fn waits_for(&self) -> Option<(&'static str, &Criterion)> {
        Some(("early_stopping.measurement", &self.measurement))
    }

    fn state(&self) -> Option<(&'static str, serde_json::Value)> {
        serde_json::to_value(self.state).ok().map(|state| ("early_stopping", state))
    }

    fn load_state(&mut self, state: &serde_json::Value) -> Result<(), TrainError> {
        self.state = serde_json::from_value(state.clone()).map_err(|_| TrainError::State {
            key: "early_stopping".to_owned(),
            problem: "unreadable",
        })?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_metrics::Measurement;

    /// The evaluation, from 1, after which a run with these values ends; 0 if none.
    fn end(mut stopping: EarlyStopping, values: &[f64]) -> usize {
        let is_end = |value: &f64| {
            let measurements = &[Measurement::new("a/x", *value)];
            let event = Event::Evaluated { measurements };
            stopping.on_event(&event, Progress::default()).unwrap() == Flow::Stop
        };
        values.iter().position(is_end).map_or(0, |at| at + 1)
    }

    #[test]
    fn a_run_ends_after_so_many_evaluations_without_a_better_value() {
        let rising = [0.5, 0.6, 0.6, 0.65, 0.6, 0.64, 0.7];
        let with =
            |patience, delta| EarlyStopping::new("a/x", patience, false).with_min_delta(delta);
        assert_eq!(end(with(2, 0.0), &rising), 6);
        assert_eq!(end(with(1, 0.0), &rising), 3);
        assert_eq!(end(with(3, 0.0), &rising), 0);
        // 0.65 is not better than 0.6 by more than a tenth.
        assert_eq!(end(with(2, 0.125), &rising), 3);
        assert_eq!(end(with(2, 0.0625), &[0.5, 0.6, 0.6, 0.65]), 4);
        let falling = rising.map(|value| -value);
        let with = |delta| EarlyStopping::new("a/x", 2, true).with_min_delta(delta);
        assert_eq!((end(with(0.0), &falling), end(with(0.125), &falling)), (6, 3));
        assert_eq!(end(with(0.0), &[1.0, f64::NAN, f64::NAN]), 3);
    }
}

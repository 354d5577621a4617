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
        Self { measurement, patience, smaller_is_better, state: State::default() }
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
            Some(best) if self.smaller_is_better => value < best,
            Some(best) => value > best,
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

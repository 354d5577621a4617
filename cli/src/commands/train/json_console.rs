//! A training as JSON on standard error.

use crate::log::{Level, Stage, line_of_stage};
use crate::terminal::{say, tell};
use scenesplat::metrics::Measurement;
use scenesplat::trainers::{Callback, End, Event, Flow, Progress, TrainError};
use serde_json::{Map, Value, json};

/// Says what happens in a run, one object a line.
pub(super) struct JsonConsole;

impl Callback for JsonConsole {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        match event {
            Event::FitStart { parameters, steps_per_epoch, .. } => progress(
                "train",
                &format!("training {parameters} parameters, {steps_per_epoch} steps an epoch"),
                at,
                &[],
            ),
            Event::Step { measurements } => {
                progress("train", &format!("step {}", at.step), at, measurements);
            }
            Event::Eval { name, measurements } => {
                progress(name, &format!("evaluated {name}"), at, measurements);
            }
            Event::Data { name, left_out } => {
                let lines = left_out.lines();
                lines.iter().for_each(|line| say(Level::Warning, &format!("{name}: {line}")));
            }
            Event::Alarm { message } => {
                say(Level::Warning, &format!("step {}: {message}", at.step));
            }
            Event::Checkpoint { dir, .. } => {
                progress("train", &format!("saved {}", dir.display()), at, &[]);
            }
            Event::FitEnd { end } => {
                let how = match end {
                    End::Finished => "done",
                    End::Stopped => "stopped",
                };
                progress("train", how, at, &[]);
            }
            _ => {}
        }
        Ok(Flow::Continue)
    }
}

fn progress(stage: &str, text: &str, at: Progress, measurements: &[Measurement]) {
    let mut more = Map::new();
    if !measurements.is_empty() {
        let values = measurements.iter().map(|m| (m.name.clone(), json!(m.value)));
        more.insert("measurements".to_owned(), Value::Object(values.collect()));
    }
    let stage = Stage { name: stage, done: at.step as f64, total: at.total_steps as f64 };
    tell(format!("{}\n", line_of_stage(stage, text, more)).as_bytes());
}

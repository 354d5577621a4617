//! `run.json`: the settings of a run and what happened to its data.

use super::ExperimentError;
use super::teacher::TeacherRecord;
use scenesplat_scene::AtomicFile;
use scenesplat_trainers::{Callback, Event, Flow, Progress, TrainError};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Alarms of a run that are written down: the first ones say what is wrong.
const MOST_ALARMS: usize = 100;

/// Writes `run.json`, again whenever more of the data was left out or an alarm was raised.
pub(super) struct RunRecord {
    path: PathBuf,
    run: Value,
    teacher: Option<Arc<TeacherRecord>>,
}

impl RunRecord {
    /// A record of a run that begins at `step`, with these facts; a resumed run keeps the earlier
    /// beginnings and alarms.
    pub(super) fn new(folder: &Path, step: u64, program: &Value, mut run: Value) -> Self {
        let path = folder.join("run.json");
        let (mut starts, mut alarms) = (Vec::new(), Vec::new());
        if step > 0
            && let Ok(text) = std::fs::read_to_string(&path)
            && let Ok(before) = serde_json::from_str::<Value>(&text)
        {
            starts = before["starts"].as_array().cloned().unwrap_or_default();
            alarms = before["alarms"].as_array().cloned().unwrap_or_default();
            alarms.retain(|alarm| alarm["step"].as_u64().is_some_and(|at| at <= step));
        }
        let mut start = program.clone();
        start["step"] = step.into();
        starts.push(start);
        run["starts"] = starts.into();
        run["data"] = json!({});
        run["alarms"] = alarms.into();
        Self { path, run, teacher: None }
    }

    /// With what the teacher did, if there is one.
    pub(super) fn with_teacher(mut self, teacher: &Option<Arc<TeacherRecord>>) -> Self {
        self.teacher.clone_from(teacher);
        self
    }

    /// Writes it as it stands.
    pub(super) fn write(&self) -> Result<(), ExperimentError> {
        let mut run = self.run.clone();
        if let Some(teacher) = &self.teacher {
            run["teacher"] = teacher.to_json();
        }
        write(&self.path, &serde_json::to_string_pretty(&run)?)
    }
}

impl Callback for RunRecord {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let unwritable = |problem: String| {
            let what = self.path.display().to_string();
            TrainError::Unwritable { what, problem }
        };
        match event {
            Event::Data { name, left_out } => {
                self.run["data"][*name] =
                    serde_json::to_value(left_out).map_err(|e| unwritable(e.to_string()))?;
            }
            Event::Alarm { message } => {
                let Some(alarms) = self.run["alarms"].as_array_mut() else {
                    return Ok(Flow::Continue);
                };
                if alarms.len() >= MOST_ALARMS {
                    return Ok(Flow::Continue);
                }
                alarms.push(json!({ "step": at.step, "message": message }));
            }
            // What the teacher did is known at these times.
            Event::Evaluated { .. } | Event::Checkpoint { .. } | Event::FitEnd { .. }
                if self.teacher.is_some() => {}
            _ => return Ok(Flow::Continue),
        }
        self.write().map_err(|e| unwritable(with_causes(&e)))?;
        Ok(Flow::Continue)
    }
}

/// An error with everything behind it, in one line.
fn with_causes(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(source) => format!("{error}: {}", with_causes(source)),
        None => error.to_string(),
    }
}

/// Replaces a small file of the run.
pub(super) fn write(path: &Path, content: &str) -> Result<(), ExperimentError> {
    Ok(AtomicFile::write(path, content.as_bytes())?)
}

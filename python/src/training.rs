//! Training.

use crate::errors::error;
use crate::work::run_with_stop;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use scenesplat::experiment::{ExperimentConfig, RunOptions, train_with};
use scenesplat::metrics::Measurement;
use scenesplat::models::DeviceChoice;
use scenesplat::trainers::checkpoint::newest_checkpoint;
use scenesplat::trainers::{Alone, Callback, Event, Flow, Progress, TrainError};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};

/// An exception of Python in a callback, until the training has saved and ended.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// Calls a function of Python for every event.
struct Told {
    function: Py<PyAny>,
    raised: Raised,
}

impl Callback for Told {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let answer = Python::attach(|py| -> PyResult<Option<bool>> {
            let told = PyDict::new(py);
            told.set_item("step", at.step)?;
            told.set_item("epoch", at.epoch)?;
            told.set_item("total_steps", at.total_steps)?;
            describe(event, &told)?;
            self.function.call1(py, (told,))?.extract(py)
        });
        match answer {
            Ok(Some(false)) => Ok(Flow::Stop),
            Ok(_) => Ok(Flow::Continue),
            Err(error) => {
                *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                Ok(Flow::Stop)
            }
        }
    }
}

/// Puts what happened into a dictionary.
fn describe(event: &Event<'_>, told: &Bound<'_, PyDict>) -> PyResult<()> {
    let numbers = |name: &str, measurements: &[Measurement]| {
        told.set_item("event", name)?;
        let all = PyDict::new(told.py());
        for found in measurements {
            all.set_item(found.name.as_str(), found.value)?;
        }
        told.set_item("measurements", all)
    };
    match event {
        Event::FitStart { parameters, steps_per_epoch, .. } => {
            told.set_item("event", "fit_start")?;
            told.set_item("parameters", *parameters)?;
            told.set_item("steps_per_epoch", *steps_per_epoch)
        }
        Event::Step { measurements } => numbers("step", measurements),
        Event::Eval { name, measurements } => {
            told.set_item("name", *name)?;
            numbers("eval", measurements)
        }
        Event::Evaluated { measurements } => numbers("evaluated", measurements),
        Event::Alarm { message } => {
            told.set_item("event", "alarm")?;
            told.set_item("message", *message)
        }
        Event::Checkpoint { dir, best } => {
            told.set_item("event", "checkpoint")?;
            told.set_item("dir", dir.to_path_buf())?;
            told.set_item("best", *best)
        }
        Event::FitEnd { .. } => told.set_item("event", "fit_end"),
        _ => told.set_item("event", "other"),
    }
}

fn of_file(path: &Path, changes: &[String]) -> PyResult<ExperimentConfig> {
    ExperimentConfig::read_changed(path, changes).map_err(error)
}

fn of_text(text: &str) -> PyResult<ExperimentConfig> {
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| error(e))?;
    ExperimentConfig::of_table(Path::new("config"), &table).map_err(error)
}

/// Trains; gives steps done, steps planned, epoch, the folder of the model, and remarks.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn train(
    py: Python<'_>,
    path: Option<PathBuf>,
    changes: Vec<String>,
    text: Option<String>,
    out: PathBuf,
    resume: Option<bool>,
    seed: Option<u64>,
    device: &str,
    callbacks: Vec<Py<PyAny>>,
) -> PyResult<(u64, u64, u64, PathBuf, Vec<String>)> {
    let mut config = match path {
        Some(path) => of_file(&path, &changes)?,
        None => of_text(text.as_deref().unwrap_or_default())?,
    };
    if let Some(seed) = seed {
        config.set_seed(seed);
    }
    let device: DeviceChoice =
        device.parse().map_err(|problem| crate::errors::argument("device", problem))?;
    let device = device.open_for_training().map_err(error)?.device;
    let raised = Raised::default();
    let told: Vec<Told> = callbacks
        .into_iter()
        .map(|function| Told { function, raised: Arc::clone(&raised) })
        .collect();
    let trained = run_with_stop(py, None, move |_, stop| {
        let is_there = || newest_checkpoint(&out.join("checkpoints")).map(|found| found.is_some());
        let resume = resume.map_or_else(is_there, Ok)?;
        let options = RunOptions { out, resume, console: None, stop, device, commit: None };
        let told = told.into_iter().map(|told| Box::new(told) as Box<dyn Callback>).collect();
        train_with(&config, &options, Rc::new(Alone), told).map_err(anyhow::Error::from)
    })?;
    if let Some(raised) = raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(raised);
    }
    let report = trained.map_err(error)?;
    let at = report.progress;
    Ok((at.step, at.total_steps, at.epoch, report.model, report.remarks))
}

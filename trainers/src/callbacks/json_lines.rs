//! The log that everything else is made from: one value a line.

use crate::TrainError;
use crate::event::{Callback, Event, Flow, Progress};
use scenesplat_datasets::LeftOut;
use scenesplat_metrics::Measurement;
use scenesplat_scene::AtomicFile;
use scenesplat_scene::input_file::open_regular_file;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

/// One line of the log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoggedValue {
    /// Optimizer steps done.
    pub step: u64,
    /// Epoch under way.
    pub epoch: u64,
    /// What was measured, such as `train/loss` or `zero_shot/f-mIoU`.
    pub name: String,
    /// The value; JSON has no NaN, which is written as null.
    #[serde(deserialize_with = "null_is_nan")]
    pub value: f64,
}

fn null_is_nan<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// Writes every measurement as a line of JSON: `{"step":10,"epoch":0,"name":…,"value":…}`.
///
/// A resumed run goes on with the same file: lines of steps after the one it starts from, which an
/// interruption left, are taken out first.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    file: Option<BufWriter<File>>,
}

impl JsonLines {
    /// Writes to `path`, which is opened when the run starts.
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), file: None }
    }

    /// Keeps the lines up to `step`, and opens the file behind them.
    fn open(&mut self, step: u64) -> Result<(), TrainError> {
        let mut kept: Vec<u8> = Vec::new();
        if step > 0 && self.path.is_file() {
            for value in read_json_lines(&self.path)?.iter().filter(|v| v.step <= step) {
                serde_json::to_writer(&mut kept, value)
                    .map_err(|e| TrainError::io(&self.path, "cannot describe")(e.into()))?;
                kept.push(b'\n');
            }
        }
        let mut file = AtomicFile::create(&self.path)?;
        file.write_all(&kept).map_err(TrainError::io(&self.path, "cannot write"))?;
        self.file = Some(BufWriter::new(file.commit_open()?));
        Ok(())
    }
}

impl Callback for JsonLines {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        let measurements = match event {
            Event::FitStart { .. } => {
                self.open(at.step)?;
                return Ok(Flow::Continue);
            }
            Event::Step { measurements } | Event::Eval { measurements, .. } => *measurements,
            Event::Data { name, left_out } => &data_measurements(name, left_out),
            _ => return Ok(Flow::Continue),
        };
        let error = TrainError::io(&self.path, "cannot write");
        let Some(file) = &mut self.file else { return Ok(Flow::Continue) };
        for m in measurements {
            let line = LoggedValue {
                step: at.step,
                epoch: at.epoch,
                name: m.name.clone(),
                value: m.value,
            };
            serde_json::to_writer(&mut *file, &line).map_err(|e| error(e.into()))?;
            file.write_all(b"\n").map_err(&error)?;
        }
        // Whoever watches the file sees whole lines.
        file.flush().map_err(&error)?;
        Ok(Flow::Continue)
    }
}

/// Counts of what was left out: `data/train/skipped_scenes` and so on.
fn data_measurements(name: &str, left_out: &LeftOut) -> Vec<Measurement> {
    let entry = |(count, value): (&str, usize)| {
        Measurement::new(format!("data/{name}/{count}"), value as f64)
    };
    left_out.counts().map(entry).to_vec()
}

/// Reads a log. A last line that was cut off is left out.
///
/// # Errors
/// If the file cannot be read, or a line before the last is none of this log's; the error says which.
pub fn read_json_lines(path: &Path) -> Result<Vec<LoggedValue>, TrainError> {
    let error = |action, source| TrainError::Io { path: path.to_owned(), action, source };
    let file = open_regular_file(path)?;
    let mut values = Vec::new();
    let mut broken: Option<(usize, serde_json::Error)> = None;
    for (index, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|e| error("cannot read", e))?;
        if let Some((index, source)) = broken {
            let text = format!("line {}: {source}", index + 1);
            return Err(error("cannot understand", std::io::Error::other(text)));
        }
        match serde_json::from_str(&line) {
            Ok(value) => values.push(value),
            Err(source) => broken = Some((index, source)),
        }
    }
    Ok(values)
}

//! What a run comes to.

use crate::bases::Data;
use scenesplat::experiment::{ExperimentConfig, RunOptions, train};
use serde_json::Value;
use std::path::Path;

/// Everything of a run that a setting may change.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Why there is nothing else.
    pub error: Option<String>,
    /// The exported parameters.
    pub weights: Vec<u8>,
    /// What evaluations found: step, name, bits.
    pub measured: Vec<(u64, String, u64)>,
    /// Everything else that was logged.
    pub logged: Vec<(u64, String, u64)>,
    /// Checkpoints, and which is the best.
    pub files: Vec<String>,
    /// What the record says of data, alarms and the teacher.
    pub record: String,
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// Runs an experiment.
pub fn run(data: &Data, config: &Value, name: &str) -> Outcome {
    let out = data.path().join(name);
    match try_run(config, &out) {
        Ok(()) => read(&out),
        Err(error) => Outcome { error: Some(error), ..Outcome::default() },
    }
}

fn try_run(config: &Value, out: &Path) -> Result<(), String> {
    let config: ExperimentConfig =
        serde_json::from_value(config.clone()).map_err(|e| e.to_string())?;
    config.check().map_err(|e| with_causes(&e))?;
    let (out, stop) = (out.to_owned(), Default::default());
    let options = RunOptions {
        out,
        resume: false,
        quiet: true,
        stop,
        device: candle_core::Device::Cpu,
        commit: None,
    };
    train(&config, &options).map(|_| ()).map_err(|e| with_causes(&e))
}

/// An error with everything behind it.
fn with_causes(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(source) => format!("{error}: {}", with_causes(source)),
        None => error.to_string(),
    }
}

fn read(out: &Path) -> Outcome {
    let checkpoints = out.join("checkpoints");
    let mut files: Vec<String> = std::fs::read_dir(&checkpoints)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    files.push(text(&checkpoints.join("best.json")));
    let log = text(&out.join("metrics.jsonl"));
    let entries = log.lines().map(|line| {
        let v: Value = serde_json::from_str(line).unwrap();
        let value = v["value"].as_f64().unwrap_or(f64::NAN).to_bits();
        (v["step"].as_u64().unwrap(), v["name"].as_str().unwrap().to_owned(), value)
    });
    let entries: Vec<_> = entries.filter(|(_, name, _)| name != "train/seconds_per_step").collect();
    let of_loop = |name: &str| ["train/", "health/", "data/"].iter().any(|p| name.starts_with(p));
    let (logged, measured) = entries.into_iter().partition(|(_, name, _)| of_loop(name));
    let record: Value = serde_json::from_str(&text(&out.join("run.json"))).unwrap();
    Outcome {
        error: None,
        weights: std::fs::read(out.join("model/model.safetensors")).unwrap(),
        measured,
        logged,
        files,
        record: format!("{} {} {}", record["data"], record["alarms"], record["teacher"]),
    }
}

//! The result of a run.

use super::bases::Data;
use crate::runs::{run, with_causes};
use scenesplat::experiment::ExperimentConfig;
use serde_json::Value;
use std::path::Path;

/// Everything of a run that a setting may change.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Why there is nothing else.
    pub error: Option<String>,
    /// The exported parameters.
    pub weights: Vec<u8>,
    /// Values from evaluations: step, name, bits.
    pub measured: Vec<(u64, String, u64)>,
    /// Everything else that was logged.
    pub logged: Vec<(u64, String, u64)>,
    /// Checkpoints, and which is the best.
    pub files: Vec<String>,
    /// The record of data, alarms and the teacher.
    pub record: String,
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// Runs an experiment, or resumes it.
pub fn outcome(data: &Data, config: &Value, name: &str, resume: bool) -> Outcome {
    let out = data.path().join(name);
    let config = serde_json::from_value::<ExperimentConfig>(config.clone());
    let done = config.map_err(|e| e.to_string()).and_then(|config| {
        config.check().map_err(|e| with_causes(&e))?;
        run(&config, &out, resume)
    });
    match done {
        Ok(_) => read(&out),
        Err(error) => Outcome { error: Some(error), ..Outcome::default() },
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

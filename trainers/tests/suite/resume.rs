//! What a checkpoint is taken up by, and what is refused.

use crate::line::{Line, Numbers, StopAt, config, numbers, trainer, values};
use scenesplat_metrics::Measurement;
use scenesplat_trainers::callbacks::{EarlyStopping, JsonLines, read_json_lines};
use scenesplat_trainers::checkpoint::{best_checkpoint, newest_checkpoint, read_network};
use scenesplat_trainers::{Evaluator, Identity, Progress, TrainError, Trainer, TrainerConfig};
use std::path::{Path, PathBuf};

fn averaged(dir: &Path) -> TrainerConfig {
    TrainerConfig { ema: Some(0.9), ..config(Some(dir)) }
}

/// A run that was stopped at step 9, and its checkpoint.
fn stopped() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    trainer(&module, averaged(dir.path()))
        .with_callback(StopAt(9))
        .fit(&module, &mut numbers(), &mut [], Progress::default())
        .unwrap();
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    (dir, newest)
}

fn load(dir: &Path, settings: TrainerConfig) -> Result<Progress, TrainError> {
    let module = Line::new();
    trainer(&module, settings).load_checkpoint(dir, &module)
}

/// Puts a NaN at the end of a file of tensors.
fn spoil(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let at = bytes.len() - 4;
    bytes[at..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn missing_and_changed_files_are_refused_by_name() {
    let files = ["params.safetensors", "optimizer.safetensors", "average.safetensors"];
    for name in files {
        for damage in ["missing", "was changed", "bytes"] {
            let (root, dir) = stopped();
            let path = dir.join(name);
            match damage {
                "missing" => std::fs::remove_file(&path).unwrap(),
                "was changed" => {
                    let mut bytes = std::fs::read(&path).unwrap();
                    *bytes.last_mut().unwrap() ^= 1;
                    std::fs::write(&path, bytes).unwrap();
                }
                _ => {
                    let bytes = std::fs::read(&path).unwrap();
                    std::fs::write(&path, &bytes[..bytes.len() - 4]).unwrap();
                }
            }
            let error = load(&dir, averaged(root.path())).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(damage), "{error}");
            // Neither is it exported.
            if name != "optimizer.safetensors" {
                assert!(read_network(&dir).is_err(), "{name} {damage}");
            }
        }
    }
    let (root, dir) = stopped();
    load(&dir, averaged(root.path())).unwrap();
    read_network(&dir).unwrap();
}

#[test]
fn values_that_are_not_finite_are_refused_even_with_a_right_checksum() {
    for name in ["params.safetensors", "optimizer.safetensors", "average.safetensors"] {
        let (root, dir) = stopped();
        let path = dir.join(name);
        // The last value of the file may be a counter: take one that is a float.
        let mut tensors = candle_core::safetensors::load(&path, &candle_core::Device::Cpu).unwrap();
        let key = tensors.keys().find(|k| !k.ends_with(".step")).unwrap().clone();
        let nan = (tensors[&key].zeros_like().unwrap() / 0.0).unwrap();
        tensors.insert(key.clone(), nan);
        candle_core::safetensors::save(&tensors, &path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let state = dir.join("state.json");
        let mut json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&state).unwrap()).unwrap();
        json["files"][name] =
            serde_json::json!({ "bytes": bytes.len(), "crc32c": crc32c::crc32c(&bytes) });
        std::fs::write(&state, json.to_string()).unwrap();
        let error = load(&dir, averaged(root.path())).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(&key), "{error}");
        assert!(error.contains("not finite"), "{error}");
    }
    let (root, dir) = stopped();
    spoil(&dir.join("average.safetensors"));
    let error = load(&dir, averaged(root.path())).unwrap_err().to_string();
    assert!(error.contains("average.safetensors"), "{error}");
}

#[test]
fn settings_of_the_loop_are_compared_except_those_that_may_change() {
    let (root, dir) = stopped();
    let plain = serde_json::to_value(averaged(root.path())).unwrap();
    let changed = |name: &str, value: serde_json::Value| -> TrainerConfig {
        let mut settings = plain.clone();
        let mut place = &mut settings;
        for part in name.split('.') {
            place = &mut place[part];
        }
        assert_ne!(*place, value, "{name}");
        *place = value;
        serde_json::from_value(settings).unwrap()
    };
    use serde_json::json;
    for (name, value) in [
        ("seed", json!(6)),
        ("epochs", json!(5)),
        ("accumulate", json!(2)),
        ("clip_norm", json!(1.0)),
        ("ema", json!(0.5)),
        ("ema", json!(null)),
        ("freeze", json!(["bias"])),
        ("checkpoint.best", json!("a/b")),
        ("checkpoint.smaller_is_better", json!(true)),
    ] {
        let error = load(&dir, changed(name, value)).unwrap_err();
        let TrainError::Resume { changes } = &error else { panic!("{name}: {error}") };
        assert_eq!(changes.len(), 1, "{changes:?}");
        assert_eq!(changes[0].setting, format!("trainer.{name}"));
        assert!(error.to_string().contains(&format!("trainer.{name} was ")), "{error}");
    }
    for (name, value) in [
        ("log_every", json!(3)),
        ("eval_every", json!(3)),
        ("recompute", json!(true)),
        ("idle", json!(["bias"])),
        ("checkpoint.dir", json!("/elsewhere")),
        ("checkpoint.every_steps", json!(3)),
        ("checkpoint.keep", json!(3)),
        ("health.every_steps", json!(3)),
        ("health.min_effective_rank", json!(0.5)),
    ] {
        assert!(
            TrainerConfig::MAY_CHANGE.iter().any(|listed| name.starts_with(listed)),
            "{name} is in the list"
        );
        load(&dir, changed(name, value)).unwrap();
    }
}

#[test]
fn what_is_not_the_trainers_is_compared_too() {
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    let with = |loss: &str| {
        let identity = Identity::new().with("losses[0].type", loss);
        trainer(&module, config(Some(dir.path()))).with_identity(identity)
    };
    with("cosine")
        .with_callback(StopAt(2))
        .fit(&module, &mut numbers(), &mut [], Progress::default())
        .unwrap();
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    with("cosine").load_checkpoint(&newest, &module).unwrap();
    let error = with("l2").load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains(r#"losses[0].type was "cosine" and is "l2""#), "{error}");
    // So are the optimizer and its schedule.
    use scenesplat_trainers::{AdamW, AdamWConfig, CosineSchedule, OneCycle, group_by_keyword};
    let other = |lr: f64, cosine: bool| -> Trainer {
        let groups = group_by_keyword(&module.params.parameters(), lr, 0.01, &[]);
        let optimizer = Box::new(AdamW::new(groups, AdamWConfig::default()).unwrap());
        let settings = config(Some(dir.path()));
        let trainer = if cosine {
            Trainer::new(settings, optimizer, Box::new(CosineSchedule::new(1.0, 0.0)))
        } else {
            Trainer::new(settings, optimizer, Box::new(OneCycle::default()))
        };
        trainer.unwrap().with_identity(Identity::new().with("losses[0].type", "cosine"))
    };
    other(0.05, false).load_checkpoint(&newest, &module).unwrap();
    let error = other(0.06, false).load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains("optimizer.parameter_groups[0].lr was 0.05 and is 0.06"), "{error}");
    let error = other(0.05, true).load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains(r#"schedule.type was "one_cycle" and is "cosine""#), "{error}");
    // The settings in the file cannot be changed along.
    let state = newest.join("state.json");
    let text = std::fs::read_to_string(&state).unwrap();
    std::fs::write(&state, text.replace("cosine", "l2")).unwrap();
    let error = with("l2").load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains("state.json"), "{error}");
}

/// Falls for three epochs, then stays.
struct Score;
impl Evaluator<Line> for Score {
    fn name(&self) -> &str {
        "score"
    }
    fn measurements(&self) -> Vec<String> {
        vec!["error".to_owned()]
    }
    fn run(&mut self, module: &Line, at: Progress) -> Result<Vec<Measurement>, TrainError> {
        let part = f64::from(values(module)[0].abs()) * 1e-3;
        Ok(vec![Measurement::new("error", (3.0 - at.epoch as f64).max(0.0) + part)])
    }
}

#[test]
fn a_run_stopped_at_the_end_of_an_epoch_evaluates_it_when_it_goes_on() {
    let outcome = |stop: Option<u64>| {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("metrics.jsonl");
        let mut settings = TrainerConfig { epochs: 9, ..config(Some(dir.path())) };
        settings.checkpoint.best = Some("score/error".into());
        settings.checkpoint.smaller_is_better = true;
        let module = Line::new();
        let with = |module: &Line| {
            trainer(module, settings.clone())
                .with_callback(JsonLines::new(&log))
                .with_callback(EarlyStopping::new("score/error", 2, true))
        };
        let mut evaluators: Vec<Box<dyn Evaluator<Line>>> = vec![Box::new(Score)];
        let (mut at, mut last) = (Progress::default(), with(&module));
        if let Some(stop) = stop {
            with(&module)
                .with_callback(StopAt(stop))
                .fit(&module, &mut numbers(), &mut evaluators, at)
                .unwrap();
            let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
            at = last.load_checkpoint(&newest, &module).unwrap();
            assert_eq!(at.step, stop);
        }
        let end = last.fit(&module, &mut numbers(), &mut evaluators, at).unwrap();
        let logged = read_json_lines(&log).unwrap();
        let scores: Vec<_> = logged
            .iter()
            .filter(|v| v.name == "score/error")
            .map(|v| (v.step, v.value.to_bits()))
            .collect();
        (end, scores, best_checkpoint(dir.path()).unwrap(), values(&module))
    };
    let whole = outcome(None);
    for stop in [7, 14, 13, 28] {
        assert_eq!(whole, outcome(Some(stop)), "stopped at {stop}");
    }
}

/// Best at the first epoch.
struct Rising;
impl Evaluator<Line> for Rising {
    fn name(&self) -> &str {
        "score"
    }
    fn measurements(&self) -> Vec<String> {
        vec!["error".to_owned()]
    }
    fn run(&mut self, _: &Line, at: Progress) -> Result<Vec<Measurement>, TrainError> {
        Ok(vec![Measurement::new("error", at.epoch as f64)])
    }
}

#[test]
fn patience_goes_on_where_it_was() {
    // Seven steps an epoch; the third evaluation is the second in vain.
    let end = |stop: Option<u64>| {
        let dir = tempfile::tempdir().unwrap();
        let settings = config(Some(dir.path()));
        let module = Line::new();
        let with = || {
            trainer(&module, settings.clone()).with_callback(EarlyStopping::new(
                "score/error",
                2,
                true,
            ))
        };
        let mut evaluators: Vec<Box<dyn Evaluator<Line>>> = vec![Box::new(Rising)];
        let (mut at, mut last) = (Progress::default(), with());
        if let Some(stop) = stop {
            with()
                .with_callback(StopAt(stop))
                .fit(&module, &mut numbers(), &mut evaluators, at)
                .unwrap();
            let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
            at = last.load_checkpoint(&newest, &module).unwrap();
        }
        last.fit(&module, &mut numbers(), &mut evaluators, at).unwrap().step
    };
    assert_eq!([None, Some(9), Some(16)].map(end), [21; 3]);
}

#[test]
fn data_in_another_number_of_batches_are_refused() {
    let (root, dir) = stopped();
    let module = Line::new();
    let mut again = trainer(&module, averaged(root.path()));
    let start = again.load_checkpoint(&dir, &module).unwrap();
    let mut more = Numbers { batches: 8, ..numbers() };
    let error = again.fit(&module, &mut more, &mut [], start).unwrap_err().to_string();
    assert!(error.contains("batches of an epoch was 7 and is 8"), "{error}");
}

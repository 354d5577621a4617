//! What a checkpoint is taken up by, and what is refused.

use crate::support::{
    Line, Numbers, Score, config, fit, load, logged, numbers, stop_at, trainer, trainer_by,
};
use scenesplat_trainers::callbacks::{EarlyStopping, JsonLines};
use scenesplat_trainers::checkpoint::{best_checkpoint, newest_checkpoint, read_network};
use scenesplat_trainers::{
    CosineSchedule, DataModule, Identity, OneCycle, Progress, TrainError, TrainerConfig,
};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};

const FILES: [&str; 3] = ["params.safetensors", "optimizer.safetensors", "average.safetensors"];

fn averaged(dir: &Path) -> TrainerConfig {
    TrainerConfig { ema: Some(0.9), ..config(Some(dir)) }
}

/// A run that was stopped at step 9, and its checkpoint.
fn stopped() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    fit(trainer(&module, averaged(dir.path())).with_callback(stop_at(9)), &module, numbers())
        .unwrap();
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    (dir, newest)
}

fn try_load(dir: &Path, settings: TrainerConfig) -> Result<Progress, TrainError> {
    let module = Line::new();
    trainer(&module, settings).load_checkpoint(dir, &module)
}

#[test]
fn missing_and_changed_files_are_refused_by_name() {
    let (root, dir) = stopped();
    for name in FILES {
        let path = dir.join(name);
        let good = fs::read(&path).unwrap();
        for damage in ["missing", "was changed", "bytes"] {
            let mut bytes = good.clone();
            match damage {
                "missing" => fs::remove_file(&path).unwrap(),
                "was changed" => *bytes.last_mut().unwrap() ^= 1,
                _ => bytes.truncate(good.len() - 4),
            }
            if damage != "missing" {
                fs::write(&path, bytes).unwrap();
            }
            let error = try_load(&dir, averaged(root.path())).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains(damage), "{error}");
            // Neither is it exported.
            let exported = read_network(&dir).is_ok();
            assert_eq!(exported, name == "optimizer.safetensors", "{name} {damage}");
        }
        fs::write(&path, good).unwrap();
    }
    try_load(&dir, averaged(root.path())).unwrap();
    read_network(&dir).unwrap();
}

#[test]
fn values_that_are_not_finite_are_refused_even_with_a_right_checksum() {
    for name in FILES {
        let (root, dir) = stopped();
        let path = dir.join(name);
        // The last value of the file may be a counter: take one that is a float.
        let mut tensors = candle_core::safetensors::load(&path, &candle_core::Device::Cpu).unwrap();
        let key = tensors.keys().find(|k| !k.ends_with(".step")).unwrap().clone();
        let nan = (tensors[&key].zeros_like().unwrap() / 0.0).unwrap();
        tensors.insert(key.clone(), nan);
        candle_core::safetensors::save(&tensors, &path).unwrap();
        let bytes = fs::read(&path).unwrap();
        let state = dir.join("state.json");
        let mut json: serde_json::Value =
            serde_json::from_slice(&fs::read(&state).unwrap()).unwrap();
        json["files"][name] = json!({ "bytes": bytes.len(), "crc32c": crc32c::crc32c(&bytes) });
        fs::write(&state, json.to_string()).unwrap();
        let error = try_load(&dir, averaged(root.path())).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(&key), "{error}");
        assert!(error.contains("not finite"), "{error}");
    }
}

#[test]
fn settings_of_the_loop_are_compared_except_those_that_may_change() {
    let (root, dir) = stopped();
    let plain = serde_json::to_value(averaged(root.path())).unwrap();
    let changed = |name: &str, value: serde_json::Value| -> TrainerConfig {
        let mut settings = plain.clone();
        let place = name.split('.').fold(&mut settings, |place, part| &mut place[part]);
        assert_ne!(*place, value, "{name}");
        *place = value;
        serde_json::from_value(settings).unwrap()
    };
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
        let error = try_load(&dir, changed(name, value)).unwrap_err();
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
        let listed = TrainerConfig::MAY_CHANGE.iter().any(|listed| name.starts_with(listed));
        assert!(listed, "{name} is in the list");
        try_load(&dir, changed(name, value)).unwrap();
    }
}

#[test]
fn what_is_not_the_trainers_is_compared_too() {
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    let with = |loss: &str, lr: f64, cosine: bool| {
        let settings = config(Some(dir.path()));
        let trainer = match cosine {
            true => trainer_by(&module, settings, lr, 0.01, CosineSchedule::new(1.0, 0.0)),
            false => trainer_by(&module, settings, lr, 0.01, OneCycle::default()),
        };
        trainer.with_identity(Identity::new().with("losses[0].type", loss))
    };
    let first = with("cosine", 0.05, false).with_callback(stop_at(2));
    fit(first, &module, numbers()).unwrap();
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    with("cosine", 0.05, false).load_checkpoint(&newest, &module).unwrap();
    for (loss, lr, cosine, says) in [
        ("l2", 0.05, false, r#"losses[0].type was "cosine" and is "l2""#),
        ("cosine", 0.06, false, "optimizer.parameter_groups[0].lr was 0.05 and is 0.06"),
        ("cosine", 0.05, true, r#"schedule.type was "one_cycle" and is "cosine""#),
    ] {
        let error = with(loss, lr, cosine).load_checkpoint(&newest, &module).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
    // The settings in the file cannot be changed along.
    let state = newest.join("state.json");
    let text = fs::read_to_string(&state).unwrap();
    fs::write(&state, text.replace("cosine", "l2")).unwrap();
    let error = with("l2", 0.05, false).load_checkpoint(&newest, &module).unwrap_err();
    assert!(error.to_string().contains("state.json"), "{error}");
}

#[test]
fn a_run_stopped_at_the_end_of_an_epoch_evaluates_it_when_it_goes_on() {
    let outcome = |stop: Option<u64>| {
        let dir = tempfile::tempdir().unwrap();
        let log = dir.path().join("metrics.jsonl");
        let mut settings = TrainerConfig { epochs: 9, ..config(Some(dir.path())) };
        settings.checkpoint.best = Some("score/value".into());
        settings.checkpoint.smaller_is_better = true;
        let module = Line::new();
        let with = || {
            trainer(&module, settings.clone())
                .with_callback(JsonLines::new(&log))
                .with_callback(EarlyStopping::new("score/value", 2, true))
        };
        // Falls for three epochs, then stays.
        let mut data =
            DataModule::new(numbers()).with_evaluator(Score("score", |m: &Line, at: Progress| {
                (3.0 - at.epoch as f64).max(0.0) + f64::from(m.values()[0].abs()) * 1e-3
            }));
        let (mut at, mut last) = (Progress::default(), with());
        if let Some(stop) = stop {
            with().with_callback(stop_at(stop)).fit(&module, &mut data, at).unwrap();
            at = load(&mut last, dir.path(), &module);
            assert_eq!(at.step, stop);
        }
        let end = last.fit(&module, &mut data, at).unwrap();
        let scores = logged(&log, "score/value");
        (end, scores, best_checkpoint(dir.path()).unwrap(), module.values())
    };
    let whole = outcome(None);
    for stop in [7, 14, 13, 28] {
        assert_eq!(whole, outcome(Some(stop)), "stopped at {stop}");
    }
}

#[test]
fn patience_goes_on_where_it_was() {
    // Seven steps an epoch, best at the first; the third evaluation is the second in vain.
    let end = |stop: Option<u64>| {
        let dir = tempfile::tempdir().unwrap();
        let module = Line::new();
        let with = || {
            let patience = EarlyStopping::new("score/value", 2, true);
            trainer(&module, config(Some(dir.path()))).with_callback(patience)
        };
        let rising = Score("score", |_: &Line, at: Progress| at.epoch as f64);
        let mut data = DataModule::new(numbers()).with_evaluator(rising);
        let (mut at, mut last) = (Progress::default(), with());
        if let Some(stop) = stop {
            with().with_callback(stop_at(stop)).fit(&module, &mut data, at).unwrap();
            at = load(&mut last, dir.path(), &module);
        }
        last.fit(&module, &mut data, at).unwrap().step
    };
    assert_eq!([None, Some(9), Some(16)].map(end), [21; 3]);
}

#[test]
fn what_was_the_best_is_known_after_an_interruption() {
    let dir = tempfile::tempdir().unwrap();
    let mut settings = config(Some(dir.path()));
    settings.checkpoint.best = Some("score/value".into());
    // Falls: 1, ½, ⅓, …
    let falling = Score("score", |_: &Line, at: Progress| 7.0 / at.step as f64);
    let mut data = DataModule::new(numbers()).with_evaluator(falling);
    let module = Line::new();
    let mut first = trainer(&module, settings.clone()).with_callback(stop_at(10));
    first.fit(&module, &mut data, Progress::default()).unwrap();
    let module = Line::new();
    let mut second = trainer(&module, settings);
    let start = load(&mut second, dir.path(), &module);
    second.fit(&module, &mut data, start).unwrap();
    let best = best_checkpoint(dir.path()).unwrap().unwrap();
    assert_eq!((best.checkpoint.as_str(), best.value), ("step-000000007", 1.0));
    assert!(dir.path().join(&best.checkpoint).is_dir(), "the best one stays");
}

#[test]
fn data_in_another_number_of_batches_are_refused() {
    let (root, dir) = stopped();
    let module = Line::new();
    let mut again = trainer(&module, averaged(root.path()));
    let start = again.load_checkpoint(&dir, &module).unwrap();
    let mut more = DataModule::new(Numbers { batches: 8, ..numbers() });
    let error = again.fit(&module, &mut more, start).unwrap_err().to_string();
    assert!(error.contains("batches of an epoch was 7 and is 8"), "{error}");
}

//! The loop on a model small enough to check by hand.

use crate::support::{
    Batches, Line, Numbers, Rows, Score, Watch, config, fit, load, logged, names_in, numbers,
    resume, stop_at, trainer,
};
use scenesplat_trainers::callbacks::{EarlyStopping, JsonLines, TensorBoard};
use scenesplat_trainers::checkpoint::{best_checkpoint, newest_checkpoint};
use scenesplat_trainers::{
    DataModule, End, Event, Flow, Progress, TrainError, Trainer, TrainerConfig,
};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

fn run(module: &Line, config: TrainerConfig) -> Progress {
    fit(trainer(module, config), module, numbers()).unwrap()
}

#[test]
fn it_learns_what_there_is_to_learn() {
    let module = Line::new();
    let at = run(&module, TrainerConfig { epochs: 60, ..config(None) });
    assert_eq!((at.step, at.total_steps), (420, 420));
    for weight in &module.values()[1..] {
        assert!((weight - 0.5).abs() < 0.02, "{weight}");
    }
}

#[test]
fn a_resumed_run_has_the_bits_of_one_that_was_not_interrupted() {
    for (accumulate, ema) in [(1, None), (2, Some(0.9))] {
        let settings = |dir: Option<&Path>| TrainerConfig { accumulate, ema, ..config(dir) };
        let averages =
            |t: &Trainer, m: &Line| t.with_average(&m.params, || Ok(m.values())).unwrap();
        let plain = Line::new();
        let mut whole = trainer(&plain, settings(None));
        whole.fit(&plain, &mut DataModule::new(numbers()), Progress::default()).unwrap();
        for stop in [1, 3, 5, 7, 4 * (7 / accumulate) - 1] {
            let dir = tempfile::tempdir().unwrap();
            let module = Line::new();
            let first = trainer(&module, settings(Some(dir.path()))).with_callback(stop_at(stop));
            assert_eq!(fit(first, &module, numbers()).unwrap().step, stop);
            // Another process: nothing but the files is left.
            let module = Line::new();
            let mut second = trainer(&module, settings(Some(dir.path())));
            let start = load(&mut second, dir.path(), &module);
            assert_eq!(start.step, stop);
            second.fit(&module, &mut DataModule::new(numbers()), start).unwrap();
            assert_eq!(plain.values(), module.values(), "stopped at {stop}");
            assert_eq!(averages(&whole, &plain), averages(&second, &module));
        }
    }
}

#[test]
fn a_number_of_steps_takes_the_place_of_epochs() {
    let limited = |steps, dir: Option<&Path>| TrainerConfig {
        epochs: 1,
        max_steps: Some(steps),
        ..config(dir)
    };
    let values = |config: TrainerConfig| {
        let module = Line::new();
        let at = run(&module, config);
        assert_eq!(at.step, at.total_steps);
        (at.step, module.values())
    };
    // Two epochs of seven steps; and three steps of the third, where schedules end.
    assert_eq!(values(limited(14, None)), values(TrainerConfig { epochs: 2, ..config(None) }));
    let (steps, whole) = values(limited(17, None));
    assert_eq!(steps, 17);
    assert_eq!(values(TrainerConfig { epochs: 4, ..limited(3, None) }).0, 3);
    for stop in [3, 14, 15] {
        let dir = tempfile::tempdir().unwrap();
        let module = Line::new();
        let first = trainer(&module, limited(17, Some(dir.path()))).with_callback(stop_at(stop));
        assert_eq!(fit(first, &module, numbers()).unwrap().step, stop);
        let module = Line::new();
        let second = trainer(&module, limited(17, Some(dir.path())));
        let at = resume(second, dir.path(), &module, numbers());
        assert_eq!((at.step, module.values()), (17, whole.clone()), "stopped at {stop}");
    }
    // The end is evaluated and saved, whatever is due there.
    let dir = tempfile::tempdir().unwrap();
    let (module, looked) = (Line::new(), Arc::new(Mutex::new(Vec::new())));
    let seen = looked.clone();
    let mut settings = TrainerConfig { eval_every: 0, ..limited(10, Some(dir.path())) };
    settings.checkpoint.every_steps = 5;
    let watch = Watch(move |event: &Event<'_>, at: Progress| {
        if matches!(event, Event::Evaluated { .. }) {
            seen.lock().unwrap().push(at.step);
        }
        Flow::Continue
    });
    let mut data =
        DataModule::new(numbers()).with_evaluator(Score("score", |_: &Line, _: Progress| 0.0));
    trainer(&module, settings)
        .with_callback(watch)
        .fit(&module, &mut data, Progress::default())
        .unwrap();
    assert_eq!(*looked.lock().unwrap(), [10]);
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    assert!(newest.display().to_string().contains("10"), "{}", newest.display());
}

#[test]
fn accumulated_parts_are_a_whole_batch() {
    // Batches of 20 rows, and the same rows in parts: equal means, no batch statistics.
    let numbers = Numbers { rows: 20, ..numbers() };
    let quiet = || Line { noise: 0.0, ..Line::new() };
    let once = TrainerConfig { epochs: 1, ..config(None) };
    let whole = quiet();
    fit(trainer(&whole, once.clone()), &whole, numbers).unwrap();
    for accumulate in [2, 4] {
        let module = quiet();
        let several = TrainerConfig { accumulate: accumulate as u64, ..once.clone() };
        let part = move |epoch, place: usize| -> Rows {
            let batch = numbers.batch(epoch, place / accumulate);
            batch.chunks(20 / accumulate).nth(place % accumulate).unwrap().to_vec()
        };
        fit(trainer(&module, several), &module, Batches(7 * accumulate, part)).unwrap();
        for (x, y) in whole.values().iter().zip(module.values()) {
            assert!((x - y).abs() < 1e-6, "{accumulate}: {x} {y}");
        }
    }
}

#[test]
fn a_poisoned_batch_is_named() {
    let module = Line::new();
    let data = Numbers { poison: Some((1, 3)), ..numbers() };
    let error = fit(trainer(&module, config(None)), &module, data).unwrap_err();
    let TrainError::Step { step, scenes, suspects, source } = &error else { panic!("{error}") };
    assert_eq!((*step, scenes.len(), suspects.len()), (10, 1, 1));
    assert!(matches!(&**source, TrainError::NonFiniteLoss { term, .. } if term == "square"));
    assert!(module.values().iter().all(|v| v.is_finite()), "the step was not taken");
}

#[test]
fn parameters_without_gradient_are_named_unless_allowed() {
    let module = Line { use_bias: false, ..Line::new() };
    let fit = |config| fit(trainer(&module, config), &module, numbers());
    let error = fit(config(None)).unwrap_err();
    let dead = matches!(&error, TrainError::DeadParameters { names } if *names == ["bias"]);
    assert!(dead, "{error}");
    fit(TrainerConfig { idle: vec!["bias".to_owned()], ..config(None) }).unwrap();
}

#[test]
fn frozen_parameters_stay() {
    let module = Line::new();
    let before = module.values();
    run(&module, TrainerConfig { freeze: vec!["weight".to_owned()], ..config(None) });
    let after = module.values();
    assert_ne!(before[0], after[0], "the bias moves");
    assert_eq!(before[1..], after[1..]);
}

#[test]
fn best_and_last_checkpoints_stay_and_patience_ends() {
    let dir = tempfile::tempdir().unwrap();
    let mut settings = TrainerConfig { epochs: 9, ..config(Some(dir.path())) };
    settings.checkpoint.best = Some("score/value".into());
    settings.checkpoint.smaller_is_better = true;
    let module = Line::new();
    let log = dir.path().join("metrics.jsonl");
    let mut trainer = trainer(&module, settings)
        .with_callback(JsonLines::new(&log))
        .with_callback(TensorBoard::new(&dir.path().join("tensorboard")))
        .with_callback(EarlyStopping::new("score/value", 3, true));
    // Falls, then rises: best at epoch 1, then three that are no better.
    let score = Score("score", |_: &Line, at: Progress| (at.epoch as f64 - 1.0).abs());
    let mut data = DataModule::new(numbers()).with_evaluator(score);
    let at = trainer.fit(&module, &mut data, Progress::default()).unwrap();
    assert_eq!(at.step, 5 * 7);
    let best = best_checkpoint(dir.path()).unwrap().unwrap();
    assert_eq!((best.checkpoint.as_str(), best.value), ("step-000000014", 0.0));
    assert_eq!(names_in(dir.path(), "step-"), ["step-000000014", "step-000000035"]);
    assert_eq!(logged(&log, "train/loss").len(), 35);
    assert_eq!(logged(&log, "score/value").len(), 5);
    assert_eq!(names_in(&dir.path().join("tensorboard"), "").len(), 1);
}

#[test]
fn a_resumed_log_has_each_step_once() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("metrics.jsonl");
    let mut settings = config(Some(dir.path()));
    settings.checkpoint.every_steps = 4;
    let with =
        |module: &Line| trainer(module, settings.clone()).with_callback(JsonLines::new(&log));
    // Ends by an error at step 10, two steps behind the last checkpoint.
    let module = Line::new();
    fit(with(&module), &module, Numbers { poison: Some((1, 3)), ..numbers() }).unwrap_err();
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    assert!(newest.ends_with("step-000000008"));
    let module = Line::new();
    resume(with(&module), dir.path(), &module, numbers());
    let steps: Vec<u64> = logged(&log, "train/loss").iter().map(|(step, _)| *step).collect();
    assert_eq!(steps, (1..=28).collect::<Vec<_>>());
}

#[test]
fn evaluation_sees_the_average_and_training_goes_on_from_the_rest() {
    let (plain, averaged) = (Line::new(), Line::new());
    run(&plain, config(None));
    let mut seen = Vec::new();
    let note = Score("score", |module: &Line, _: Progress| {
        seen.push(module.values());
        0.0
    });
    let mut data = DataModule::new(numbers()).with_evaluator(note);
    trainer(&averaged, TrainerConfig { ema: Some(0.99), ..config(None) })
        .fit(&averaged, &mut data, Progress::default())
        .unwrap();
    drop(data);
    assert_eq!(plain.values(), averaged.values(), "looking changes nothing");
    assert_eq!(seen.len(), 4);
    assert_ne!(seen[3], averaged.values());
}

#[test]
fn a_stop_flag_saves_and_ends() {
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    let (stop, end) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(None)));
    // Sets the flag after three steps, as a signal would.
    let (flag, noted) = (Arc::clone(&stop), Arc::clone(&end));
    let interrupt = Watch(move |event: &Event<'_>, at: Progress| {
        flag.fetch_or(at.step == 3, Ordering::SeqCst);
        if let Event::FitEnd { end } = event {
            *noted.lock().unwrap() = Some(*end);
        }
        Flow::Continue
    });
    let trainer =
        trainer(&module, config(Some(dir.path()))).with_callback(interrupt).with_stop(stop);
    assert_eq!(fit(trainer, &module, numbers()).unwrap().step, 3);
    assert_eq!(*end.lock().unwrap(), Some(End::Stopped));
    assert!(newest_checkpoint(dir.path()).unwrap().unwrap().ends_with("step-000000003"));
}

#[test]
fn too_few_batches_are_an_error() {
    let module = Line::new();
    let trainer = trainer(&module, TrainerConfig { accumulate: 3, ..config(None) });
    let error = fit(trainer, &module, Numbers { batches: 2, ..numbers() }).unwrap_err();
    assert!(matches!(error, TrainError::ShortEpoch { .. }), "{error}");
}

//! The loop on a model small enough to check by hand.

use crate::line::{Line, Numbers, Rows, StopAt, config, numbers, trainer, values};
use scenesplat_datasets::{BatchLoader, DataError};
use scenesplat_metrics::Measurement;
use scenesplat_trainers::callbacks::{EarlyStopping, JsonLines, TensorBoard, read_json_lines};
use scenesplat_trainers::checkpoint::{best_checkpoint, newest_checkpoint};
use scenesplat_trainers::{
    Callback, End, Evaluator, Event, Flow, Progress, TrainError, Trainer, TrainerConfig,
};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

fn run(module: &Line, config: TrainerConfig) -> Progress {
    trainer(module, config).fit(module, &mut numbers(), &mut [], Progress::default()).unwrap()
}

#[test]
fn it_learns_what_there_is_to_learn() {
    let module = Line::new();
    let at = run(&module, TrainerConfig { epochs: 60, ..config(None) });
    assert_eq!((at.step, at.total_steps), (420, 420));
    for weight in &values(&module)[1..] {
        assert!((weight - 0.5).abs() < 0.02, "{weight}");
    }
}

#[test]
fn a_resumed_run_has_the_bits_of_one_that_was_not_interrupted() {
    for (accumulate, ema) in [(1, None), (2, Some(0.9))] {
        let plain = Line::new();
        let settings = |dir: Option<&Path>| TrainerConfig { accumulate, ema, ..config(dir) };
        let mut whole = trainer(&plain, settings(None));
        whole.fit(&plain, &mut numbers(), &mut [], Progress::default()).unwrap();
        let total = 4 * (7 / accumulate);
        for stop in [1, 3, 5, 7, total - 1] {
            let dir = tempfile::tempdir().unwrap();
            let module = Line::new();
            let mut first =
                trainer(&module, settings(Some(dir.path()))).with_callback(StopAt(stop));
            let at = first.fit(&module, &mut numbers(), &mut [], Progress::default()).unwrap();
            assert_eq!(at.step, stop);
            // Another process: nothing but the files is left.
            let module = Line::new();
            let mut second = trainer(&module, settings(Some(dir.path())));
            let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
            let start = second.load_checkpoint(&newest, &module).unwrap();
            assert_eq!(start.step, stop);
            second.fit(&module, &mut numbers(), &mut [], start).unwrap();
            assert_eq!(values(&plain), values(&module), "stopped at {stop}");
            let averages =
                |t: &Trainer, m: &Line| t.with_average(&m.params, || Ok(values(m))).unwrap();
            assert_eq!(averages(&whole, &plain), averages(&second, &module));
        }
    }
}

#[test]
fn accumulated_parts_are_a_whole_batch() {
    // Batches of 20 rows, and the same rows in parts: equal means, no batch statistics.
    struct Parts(Numbers, usize);
    impl BatchLoader<Rows> for Parts {
        fn batches_per_epoch(&self) -> usize {
            7 * self.1
        }
        fn epoch(
            &mut self,
            epoch: u64,
            skip: usize,
        ) -> Box<dyn Iterator<Item = std::result::Result<Rows, DataError>> + '_> {
            let all: Vec<Rows> = self.0.epoch(epoch, 0).map(|b| b.unwrap()).collect();
            let rows = self.0.rows / self.1;
            let parts: Vec<_> =
                all.iter().flat_map(|b| b.chunks(rows)).map(<[_]>::to_vec).collect();
            Box::new(parts.into_iter().skip(skip).map(Ok))
        }
    }
    let numbers = || Numbers { rows: 20, ..numbers() };
    let quiet = || Line { noise: 0.0, ..Line::new() };
    let once = TrainerConfig { epochs: 1, ..config(None) };
    let whole = quiet();
    trainer(&whole, once.clone())
        .fit(&whole, &mut numbers(), &mut [], Progress::default())
        .unwrap();
    for accumulate in [2_u16, 4] {
        let module = quiet();
        let several = TrainerConfig { accumulate: accumulate.into(), ..once.clone() };
        let mut parts = Parts(numbers(), accumulate.into());
        trainer(&module, several).fit(&module, &mut parts, &mut [], Progress::default()).unwrap();
        for (x, y) in values(&whole).iter().zip(values(&module)) {
            assert!((x - y).abs() < 1e-6, "{accumulate}: {x} {y}");
        }
    }
}

#[test]
fn a_poisoned_batch_is_named() {
    let module = Line::new();
    let mut data = Numbers { poison: Some((1, 3)), ..numbers() };
    let error = trainer(&module, config(None))
        .fit(&module, &mut data, &mut [], Progress::default())
        .unwrap_err();
    let TrainError::Step { step, scenes, suspects, source } = &error else { panic!("{error}") };
    assert_eq!((*step, scenes.len(), suspects.len()), (10, 1, 1));
    assert!(matches!(&**source, TrainError::NonFiniteLoss { term, .. } if term == "square"));
    assert!(values(&module).iter().all(|v| v.is_finite()), "the step was not taken");
}

#[test]
fn parameters_without_gradient_are_named_unless_allowed() {
    let mut module = Line::new();
    module.use_bias = false;
    let fit = |config| {
        trainer(&module, config).fit(&module, &mut numbers(), &mut [], Progress::default())
    };
    let error = fit(config(None)).unwrap_err();
    assert!(
        matches!(&error, TrainError::DeadParameters { names } if *names == ["bias"]),
        "{error}"
    );
    fit(TrainerConfig { idle: vec!["bias".to_owned()], ..config(None) }).unwrap();
}

#[test]
fn frozen_parameters_stay() {
    let module = Line::new();
    let before = values(&module);
    run(&module, TrainerConfig { freeze: vec!["weight".to_owned()], ..config(None) });
    let after = values(&module);
    assert_ne!(before[0], after[0], "the bias moves");
    assert_eq!(before[1..], after[1..]);
}

/// Gives falling, then rising numbers, and records what the parameters were.
struct Score(Arc<Mutex<Vec<Vec<f32>>>>);
impl Evaluator<Line> for Score {
    fn name(&self) -> &str {
        "score"
    }
    fn measurements(&self) -> Vec<String> {
        vec!["error".to_owned()]
    }
    fn run(
        &mut self,
        module: &Line,
        at: Progress,
    ) -> std::result::Result<Vec<Measurement>, TrainError> {
        self.0.lock().unwrap().push(values(module));
        Ok(vec![Measurement::new("error", (at.epoch as f64 - 1.0).abs())])
    }
}

#[test]
fn best_and_last_checkpoints_stay_and_patience_ends() {
    let dir = tempfile::tempdir().unwrap();
    let mut settings = TrainerConfig { epochs: 9, ..config(Some(dir.path())) };
    settings.checkpoint.best = Some("score/error".into());
    settings.checkpoint.smaller_is_better = true;
    let module = Line::new();
    let log = dir.path().join("metrics.jsonl");
    let mut trainer = trainer(&module, settings)
        .with_callback(JsonLines::new(&log))
        .with_callback(TensorBoard::new(&dir.path().join("tensorboard")))
        .with_callback(EarlyStopping::new("score/error", 3, true));
    let mut evaluators: Vec<Box<dyn Evaluator<Line>>> = vec![Box::new(Score(Arc::default()))];
    let at = trainer.fit(&module, &mut numbers(), &mut evaluators, Progress::default()).unwrap();
    // Best at epoch 1, then three that are no better.
    assert_eq!(at.step, 5 * 7);
    let best = best_checkpoint(dir.path()).unwrap().unwrap();
    assert_eq!((best.checkpoint.as_str(), best.value), ("step-000000014", 0.0));
    let mut names: Vec<String> = std::fs::read_dir(dir.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|n| n.starts_with("step-"))
        .collect();
    names.sort();
    assert_eq!(names, ["step-000000014", "step-000000035"]);
    let logged = read_json_lines(&log).unwrap();
    assert_eq!(logged.iter().filter(|v| v.name == "train/loss").count(), 35);
    assert_eq!(logged.iter().filter(|v| v.name == "score/error").count(), 5);
    assert_eq!(std::fs::read_dir(dir.path().join("tensorboard")).unwrap().count(), 1);
}

#[test]
fn a_resumed_log_has_each_step_once() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("metrics.jsonl");
    let module = Line::new();
    let mut settings = config(Some(dir.path()));
    settings.checkpoint.every_steps = 4;
    // Ends by an error at step 10, two steps behind the last checkpoint.
    let mut poisoned = Numbers { poison: Some((1, 3)), ..numbers() };
    trainer(&module, settings.clone())
        .with_callback(JsonLines::new(&log))
        .fit(&module, &mut poisoned, &mut [], Progress::default())
        .unwrap_err();
    let module = Line::new();
    let mut second = trainer(&module, settings).with_callback(JsonLines::new(&log));
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    assert!(newest.ends_with("step-000000008"));
    let start = second.load_checkpoint(&newest, &module).unwrap();
    second.fit(&module, &mut numbers(), &mut [], start).unwrap();
    let losses = read_json_lines(&log).unwrap().into_iter().filter(|v| v.name == "train/loss");
    let steps: Vec<u64> = losses.map(|v| v.step).collect();
    assert_eq!(steps, (1..=28).collect::<Vec<_>>());
}

#[test]
fn evaluation_sees_the_average_and_training_goes_on_from_the_rest() {
    let (plain, averaged) = (Line::new(), Line::new());
    run(&plain, config(None));
    let seen = Arc::new(Mutex::new(Vec::new()));
    let mut evaluators: Vec<Box<dyn Evaluator<Line>>> = vec![Box::new(Score(seen.clone()))];
    trainer(&averaged, TrainerConfig { ema: Some(0.99), ..config(None) })
        .fit(&averaged, &mut numbers(), &mut evaluators, Progress::default())
        .unwrap();
    assert_eq!(values(&plain), values(&averaged), "looking changes nothing");
    let seen = seen.lock().unwrap();
    assert_eq!(seen.len(), 4);
    assert_ne!(seen[3], values(&averaged));
}

#[test]
fn other_settings_do_not_continue_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    run(&module, config(Some(dir.path())));
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    let mut other = trainer(&module, TrainerConfig { seed: 6, ..config(None) });
    let error = other.load_checkpoint(&newest, &module).unwrap_err().to_string();
    assert!(error.contains("trainer.seed was 5 and is 6"), "{error}");
}

#[test]
fn a_stop_flag_saves_and_ends() {
    /// Sets the flag after three steps, as a signal would.
    struct Interrupt(Arc<AtomicBool>, Arc<Mutex<Option<End>>>);
    impl Callback for Interrupt {
        fn on_event(
            &mut self,
            event: &Event<'_>,
            at: Progress,
        ) -> std::result::Result<Flow, TrainError> {
            if at.step == 3 {
                self.0.store(true, Ordering::SeqCst);
            }
            if let Event::FitEnd { end } = event {
                *self.1.lock().unwrap() = Some(*end);
            }
            Ok(Flow::Continue)
        }
    }
    let dir = tempfile::tempdir().unwrap();
    let module = Line::new();
    let (stop, end) = (Arc::new(AtomicBool::new(false)), Arc::default());
    let at = trainer(&module, config(Some(dir.path())))
        .with_callback(Interrupt(stop.clone(), Arc::clone(&end)))
        .with_stop(stop)
        .fit(&module, &mut numbers(), &mut [], Progress::default())
        .unwrap();
    assert_eq!(at.step, 3);
    assert_eq!(*end.lock().unwrap(), Some(End::Stopped));
    assert!(newest_checkpoint(dir.path()).unwrap().unwrap().ends_with("step-000000003"));
}

#[test]
fn too_few_batches_are_an_error() {
    let module = Line::new();
    let mut data = Numbers { batches: 2, ..numbers() };
    let error = trainer(&module, TrainerConfig { accumulate: 3, ..config(None) })
        .fit(&module, &mut data, &mut [], Progress::default())
        .unwrap_err();
    assert!(matches!(error, TrainError::ShortEpoch { .. }), "{error}");
}

//! Data that teach nothing, and data that were left out.

use crate::support::{
    Line, Numbers, Rows, Watch, config, fit, logged, numbers, resume, stop_at, trainer,
};
use candle_core::Result;
use scenesplat_datasets::{BatchLoader, DataError, LeftOut, RepairedScene, SkippedScene};
use scenesplat_models::ParamStore;
use scenesplat_trainers::callbacks::JsonLines;
use scenesplat_trainers::{
    Event, Flow, Progress, StepContext, StepOutput, TrainError, TrainerConfig, TrainingModule,
};
use std::sync::{Arc, Mutex};

/// A module whose rows count in some steps only.
struct Sparse {
    line: Line,
    /// Whether the batches of a step count.
    counts: fn(u64) -> bool,
    empty: bool,
}

impl TrainingModule for Sparse {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.line.params
    }
    fn training_step(&self, batch: &Rows, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let counts = (self.counts)(cx.step);
        let out = self.line.training_step(batch, cx)?;
        Ok(StepOutput { counted_rows: if counts { out.rows } else { 0 }, ..out })
    }
    fn is_empty(&self, _: &Rows) -> bool {
        self.empty
    }
    fn scenes(&self, _: &Rows) -> Vec<String> {
        vec!["kitchen".to_owned()]
    }
}

fn sparse(counts: fn(u64) -> bool) -> Sparse {
    Sparse { line: Line::new(), counts, empty: false }
}

#[test]
fn an_epoch_in_which_no_row_counts_ends_the_run() {
    let run = |module: Sparse| fit(trainer(&module, config(None)), &module, numbers());
    // One batch of each epoch of seven is enough.
    run(sparse(|step| step % 7 == 3)).unwrap();
    let error = run(sparse(|step| !(7..=13).contains(&step))).unwrap_err();
    let TrainError::NothingCounted { epoch, tally, scenes } = &error else { panic!("{error}") };
    assert_eq!((*epoch, tally.batches, tally.rows, tally.counted_rows), (1, 7, 35, 0));
    assert_eq!(*scenes, ["kitchen"]);
    assert!(error.to_string().contains("kitchen"), "{error}");
    let error = run(Sparse { empty: true, ..sparse(|_| true) }).unwrap_err();
    let TrainError::NothingCounted { epoch, tally, .. } = error else { panic!("{error}") };
    assert_eq!((epoch, tally.empty_batches, tally.rows), (0, 7, 0));
}

#[test]
fn a_resumed_epoch_remembers_its_first_part() {
    let dir = tempfile::tempdir().unwrap();
    let module = sparse(|step| step % 7 == 1);
    let with = || trainer(&module, config(Some(dir.path())));
    fit(with().with_callback(stop_at(10)), &module, numbers()).unwrap();
    resume(with(), dir.path(), &module, numbers());
}

#[test]
fn settings_that_train_nothing_are_refused() {
    let none = TrainerConfig { epochs: 0, ..config(None) };
    let error = none.check().unwrap_err().to_string();
    assert!(error.contains("epochs is 0"), "{error}");
    let module = Line::new();
    let named = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    for (freeze, idle, says) in [
        (&["wieght"][..], &[][..], &["freeze", "\"wieght\"", "bias, weight"][..]),
        (&[], &["haed"], &["idle", "\"haed\""]),
        (&["weight", "bias"], &[], &["no parameter to train"]),
    ] {
        let settings = TrainerConfig { freeze: named(freeze), idle: named(idle), ..config(None) };
        let error = fit(trainer(&module, settings), &module, numbers()).unwrap_err().to_string();
        assert!(says.iter().all(|says| error.contains(says)), "{error}");
    }
}

/// A loader that says what it left out.
struct Lossy(Numbers, LeftOut);
impl BatchLoader<Rows> for Lossy {
    fn batches_per_epoch(&self) -> usize {
        self.0.batches
    }
    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = std::result::Result<Rows, DataError>> + '_> {
        self.0.epoch(epoch, skip)
    }
    fn left_out(&self) -> LeftOut {
        self.1.clone()
    }
}

fn left_out(skipped: usize, dropped_rows: usize) -> LeftOut {
    let mut all = LeftOut { scenes: 20, rows: 1000, ..LeftOut::default() };
    for i in 0..skipped {
        let reason = "cannot be read".to_owned();
        all.skipped.insert(format!("scene-{i}"), SkippedScene { times: 3, reason });
    }
    let reasons = vec![format!("{dropped_rows} rows: position is not finite: row left out")];
    let repaired = RepairedScene { rows: 500, dropped_rows, reasons };
    all.repaired.insert("hall".to_owned(), repaired);
    all.without_labels.insert("cellar".to_owned());
    all
}

#[test]
fn what_was_left_out_is_said_once_and_logged() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("metrics.jsonl");
    let (module, said) = (Line::new(), Arc::new(Mutex::new(Vec::new())));
    let noted = Arc::clone(&said);
    let trainer = trainer(&module, config(None))
        .with_callback(Watch(move |event: &Event<'_>, at: Progress| {
            if let Event::Data { name, left_out } = event {
                noted.lock().unwrap().push((at.step, (*name).to_owned(), (*left_out).clone()));
            }
            Flow::Continue
        }))
        .with_callback(JsonLines::new(&log));
    fit(trainer, &module, Lossy(numbers(), left_out(1, 40))).unwrap();
    assert_eq!(*said.lock().unwrap(), [(7, "train".to_owned(), left_out(1, 40))]);
    for (name, value) in [
        ("data/train/skipped_scenes", 1.0),
        ("data/train/dropped_rows", 40.0),
        ("data/train/scenes_without_labels", 1.0),
        ("train/counted_rows", 5.0),
    ] {
        assert_eq!(logged(&log, name)[0].1, value, "{name}");
    }
}

#[test]
fn more_than_the_stated_share_ends_the_run() {
    let run = |left_out: LeftOut, max_left_out: f64| {
        let module = Line::new();
        let trainer = trainer(&module, TrainerConfig { max_left_out, ..config(None) });
        fit(trainer, &module, Lossy(numbers(), left_out)).map_err(|e| e.to_string())
    };
    run(left_out(2, 100), 0.1).unwrap();
    let error = run(left_out(3, 0), 0.1).unwrap_err();
    assert!(error.contains("3 of 20 scenes") && error.contains("scene-0"), "{error}");
    let error = run(left_out(0, 101), 0.1).unwrap_err();
    assert!(error.contains("101 of 1000 rows") && error.contains("hall"), "{error}");
    run(left_out(3, 101), 1.0).unwrap();
    assert!(run(left_out(1, 0), 0.0).is_err());
}

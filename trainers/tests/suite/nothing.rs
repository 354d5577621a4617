//! Data that teach nothing, and data that were left out.

use crate::line::{Line, Numbers, Rows, StopAt, config, numbers, trainer};
use candle_core::Result;
use scenesplat_datasets::{BatchLoader, DataError, LeftOut, RepairedScene, SkippedScene};
use scenesplat_models::ParamStore;
use scenesplat_trainers::callbacks::{JsonLines, read_json_lines};
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::{
    AdamW, AdamWConfig, Callback, Event, Flow, OneCycle, Progress, StepContext, StepOutput,
    TrainError, Trainer, TrainerConfig, TrainingModule, group_by_keyword,
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

fn fit(counts: fn(u64) -> bool, empty: bool) -> std::result::Result<Progress, TrainError> {
    let module = Sparse { line: Line::new(), counts, empty };
    let groups = group_by_keyword(&module.line.params.parameters(), 0.05, 0.01, &[]);
    let optimizer = AdamW::new(groups, AdamWConfig::default()).unwrap();
    Trainer::new(config(None), Box::new(optimizer), Box::new(OneCycle::default())).unwrap().fit(
        &module,
        &mut numbers(),
        &mut [],
        Progress::default(),
    )
}

#[test]
fn an_epoch_in_which_no_row_counts_ends_the_run() {
    // One batch of each epoch of seven is enough.
    fit(|step| step % 7 == 3, false).unwrap();
    let error = fit(|step| !(7..=13).contains(&step), false).unwrap_err();
    let TrainError::NothingCounted { epoch, tally, scenes } = &error else { panic!("{error}") };
    assert_eq!((*epoch, tally.batches, tally.rows, tally.counted_rows), (1, 7, 35, 0));
    assert_eq!(*scenes, ["kitchen"]);
    assert!(error.to_string().contains("kitchen"), "{error}");
    let error = fit(|_| true, true).unwrap_err();
    let TrainError::NothingCounted { epoch, tally, .. } = error else { panic!("{error}") };
    assert_eq!((epoch, tally.empty_batches, tally.rows), (0, 7, 0));
}

#[test]
fn a_resumed_epoch_remembers_its_first_part() {
    let dir = tempfile::tempdir().unwrap();
    let counts: fn(u64) -> bool = |step| step % 7 == 1;
    let with = |module: &Sparse| {
        let groups = group_by_keyword(&module.line.params.parameters(), 0.05, 0.01, &[]);
        let optimizer = AdamW::new(groups, AdamWConfig::default()).unwrap();
        let settings = config(Some(dir.path()));
        Trainer::new(settings, Box::new(optimizer), Box::new(OneCycle::default())).unwrap()
    };
    let module = Sparse { line: Line::new(), counts, empty: false };
    with(&module)
        .with_callback(StopAt(10))
        .fit(&module, &mut numbers(), &mut [], Progress::default())
        .unwrap();
    let mut second = with(&module);
    let newest = newest_checkpoint(dir.path()).unwrap().unwrap();
    let start = second.load_checkpoint(&newest, &module).unwrap();
    second.fit(&module, &mut numbers(), &mut [], start).unwrap();
}

#[test]
fn settings_that_train_nothing_are_refused() {
    let none = TrainerConfig { epochs: 0, ..config(None) };
    let error = none.check().unwrap_err().to_string();
    assert!(error.contains("epochs is 0"), "{error}");
    let module = Line::new();
    let fit = |settings: TrainerConfig| {
        trainer(&module, settings)
            .fit(&module, &mut numbers(), &mut [], Progress::default())
            .unwrap_err()
            .to_string()
    };
    let part = |part: &str| vec![part.to_owned()];
    let error = fit(TrainerConfig { freeze: part("wieght"), ..config(None) });
    assert!(error.contains("freeze") && error.contains("\"wieght\""), "{error}");
    assert!(error.contains("bias, weight"), "{error}");
    let error = fit(TrainerConfig { idle: part("haed"), ..config(None) });
    assert!(error.contains("idle") && error.contains("\"haed\""), "{error}");
    let all = vec!["weight".to_owned(), "bias".to_owned()];
    let error = fit(TrainerConfig { freeze: all, ..config(None) });
    assert!(error.contains("no parameter to train"), "{error}");
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

/// Keeps what is said of the data.
#[derive(Clone, Default)]
struct Said(Arc<Mutex<Vec<(u64, String, LeftOut)>>>);
impl Callback for Said {
    fn on_event(
        &mut self,
        event: &Event<'_>,
        at: Progress,
    ) -> std::result::Result<Flow, TrainError> {
        if let Event::Data { name, left_out } = event {
            self.0.lock().unwrap().push((at.step, (*name).to_owned(), (*left_out).clone()));
        }
        Ok(Flow::Continue)
    }
}

#[test]
fn what_was_left_out_is_said_once_and_logged() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("metrics.jsonl");
    let (module, said) = (Line::new(), Said::default());
    let mut data = Lossy(numbers(), left_out(1, 40));
    trainer(&module, config(None))
        .with_callback(said.clone())
        .with_callback(JsonLines::new(&log))
        .fit(&module, &mut data, &mut [], Progress::default())
        .unwrap();
    let said = said.0.lock().unwrap();
    assert_eq!(*said, [(7, "train".to_owned(), left_out(1, 40))]);
    let logged = read_json_lines(&log).unwrap();
    let value = |name: &str| logged.iter().find(|v| v.name == name).map(|v| v.value);
    assert_eq!(value("data/train/skipped_scenes"), Some(1.0));
    assert_eq!(value("data/train/dropped_rows"), Some(40.0));
    assert_eq!(value("data/train/scenes_without_labels"), Some(1.0));
    assert_eq!(value("train/counted_rows"), Some(5.0));
}

#[test]
fn more_than_the_stated_share_ends_the_run() {
    let fit = |left_out: LeftOut, max_left_out: f64| {
        let module = Line::new();
        trainer(&module, TrainerConfig { max_left_out, ..config(None) })
            .fit(&module, &mut Lossy(numbers(), left_out), &mut [], Progress::default())
            .map_err(|e| e.to_string())
    };
    fit(left_out(2, 100), 0.1).unwrap();
    let error = fit(left_out(3, 0), 0.1).unwrap_err();
    assert!(error.contains("3 of 20 scenes") && error.contains("scene-0"), "{error}");
    let error = fit(left_out(0, 101), 0.1).unwrap_err();
    assert!(error.contains("101 of 1000 rows") && error.contains("hall"), "{error}");
    fit(left_out(3, 101), 1.0).unwrap();
    assert!(fit(left_out(1, 0), 0.0).is_err());
}

//! The loop against one written by hand in f64, which calls nothing of the trainer: gradients,
//! accumulation, clipping, rates, momentum, decay, moving average.

use crate::support::{Line, Numbers, Rows, Score, Watch, fit, flat, numbers, trainer_by};
use candle_core::Result;
use scenesplat_metrics::Measurement;
use scenesplat_models::ParamStore;
use scenesplat_trainers::callbacks::EarlyStopping;
use scenesplat_trainers::checkpoint::best_checkpoint;
use scenesplat_trainers::{
    AdamW, AdamWConfig, AfterStep, CosineSchedule, Criterion, DataModule, Evaluator, Event, Flow,
    KeywordGroup, OneCycle, Progress, StepContext, StepOutput, TrainError, Trainer, TrainerConfig,
    TrainingModule, WithWeightDecay, group_by_keyword,
};
use std::sync::{Arc, Mutex};

/// Not small beside the gradients, or Adam would hide their scale: that of all together cancels.
const EPS: f64 = 0.05;

/// What one micro-batch was told: step, planned steps, progress, seed.
type Told = (u64, u64, f64, u64);

/// Writes down the parameters after each step, and what each batch was told.
struct Traced {
    line: Line,
    after: Mutex<Vec<[f64; 5]>>,
    told: Mutex<Vec<Told>>,
    /// Places of batches (in the order of their coming) that hold nothing.
    empty: Vec<usize>,
    came: Mutex<usize>,
}

impl Traced {
    fn new() -> Self {
        let line = Line { noise: 0.0, ..Line::new() };
        let (after, told) = (Mutex::default(), Mutex::default());
        Self { line, after, told, empty: Vec::new(), came: Mutex::new(0) }
    }

    /// Weights 0..4, bias 4.
    fn values(&self) -> [f64; 5] {
        let params = self.line.params.parameters();
        let all = [flat(&params["weight"]), flat(&params["bias"])].concat();
        std::array::from_fn(|i| f64::from(all[i]))
    }
}

impl TrainingModule for Traced {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.line.params
    }
    fn training_step(&self, batch: &Rows, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        self.told.lock().unwrap().push((cx.step, cx.total_steps, cx.progress, cx.seed));
        self.line.training_step(batch, cx)
    }
    fn after_step(&self, cx: &AfterStep<'_>) -> std::result::Result<(), TrainError> {
        assert_eq!(cx.step as usize, self.after.lock().unwrap().len());
        self.after.lock().unwrap().push(self.values());
        Ok(())
    }
    fn is_empty(&self, _: &Rows) -> bool {
        let mut came = self.came.lock().unwrap();
        *came += 1;
        self.empty.contains(&(*came - 1))
    }
}

/// Everything that decides the numbers.
#[derive(Clone)]
struct Settings {
    epochs: u64,
    accumulate: u64,
    clip: Option<f64>,
    lr: f64,
    bias_lr: f64,
    decay: f64,
    decay_to: Option<f64>,
    ema: f64,
    warmup: f64,
    empty: Vec<usize>,
}

fn settings() -> Settings {
    Settings {
        epochs: 4,
        accumulate: 2,
        clip: Some(0.4),
        lr: 0.05,
        bias_lr: 0.02,
        decay: 0.3,
        decay_to: None,
        ema: 0.4,
        warmup: 0.3,
        empty: Vec::new(),
    }
}

/// Half a cosine from `a` to `b`.
fn anneal(a: f64, b: f64, part: f64) -> f64 {
    a + (b - a) * (1.0 - (std::f64::consts::PI * part).cos()) / 2.0
}

/// Parameters after each step, and their average at the end.
fn by_hand(s: &Settings, start: [f64; 5], data: Numbers) -> (Vec<[f64; 5]>, [f64; 5]) {
    let steps_per_epoch = 7 / s.accumulate;
    let total = s.epochs * steps_per_epoch;
    let (mut p, mut m, mut v, mut average) = (start, [0.0; 5], [0.0; 5], start);
    let (mut after, mut came, mut t) = (Vec::new(), 0, 0);
    for epoch in 0..s.epochs {
        let batches: Vec<Rows> = (0..7).map(|place| data.batch(epoch, place)).collect();
        for k in 0..steps_per_epoch {
            let n = epoch * steps_per_epoch + k;
            let (mut g, mut some) = ([0.0; 5], false);
            for batch in &batches[(k * s.accumulate) as usize..((k + 1) * s.accumulate) as usize] {
                came += 1;
                if s.empty.contains(&(came - 1)) {
                    continue;
                }
                some = true;
                for row in batch {
                    let x: Vec<f64> = row.iter().map(|v| f64::from(*v)).chain([1.0]).collect();
                    let target = 0.5 * x[..4].iter().sum::<f64>();
                    let residual = x.iter().zip(&p).map(|(x, p)| x * p).sum::<f64>() - target;
                    for i in 0..5 {
                        g[i] += 2.0 * residual * x[i] / batch.len() as f64 / s.accumulate as f64;
                    }
                }
            }
            if let Some(clip) = s.clip {
                let norm = g.iter().map(|g| g * g).sum::<f64>().sqrt();
                g = g.map(|g| g * (clip / (norm + 1e-6)).min(1.0));
            }
            let (turn, last) = (s.warmup * total as f64 - 1.0, total as f64 - 1.0);
            let n_ = n as f64;
            let (rate, beta1) = if n_ <= turn {
                (anneal(0.1, 1.0, n_ / turn), anneal(0.95, 0.85, n_ / turn))
            } else {
                let part = (n_ - turn) / (last - turn);
                (anneal(1.0, 1e-4, part), anneal(0.85, 0.95, part))
            };
            let decay = s.decay_to.map_or(s.decay, |to| anneal(0.04, to, n_ / total as f64));
            // A step without any gradient is none for the optimizer.
            t += i32::from(some);
            for i in (0..5).filter(|_| some) {
                let eta = rate * if i == 4 { s.bias_lr } else { s.lr };
                m[i] += (1.0 - beta1) * (g[i] - m[i]);
                v[i] = 0.999 * v[i] + 0.001 * g[i] * g[i];
                let root = (v[i] / (1.0 - 0.999f64.powi(t))).sqrt() + EPS;
                p[i] -= eta * decay * p[i];
                p[i] -= eta * m[i] / (1.0 - beta1.powi(t)) / root;
            }
            let d = s.ema.min((1.0 + n_) / (10.0 + n_));
            average = std::array::from_fn(|i| d * average[i] + (1.0 - d) * p[i]);
            after.push(p);
        }
    }
    (after, average)
}

fn by_trainer(s: &Settings) -> (Traced, Trainer) {
    let module = Traced { empty: s.empty.clone(), ..Traced::new() };
    let rules = [KeywordGroup { keyword: "bias".to_owned(), lr: s.bias_lr }];
    let groups = group_by_keyword(&module.line.params.parameters(), s.lr, s.decay, &rules);
    let adamw = AdamWConfig { eps: EPS, ..AdamWConfig::default() };
    let optimizer = Box::new(AdamW::new(groups, adamw).unwrap());
    let rate = OneCycle { warmup: s.warmup, ..OneCycle::default() };
    let config = TrainerConfig {
        seed: 5,
        epochs: s.epochs,
        accumulate: s.accumulate,
        clip_norm: s.clip,
        ema: Some(s.ema),
        ..TrainerConfig::default()
    };
    let trainer = match s.decay_to {
        Some(to) => {
            let decay = CosineSchedule::new(0.04, to);
            Trainer::new(config, optimizer, Box::new(WithWeightDecay { rate, decay }))
        }
        None => Trainer::new(config, optimizer, Box::new(rate)),
    };
    (module, trainer.unwrap())
}

#[track_caller]
fn assert_close(got: &[f64; 5], want: &[f64; 5], what: &str) {
    for i in 0..5 {
        // f32 against f64, over some twenty steps.
        let allowed = 2e-5 * want[i].abs().max(1.0);
        assert!((got[i] - want[i]).abs() < allowed, "{what}: {got:?}, by hand {want:?}");
    }
}

fn check(s: &Settings, what: &str) {
    let (module, mut trainer) = by_trainer(s);
    let (after, average) = by_hand(s, module.values(), numbers());
    let at = trainer.fit(&module, &mut DataModule::new(numbers()), Progress::default()).unwrap();
    let got = module.after.lock().unwrap().clone();
    assert_eq!((at.step as usize, got.len()), (after.len(), after.len()), "{what}");
    for (n, (got, want)) in got.iter().zip(&after).enumerate() {
        assert_close(got, want, &format!("{what}: after step {n}"));
    }
    let averaged = trainer.with_average(&module.line.params, || Ok(module.values())).unwrap();
    assert_close(&averaged, &average, &format!("{what}: average"));
}

#[test]
fn every_step_is_the_one_computed_by_hand() {
    check(&settings(), "two batches a step");
    check(&Settings { accumulate: 1, ..settings() }, "one batch a step");
    check(&Settings { accumulate: 3, clip: None, ..settings() }, "three, unclipped");
    check(&Settings { clip: Some(1e3), ..settings() }, "a clip that does not bite");
    check(&Settings { decay_to: Some(0.4), ..settings() }, "scheduled decay");
    check(&Settings { empty: vec![1, 6, 7], ..settings() }, "empty batches count as zeros");
}

#[test]
fn the_reference_itself_can_tell() {
    // Each of these is a slip that a loop could make; by hand it must be another number.
    let start = Traced::new().values();
    let (after, average) = by_hand(&settings(), start, numbers());
    for (what, other) in [
        ("accumulation", Settings { accumulate: 1, ..settings() }),
        ("clipping", Settings { clip: None, ..settings() }),
        ("groups", Settings { bias_lr: 0.05, ..settings() }),
        ("decay", Settings { decay: 0.0, ..settings() }),
        ("warm-up", Settings { warmup: 0.4, ..settings() }),
    ] {
        let changed = by_hand(&other, start, numbers()).0;
        let apart = (0..5).any(|i| (changed[2][i] - after[2][i]).abs() > 1e-3);
        assert!(apart, "{what}");
    }
    let other = by_hand(&Settings { ema: 0.3, ..settings() }, start, numbers()).1;
    assert!((0..5).any(|i| (other[i] - average[i]).abs() > 1e-3));
}

#[test]
fn batches_are_told_step_progress_and_a_seed_of_their_own() {
    let (module, trainer) = by_trainer(&settings());
    fit(trainer, &module, numbers()).unwrap();
    let told = module.told.lock().unwrap();
    // 4 epochs of 3 steps of 2 batches; the seventh batch of each epoch is left over.
    assert_eq!(told.len(), 24);
    for (i, (step, total, progress, _)) in told.iter().enumerate() {
        assert_eq!((*step, *total), (i as u64 / 2, 12));
        assert_eq!(*progress, *step as f64 / 12.0);
    }
    let seeds: std::collections::BTreeSet<u64> = told.iter().map(|t| t.3).collect();
    assert_eq!(seeds.len(), 24);
}

/// Best step and value, the steps of evaluations, and the last step.
fn judged(
    a: &[f64],
    b: &[f64],
    best: Criterion,
    smaller: bool,
    patience: u64,
    every: u64,
) -> (u64, f64, Vec<u64>, u64) {
    let dir = tempfile::tempdir().unwrap();
    let module = Traced::new();
    let mut config = TrainerConfig { epochs: 6, eval_every: every, ..TrainerConfig::default() };
    config.checkpoint.dir = Some(dir.path().to_owned());
    config.checkpoint.best = Some(best.clone());
    config.checkpoint.smaller_is_better = smaller;
    let (mut evaluated, mut a, mut b) = (Vec::new(), a.iter(), b.iter());
    let mut next_of_a = |_: &Traced, at: Progress| {
        evaluated.push(at.step);
        *a.next().unwrap()
    };
    let mut data = DataModule::new(numbers())
        .with_evaluator(Score("a", &mut next_of_a))
        .with_evaluator(Score("b", |_: &Traced, _: Progress| *b.next().unwrap()));
    let mut trainer = trainer_by(&module, config, 0.01, 0.0, OneCycle::default())
        .with_callback(EarlyStopping::new(best, patience, smaller));
    let end = trainer.fit(&module, &mut data, Progress::default()).unwrap().step;
    drop(data);
    let best = best_checkpoint(dir.path()).unwrap().unwrap();
    let step = best.checkpoint.trim_start_matches("step-").parse().unwrap();
    (step, best.value, evaluated, end)
}

#[test]
fn the_best_state_and_the_end_follow_from_the_measurements() {
    let a = [0.1, 0.5, 0.2, 0.5, 0.4, 0.9];
    let b = [0.9, 0.1, 0.9, 0.3, 0.1, 0.0];
    let steps = |n: u64| (1..=n).map(|e| e * 7).collect::<Vec<_>>();
    // Larger is better; an equal value is no better; three in a row without a better one end it.
    assert_eq!(judged(&a, &b, "a/value".into(), false, 3, 1), (14, 0.5, steps(5), 35));
    assert_eq!(judged(&a, &b, "a/value".into(), false, 4, 1), (42, 0.9, steps(6), 42));
    assert_eq!(judged(&a, &b, "a/value".into(), true, 2, 1), (7, 0.1, steps(3), 21));
    assert_eq!(judged(&a, &b, "b/value".into(), true, 9, 1), (42, 0.0, steps(6), 42));
    let mean = Criterion::Mean(vec!["a/value".into(), "b/value".into()]);
    // Means: 0.5, 0.3, 0.55, 0.4, 0.25, 0.45.
    assert_eq!(judged(&a, &b, mean.clone(), false, 3, 1), (21, 0.55, steps(6), 42));
    assert_eq!(judged(&a, &b, mean.clone(), true, 2, 1).0, 14);
    assert_eq!(judged(&a, &b, mean, true, 3, 1).0, 35);
    // Every second epoch.
    assert_eq!(judged(&a, &b, "a/value".into(), false, 9, 2), (28, 0.5, vec![14, 28, 42], 42));
    // After the last epoch in any case.
    assert_eq!(judged(&a, &b, "a/value".into(), false, 9, 4), (42, 0.5, vec![28, 42], 42));
}

#[test]
fn unknown_measurements_are_refused_before_the_first_step() {
    let run = |best: &str, stopping: &str| {
        let module = Traced::new();
        let mut config = TrainerConfig::default();
        config.checkpoint.best = Some(best.into());
        let zero = Score("a", |_: &Traced, _: Progress| 0.0);
        let error = trainer_by(&module, config, 0.01, 0.0, OneCycle::default())
            .with_callback(EarlyStopping::new(stopping, 1, false))
            .fit(&module, &mut DataModule::new(numbers()).with_evaluator(zero), Progress::default())
            .err();
        assert!(error.is_none() || module.told.lock().unwrap().is_empty(), "no step was taken");
        error.map(|e| e.to_string())
    };
    assert_eq!(run("a/value", "a/value"), None);
    let error = run("a/valeu", "a/value").unwrap();
    assert!(error.contains("checkpoint.best") && error.contains("there are a/value"), "{error}");
    let error = run("a/value", "b/value").unwrap();
    assert!(error.contains("early_stopping.measurement"), "{error}");
    assert!(error.contains("\"b/value\"") && error.contains("there are a/value"), "{error}");
}

/// Gives a name that it does not list.
struct Liar;
impl Evaluator<Traced> for Liar {
    fn name(&self) -> &str {
        "liar"
    }
    fn measurements(&self) -> Vec<String> {
        Vec::new()
    }
    fn run(
        &mut self,
        _: &Traced,
        _: Progress,
    ) -> std::result::Result<Vec<Measurement>, TrainError> {
        Ok(vec![Measurement::new("truth", 1.0)])
    }
}

#[test]
fn evaluators_keep_to_their_names() {
    let error = |data: DataModule<'_, Traced>| {
        let (module, mut trainer) = by_trainer(&settings());
        trainer.fit(&module, &mut { data }, Progress::default()).unwrap_err()
    };
    let one = || DataModule::new(numbers()).with_evaluator(Liar);
    let unlisted = error(one());
    assert!(matches!(unlisted, TrainError::UnlistedMeasurement { .. }), "{unlisted}");
    let twice = error(one().with_evaluator(Liar));
    assert!(matches!(twice, TrainError::DuplicateName { .. }), "{twice}");
}

#[test]
fn steps_and_epochs_are_counted_as_promised() {
    let (module, counted) = (Traced::new(), Arc::new(Mutex::new(Vec::new())));
    let config = TrainerConfig { epochs: 2, log_every: 5, ..TrainerConfig::default() };
    let noted = Arc::clone(&counted);
    let trainer = trainer_by(&module, config, 0.01, 0.0, OneCycle::default()).with_callback(Watch(
        move |event: &Event<'_>, at: Progress| {
            if let Event::Step { .. } = event {
                noted.lock().unwrap().push((at.step, at.epoch));
            }
            Flow::Continue
        },
    ));
    fit(trainer, &module, numbers()).unwrap();
    // Each fifth step, and the last.
    assert_eq!(*counted.lock().unwrap(), [(5, 0), (10, 1), (14, 1)]);
}

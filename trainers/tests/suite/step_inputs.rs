//! What a step is given, and what is said of it: random numbers, recomputation, frozen statistics,
//! logged values, looks at the features. Each against numbers written down here.

use crate::support::{
    Batches, Line, PerVoxel, Rows, Watch, config, fit, flat, names_in, numbers, trainer, trainer_by,
};
use candle_core::{DType, Device, Result, Tensor};
use rand_chacha::rand_core::RngCore;
use scenesplat_datasets::TrainBatch;
use scenesplat_losses::{Loss, LossInput, Objective};
use scenesplat_metrics::Measurement;
use scenesplat_models::ParamStore;
use scenesplat_models::layers::BatchNorm;
use scenesplat_trainers::tasks::{SemanticSegmentation, TaskModule};
use scenesplat_trainers::{
    Event, Flow, OneCycle, Progress, StepContext, StepOutput, TrainerConfig, TrainingModule,
};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

/// What one batch was given: the first random number, and whether inner values shall be computed again.
type Given = (u64, bool);

/// A line that writes down what it is given, with a statistic that every step moves and a batch norm
/// before it.
struct Watched {
    line: Line,
    /// Named as the statistics of a batch norm are; nobody but this module moves it.
    moving: Tensor,
    norm: BatchNorm,
    given: Mutex<Vec<Given>>,
    /// Rows before and after the batch norm.
    normed: Mutex<Vec<(Vec<f32>, Vec<f32>)>>,
    losses: Mutex<Vec<f64>>,
}

impl Watched {
    fn new() -> Self {
        let line = Line { noise: 0.0, ..Line::new() };
        let vb = line.params.builder();
        let zero = candle_nn::Init::Const(0.0);
        let moving = vb.pp("own").get_with_hints(1, "running_mean", zero).unwrap();
        let norm = BatchNorm::new(4, vb.pp("norm")).unwrap();
        let of = |name: &str, values: [f32; 4]| {
            let values = Tensor::new(&values, &Device::Cpu).unwrap();
            line.params.buffers()[name].set(&values).unwrap();
        };
        of("norm.running_mean", [0.5, -0.5, 0.25, 0.0]);
        of("norm.running_var", [4.0, 1.0, 0.25, 9.0]);
        let (given, normed, losses) = Default::default();
        Self { line, moving, norm, given, normed, losses }
    }

    fn buffer(&self, name: &str) -> Vec<f32> {
        flat(&self.line.params.buffers()[name])
    }
}

impl TrainingModule for Watched {
    type Batch = Rows;
    fn params(&self) -> &ParamStore {
        &self.line.params
    }
    fn training_step(&self, batch: &Rows, cx: &mut StepContext<'_>) -> Result<StepOutput> {
        let first = cx.forward.rng.next_u64();
        self.given.lock().unwrap().push((first, cx.forward.recompute.is_some()));
        // As a layer of someone else would, who knows nothing of freezing.
        let moved = (self.moving.detach() + 1.0)?;
        self.line.params.buffers()["own.running_mean"].set(&moved)?;
        let x = Tensor::from_vec(batch.concat(), (batch.len(), 4), &Device::Cpu)?;
        let y = self.norm.forward(&x, self.norm.mode(&cx.forward))?;
        self.normed.lock().unwrap().push((flat(&x), flat(&y)));
        let out = y.matmul(&self.line.weight)?.broadcast_add(&self.line.bias)?;
        let loss = (out - x.sum_keepdim(1)?)?.sqr()?.mean_all()?;
        self.losses.lock().unwrap().push(f64::from(loss.to_scalar::<f32>()?));
        let rows = batch.len();
        let features = Some(Tensor::ones((8, 3), DType::F32, &Device::Cpu)?);
        Ok(StepOutput { loss, rows, counted_rows: rows, terms: Vec::new(), features })
    }
}

/// Measurements of steps, and steps with an alarm.
type Log = Arc<Mutex<(Vec<(u64, Measurement)>, Vec<u64>)>>;

fn run(settings: TrainerConfig) -> (Watched, Log) {
    let (module, log) = (Watched::new(), Log::default());
    let noted = Arc::clone(&log);
    let trainer = trainer_by(&module, settings, 0.01, 0.0, OneCycle::default()).with_callback(
        Watch(move |event: &Event<'_>, at: Progress| {
            let (steps, alarms) = &mut *noted.lock().unwrap();
            match event {
                Event::Step { measurements } => {
                    steps.extend(measurements.iter().map(|m| (at.step, m.clone())));
                }
                Event::Alarm { .. } => alarms.push(at.step),
                _ => {}
            }
            Flow::Continue
        }),
    );
    fit(trainer, &module, numbers()).unwrap();
    (module, log)
}

fn settings() -> TrainerConfig {
    TrainerConfig { epochs: 3, log_every: 1, ..TrainerConfig::default() }
}

#[test]
fn every_batch_has_random_numbers_of_its_own_and_of_the_seed() {
    let drawn = |seed| {
        let (module, _) = run(TrainerConfig { seed, ..settings() });
        let given = module.given.lock().unwrap();
        given.iter().map(|(first, _)| *first).collect::<Vec<_>>()
    };
    let first = drawn(3);
    // Seven batches in each of three epochs.
    assert_eq!(first.iter().collect::<BTreeSet<_>>().len(), 21, "{first:?}");
    assert_eq!(first, drawn(3));
    let other = drawn(4);
    assert!(first.iter().all(|number| !other.contains(number)), "another seed, other numbers");
}

#[test]
fn recomputation_is_asked_for_if_it_is_set() {
    for recompute in [false, true] {
        let (module, _) = run(TrainerConfig { recompute, ..settings() });
        let given = module.given.lock().unwrap();
        assert!(given.iter().all(|(_, asked)| *asked == recompute));
    }
}

#[test]
fn frozen_statistics_stay_whoever_moves_them() {
    let (module, _) = run(settings());
    assert_eq!(module.buffer("own.running_mean"), [21.0], "one a batch");
    let (module, _) = run(TrainerConfig { freeze: vec!["own".to_owned()], ..settings() });
    assert_eq!(module.buffer("own.running_mean"), [0.0]);
}

#[test]
fn a_frozen_batch_norm_normalises_by_what_it_remembers() {
    let (mean, var) = ([0.5, -0.5, 0.25, 0.0], [4.0_f64, 1.0, 0.25, 9.0]);
    let by_hand = |x: &[f32]| -> Vec<f64> {
        let one =
            |(i, v): (usize, &f32)| (f64::from(*v) - mean[i % 4]) / (var[i % 4] + 1e-3).sqrt();
        x.iter().enumerate().map(one).collect()
    };
    let by_batch = |x: &[f32]| -> Vec<f64> {
        let rows = x.len() as f64 / 4.0;
        let column = |c: usize| x.iter().skip(c).step_by(4).map(|v| f64::from(*v));
        let stats: Vec<(f64, f64)> = (0..4)
            .map(|c| {
                let mean = column(c).sum::<f64>() / rows;
                (mean, column(c).map(|v| (v - mean).powi(2)).sum::<f64>() / rows)
            })
            .collect();
        let one = |(i, v): (usize, &f32)| {
            (f64::from(*v) - stats[i % 4].0) / (stats[i % 4].1 + 1e-3).sqrt()
        };
        x.iter().enumerate().map(one).collect()
    };
    let close = |got: &[f32], want: &[f64]| {
        got.iter().zip(want).all(|(g, w)| (f64::from(*g) - w).abs() < 1e-4 * w.abs().max(1.0))
    };
    for (freeze, reference) in [
        (Vec::new(), &by_batch as &dyn Fn(&[f32]) -> Vec<f64>),
        (vec!["norm".to_owned()], &by_hand),
    ] {
        let what = format!("{freeze:?}");
        let (module, _) = run(TrainerConfig { freeze, ..settings() });
        let normed = module.normed.lock().unwrap();
        // The first step: its scale and shift are still 1 and 0.
        let (x, y) = &normed[0];
        assert!(close(y, &reference(x)), "{what}: {y:?}, by hand {:?}", reference(x));
        let moved = module.buffer("norm.running_mean") != mean.map(|v| v as f32);
        assert_eq!(moved, what == "[]", "{what}");
    }
}

#[test]
fn the_logged_loss_is_the_mean_of_the_batches_of_a_step() {
    for accumulate in [1, 3] {
        let (module, log) = run(TrainerConfig { accumulate, ..settings() });
        let losses = module.losses.lock().unwrap();
        let log = log.lock().unwrap();
        let logged: Vec<f64> =
            log.0.iter().filter(|(_, m)| m.name == "train/loss").map(|(_, m)| m.value).collect();
        assert_eq!(logged.len(), losses.len() / accumulate as usize);
        for (step, got) in losses.chunks(accumulate as usize).zip(&logged) {
            let mean = step.iter().sum::<f64>() / step.len() as f64;
            assert!((mean - got).abs() < 1e-9, "{accumulate}: {got}, by hand {mean}");
        }
    }
}

#[test]
fn features_are_looked_at_as_often_as_it_says() {
    let looks = |every_steps, min_effective_rank| {
        let mut settings = settings();
        settings.health.every_steps = every_steps;
        settings.health.min_effective_rank = min_effective_rank;
        // Rows that are all alike.
        settings.health.max_centred_cosine = 2.0;
        let (_, log) = run(settings);
        let (steps, alarms) = &*log.lock().unwrap();
        let seen = steps.iter().filter(|(_, m)| m.name.starts_with("health/"));
        let seen: BTreeSet<u64> = seen.map(|(step, _)| *step).collect();
        (seen, alarms.iter().copied().collect::<BTreeSet<u64>>())
    };
    // Of 21 steps; and after the last.
    assert_eq!(looks(8, 0.0), ([8, 16, 21].into(), [].into()));
    assert_eq!(looks(0, 0.0).0, [].into());
}

/// A loss that writes down its seeds.
#[derive(Clone, Default)]
struct Seeds(Arc<Mutex<Vec<u64>>>);
impl Loss for Seeds {
    fn name(&self) -> &str {
        "seeds"
    }
    fn forward(&self, input: &LossInput<'_>) -> Result<Option<Tensor>> {
        self.0.lock().unwrap().push(input.seed);
        Ok(Some(input.pred.sqr()?.mean_all()?))
    }
}

/// A batch of four voxels.
fn voxels(_: u64, _: usize) -> TrainBatch {
    TrainBatch {
        coord: vec![[0.0; 3]; 4],
        feat: (0..44).map(|i| i as f32 / 44.0).collect(),
        channels: 11,
        grid_coord: (0..4).map(|i| [i, 0, 0]).collect(),
        offsets: vec![0, 4],
        segment: Some(vec![0, 1, 2, -1]),
        ids: vec!["voxels".to_owned()],
        ..TrainBatch::default()
    }
}

#[test]
fn losses_that_draw_get_another_seed_each_batch() {
    let drawn = |seed| {
        let params = ParamStore::trainable(1);
        let model = PerVoxel::new(&params, 3);
        let loss = Seeds::default();
        let objective = Objective::new().with(1.0, loss.clone());
        let module = TaskModule::new(params, model, objective, SemanticSegmentation);
        let trainer = trainer(&module, TrainerConfig { seed, ..settings() });
        fit(trainer, &module, Batches(2, voxels)).unwrap();
        loss.0.lock().unwrap().clone()
    };
    let first = drawn(1);
    assert_eq!(first.iter().collect::<BTreeSet<_>>().len(), 6, "{first:?}");
    assert!(drawn(2).iter().all(|seed| !first.contains(seed)));
}

#[test]
fn as_many_checkpoints_stay_as_it_says() {
    let kept = |keep: usize, every_steps: u64| -> Vec<String> {
        let dir = tempfile::tempdir().unwrap();
        let mut settings = config(Some(dir.path()));
        settings.checkpoint.keep = keep;
        settings.checkpoint.every_steps = every_steps;
        let module = Line::new();
        fit(trainer(&module, settings), &module, numbers()).unwrap();
        names_in(dir.path(), "step-")
    };
    // Four epochs of seven steps.
    let steps = |list: &[u64]| list.iter().map(|s| format!("step-{s:09}")).collect::<Vec<_>>();
    assert_eq!(kept(1, 0), steps(&[28]));
    assert_eq!(kept(3, 0), steps(&[14, 21, 28]));
    assert_eq!(kept(9, 0), steps(&[7, 14, 21, 28]));
    assert_eq!(kept(9, 10), steps(&[10, 20, 28]));
}

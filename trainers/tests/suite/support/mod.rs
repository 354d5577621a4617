//! Modules, data, callbacks and evaluators that several tests use.

mod line;
mod rooms;

pub use line::{Line, Numbers, Rows, numbers};
pub use rooms::{PerVoxel, batch_of, dataset, loader, rooms, texts, views};

use candle_core::{DType, Device, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scenesplat_datasets::{BatchLoader, DataError};
use scenesplat_metrics::Measurement;
use scenesplat_models::{Forward, ParamStore};
use scenesplat_test_support::Golden;
use scenesplat_trainers::callbacks::{LoggedValue, read_json_lines};
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::{
    AdamW, AdamWConfig, Callback, DataModule, Evaluator, Event, Flow, OneCycle, Progress, Schedule,
    StepContext, TrainError, Trainer, TrainerConfig, TrainingModule, group_by_keyword,
};
use std::path::Path;

pub fn values(tensor: &Tensor) -> Vec<f64> {
    let flat = tensor.flatten_all().and_then(|t| t.to_dtype(DType::F64));
    flat.and_then(|t| t.to_vec1()).unwrap()
}

pub fn flat(tensor: &Tensor) -> Vec<f32> {
    let flat = tensor.flatten_all().and_then(|t| t.to_dtype(DType::F32));
    flat.and_then(|t| t.to_vec1()).unwrap()
}

/// Everything that training changes in a store, by name: parameters, then batch statistics.
pub fn state(store: &ParamStore) -> Vec<(String, Vec<f32>)> {
    let all = store.parameters().into_iter().chain(store.buffers());
    all.map(|(name, var): (String, Var)| (name, flat(&var))).collect()
}

/// The state of a module's parameters and further stores.
pub fn everything(module: &impl TrainingModule) -> Vec<(String, Vec<f32>)> {
    let further = module.stores().into_iter().flat_map(|(store, params)| {
        state(params).into_iter().map(move |(name, v)| (format!("{store}/{name}"), v))
    });
    state(module.params()).into_iter().chain(further).collect()
}

/// Four epochs with a log of every step.
pub fn config(dir: Option<&Path>) -> TrainerConfig {
    let mut config = TrainerConfig { seed: 5, epochs: 4, log_every: 1, ..Default::default() };
    config.checkpoint.dir = dir.map(Path::to_owned);
    config
}

/// AdamW at one rate and weight decay.
pub fn adamw(params: &ParamStore, lr: f64, decay: f64) -> Box<AdamW> {
    let groups = group_by_keyword(&params.parameters(), lr, decay, &[]);
    Box::new(AdamW::new(groups, AdamWConfig::default()).unwrap())
}

/// AdamW at a rate of 0.05 and a decay of 0.01, by one cycle.
pub fn trainer(module: &impl TrainingModule, config: TrainerConfig) -> Trainer {
    trainer_by(module, config, 0.05, 0.01, OneCycle::default())
}

pub fn trainer_by(
    module: &impl TrainingModule,
    config: TrainerConfig,
    lr: f64,
    decay: f64,
    schedule: impl Schedule + 'static,
) -> Trainer {
    Trainer::new(config, adamw(module.params(), lr, decay), Box::new(schedule)).unwrap()
}

/// A whole run without evaluators.
pub fn fit<M: TrainingModule>(
    mut trainer: Trainer,
    module: &M,
    data: impl BatchLoader<M::Batch>,
) -> Result<Progress, TrainError> {
    trainer.fit(module, &mut DataModule::new(data), Progress::default())
}

/// Where the newest checkpoint of a folder lets a run go on.
pub fn load<M: TrainingModule>(trainer: &mut Trainer, dir: &Path, module: &M) -> Progress {
    trainer.load_checkpoint(&newest_checkpoint(dir).unwrap().unwrap(), module).unwrap()
}

/// Goes on from the newest checkpoint of a folder.
pub fn resume<M: TrainingModule>(
    mut trainer: Trainer,
    dir: &Path,
    module: &M,
    data: impl BatchLoader<M::Batch>,
) -> Progress {
    let start = load(&mut trainer, dir, module);
    trainer.fit(module, &mut DataModule::new(data), start).unwrap()
}

/// Runs `f` in step 0 of 10, with a generator of seed 1.
pub fn in_step<R>(f: impl FnOnce(&mut StepContext<'_>) -> R) -> R {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let forward = Forward::train(&mut rng);
    f(&mut StepContext { forward, progress: 0.0, step: 0, total_steps: 10, seed: 9 })
}

/// An error with its causes.
pub fn causes(error: &TrainError) -> String {
    let causes =
        std::iter::successors(Some(error as &dyn std::error::Error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

/// The values of a log of this name, with their steps.
pub fn logged(log: &Path, name: &str) -> Vec<(u64, f64)> {
    let of_name = |v: &LoggedValue| v.name == name;
    read_json_lines(log).unwrap().into_iter().filter(of_name).map(|v| (v.step, v.value)).collect()
}

/// Names in a folder that begin so, sorted.
pub fn names_in(folder: &Path, prefix: &str) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| name.starts_with(prefix));
    names.sort();
    names
}

/// A function as a callback.
pub struct Watch<F>(pub F);

impl<F: FnMut(&Event<'_>, Progress) -> Flow + Send> Callback for Watch<F> {
    fn on_event(&mut self, event: &Event<'_>, at: Progress) -> Result<Flow, TrainError> {
        Ok((self.0)(event, at))
    }
}

/// Asks to stop after a number of steps.
pub fn stop_at(step: u64) -> impl Callback {
    Watch(move |event: &Event<'_>, at: Progress| {
        let stop = matches!(event, Event::Step { .. }) && at.step >= step;
        if stop { Flow::Stop } else { Flow::Continue }
    })
}

/// A function as an evaluator of this name with the one measurement `value`.
pub struct Score<F>(pub &'static str, pub F);

impl<M, F: FnMut(&M, Progress) -> f64 + Send> Evaluator<M> for Score<F> {
    fn name(&self) -> &str {
        self.0
    }
    fn measurements(&self) -> Vec<String> {
        vec!["value".to_owned()]
    }
    fn run(&mut self, module: &M, at: Progress) -> Result<Vec<Measurement>, TrainError> {
        Ok(vec![Measurement::new("value", (self.1)(module, at))])
    }
}

/// A function of epoch and place as a loader of so many batches.
pub struct Batches<F>(pub usize, pub F);

impl<B, F: FnMut(u64, usize) -> B> BatchLoader<B> for Batches<F> {
    fn batches_per_epoch(&self) -> usize {
        self.0
    }
    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<B, DataError>> + '_> {
        let make = &mut self.1;
        Box::new((skip..self.0).map(move |place| Ok(make(epoch, place))))
    }
}

/// A tensor of reference numbers.
pub fn tensor(golden: &Golden, name: &str) -> Tensor {
    Tensor::from_vec(golden.f32s(name), golden.shape(name), &Device::Cpu).unwrap()
}

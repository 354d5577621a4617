//! One training, watched step by step.

use super::recipe::{StabilityRecipe, self_supervised};
use super::report::StabilityRun;
use super::setup::{Form, Rooms, Setup, module};
use crate::doctor::trial::Failure;
use candle_core::DType;
use scenesplat_datasets::{BatchLoader, DataError, TrainBatch};
use scenesplat_models::ParamStore;
use scenesplat_trainers::{
    AdamW, AdamWConfig, Callback, DataModule, Event, Flow, OneCycle, Progress, TrainError, Trainer,
    TrainerConfig, TrainingModule, group_by_keyword,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Optimizer steps between two ends of an epoch.
const STEPS_PER_EPOCH: u64 = 20;
/// Looks at the features in the course of a training.
const LOOKS: u64 = 8;

/// What a training reported.
#[derive(Default)]
struct Seen {
    losses: Vec<f64>,
    /// Steps in which no row counted for the loss.
    idle: u64,
    rank: Option<f64>,
    cosine: Option<f64>,
    alarms: Vec<String>,
}

struct Watch(Arc<Mutex<Seen>>);

impl Callback for Watch {
    fn on_event(&mut self, event: &Event<'_>, _: Progress) -> Result<Flow, TrainError> {
        let mut seen = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match event {
            Event::Step { measurements } => {
                for measured in *measurements {
                    match measured.name.as_str() {
                        "train/loss" => seen.losses.push(measured.value),
                        "train/counted_rows" => seen.idle += u64::from(measured.value <= 0.0),
                        "health/effective_rank" => seen.rank = Some(measured.value),
                        "health/centred_cosine" => seen.cosine = Some(measured.value),
                        _ => {}
                    }
                }
            }
            Event::Alarm { message } => seen.alarms.push((*message).to_owned()),
            _ => {}
        }
        Ok(Flow::Continue)
    }
}

/// A loader that asks before each batch whether to go on.
struct Asked<'a, 'b> {
    rooms: Rooms,
    batches: u64,
    go_on: &'a mut (dyn FnMut(f64) -> bool + 'b),
    done: u64,
    stop: Arc<AtomicBool>,
}

impl BatchLoader<TrainBatch> for Asked<'_, '_> {
    fn batches_per_epoch(&self) -> usize {
        self.rooms.batches_per_epoch()
    }

    fn epoch(
        &mut self,
        epoch: u64,
        skip: usize,
    ) -> Box<dyn Iterator<Item = Result<TrainBatch, DataError>> + '_> {
        let Self { rooms, batches, go_on, done, stop } = self;
        Box::new(rooms.epoch(epoch, skip).inspect(move |_| {
            *done += 1;
            if !go_on(*done as f64 / *batches as f64) {
                stop.store(true, Ordering::SeqCst);
            }
        }))
    }
}

/// The trainer of all runs of a recipe.
pub(super) fn trainer(
    recipe: StabilityRecipe,
    module: &impl TrainingModule,
    config: TrainerConfig,
) -> Result<Trainer, Failure> {
    let (lr, rules) = recipe.rates();
    let groups = group_by_keyword(&module.params().parameters(), lr, 0.05, &rules);
    let optimizer = AdamW::new(groups, AdamWConfig::default())?;
    Ok(Trainer::new(config, Box::new(optimizer), Box::new(OneCycle::default()))?)
}

/// Trains; `None` if it was asked to stop. Steps are rounded up to whole epochs.
pub(super) fn train(
    setup: &Setup,
    steps: u64,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<StabilityRun>, Failure> {
    let Setup { recipe, precision, seed, .. } = *setup;
    match recipe {
        StabilityRecipe::LanguagePretraining => {
            train_module(&module(precision, seed)?, setup, steps, go_on)
        }
        StabilityRecipe::GaussianSsl
        | StabilityRecipe::SelfDistillation
        | StabilityRecipe::SimDinoRows => {
            train_module(&self_supervised(recipe, precision, seed)?, setup, steps, go_on)
        }
    }
}

fn config(setup: &Setup, epochs: u64, look_every: u64) -> TrainerConfig {
    let mut config = TrainerConfig {
        seed: setup.seed,
        epochs,
        accumulate: setup.form.accumulate(),
        clip_norm: Some(1.0),
        log_every: 1,
        recompute: setup.form == Form::Recomputed,
        ..TrainerConfig::default()
    };
    config.health.every_steps = look_every;
    config
}

fn train_module(
    module: &impl TrainingModule<Batch = TrainBatch>,
    setup: &Setup,
    steps: u64,
    go_on: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<StabilityRun>, Failure> {
    let began = Instant::now();
    let accumulate = setup.form.accumulate();
    let per_epoch = steps.min(STEPS_PER_EPOCH);
    let epochs = steps.div_ceil(per_epoch);
    let planned = epochs * per_epoch;
    let config = config(setup, epochs, planned.div_ceil(LOOKS));
    let in_epoch = per_epoch * accumulate;
    let (seen, stop) = (Arc::new(Mutex::new(Seen::default())), Arc::default());
    let loader = Asked {
        rooms: Rooms::new(setup.recipe, setup.batches, setup.seed, in_epoch as usize)?,
        batches: planned * accumulate,
        go_on,
        done: 0,
        stop: Arc::clone(&stop),
    };
    let ended = trainer(setup.recipe, module, config)?
        .with_callback(Watch(Arc::clone(&seen)))
        .with_stop(Arc::clone(&stop))
        .fit(module, &mut DataModule::new(loader), Progress::default());
    let mut problem = ended.as_ref().err().map(|error| with_causes(error));
    if ended.is_ok_and(|at| at.step < planned) {
        return Ok(None);
    }
    let seen = std::mem::take(&mut *seen.lock().unwrap_or_else(PoisonError::into_inner));
    if problem.is_none() {
        let stores = module.stores().into_iter().map(|(_, store)| store);
        problem = stores
            .chain([module.params()])
            .map(not_finite)
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .flatten()
            .next()
            .map(|name| format!("{name} is not finite"));
    }
    Ok(Some(StabilityRun::new(
        setup,
        planned,
        &seen.losses,
        seen.idle,
        [seen.rank, seen.cosine],
        seen.alarms,
        problem,
        began.elapsed().as_secs_f64(),
    )))
}

/// An error with everything behind it, without the frames that tensors add where `RUST_BACKTRACE` is set.
pub(super) fn with_causes(error: &dyn std::error::Error) -> String {
    let text = error.to_string();
    let words: Vec<&str> =
        text.lines().take_while(|l| !l.trim_start().starts_with("0: ")).collect();
    let text = words.join(" ");
    match error.source() {
        Some(source) => format!("{text}: {}", with_causes(source)),
        None => text,
    }
}

/// The first parameter or buffer with a value that is not finite.
fn not_finite(params: &ParamStore) -> Result<Option<String>, Failure> {
    for (name, var) in params.parameters().iter().chain(&params.buffers()) {
        let values = var.to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>()?;
        if values.iter().any(|v| !v.is_finite()) {
            return Ok(Some(name.clone()));
        }
    }
    Ok(None)
}

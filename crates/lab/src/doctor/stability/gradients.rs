//! Whether accumulation and recomputation change a gradient.

use super::recipe::StabilityRecipe;
use super::report::{GradientCheck, SAME};
use super::setup::{ACCUMULATED, Batches, Rooms, module};
use crate::doctor::trial::{Failure, ensure};
use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};
use scenesplat_kernels::Precision;
use scenesplat_trainers::{
    DataModule, OneCycle, Optimizer, Progress, StepHyperparameters, TrainError, Trainer,
    TrainerConfig, TrainingModule,
};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Gradients of each step, all parameters one after the other.
type Recorded = Arc<Mutex<Vec<Vec<f64>>>>;

/// Writes gradients down and moves nothing.
struct Recorder(BTreeMap<String, Var>, Recorded);

impl Optimizer for Recorder {
    fn step(&mut self, grads: &GradStore, _: &StepHyperparameters) -> Result<(), TrainError> {
        let forward = |source| TrainError::Forward { source };
        let mut all = Vec::new();
        for var in self.0.values() {
            let zeros;
            let grad = match grads.get(var) {
                Some(grad) => grad,
                None => {
                    zeros = var.zeros_like().map_err(forward)?;
                    &zeros
                }
            };
            let values = grad.to_dtype(DType::F64).and_then(|g| g.flatten_all()?.to_vec1::<f64>());
            all.extend(values.map_err(forward)?);
        }
        self.1.lock().unwrap_or_else(PoisonError::into_inner).push(all);
        Ok(())
    }

    fn state(&self) -> Result<BTreeMap<String, Tensor>, TrainError> {
        Ok(BTreeMap::new())
    }

    fn load_state(&mut self, _: &BTreeMap<String, Tensor>) -> Result<(), TrainError> {
        Ok(())
    }
}

/// Gradients of the same batches by the loop.
fn record(
    precision: Precision,
    batches: Batches,
    seed: u64,
    accumulate: u64,
    recompute: bool,
) -> Result<Vec<Vec<f64>>, Failure> {
    let module = module(precision, seed)?;
    let recorded = Recorded::default();
    let optimizer = Recorder(module.params().parameters(), Arc::clone(&recorded));
    let config = TrainerConfig { seed, accumulate, recompute, ..TrainerConfig::default() };
    let rooms =
        Rooms::new(StabilityRecipe::LanguagePretraining, batches, seed, ACCUMULATED as usize)?;
    Trainer::new(config, Box::new(optimizer), Box::new(OneCycle::default()))?.fit(
        &module,
        &mut DataModule::new(rooms),
        Progress::default(),
    )?;
    let found = std::mem::take(&mut *recorded.lock().unwrap_or_else(PoisonError::into_inner));
    Ok(found)
}

/// Both forms beside the plain one.
pub(super) fn compare(
    precision: Precision,
    batches: Batches,
    seed: u64,
) -> Result<[GradientCheck; 2], Failure> {
    let plain = record(precision, batches, seed, 1, false)?;
    let count = plain.len() as f64;
    ensure!(plain.len() as u64 == ACCUMULATED, "{} plain steps", plain.len());
    let mut mean = vec![0.0; plain[0].len()];
    for step in &plain {
        mean.iter_mut().zip(step).for_each(|(m, g)| *m += g / count);
    }
    let accumulated = record(precision, batches, seed, ACCUMULATED, false)?;
    ensure!(accumulated.len() == 1, "{} accumulated steps", accumulated.len());
    let recomputed = record(precision, batches, seed, 1, true)?;
    ensure!(recomputed.len() == plain.len(), "{} recomputed steps", recomputed.len());
    let check = |form: &str, relative: f64| GradientCheck {
        name: format!("{form}, {precision}, {} batches", batches.name()),
        relative,
        tolerance: SAME,
        passed: relative <= SAME,
    };
    let apart = recomputed.iter().zip(&plain).map(|(got, want)| distance(got, want));
    Ok([
        check("accumulated", distance(&accumulated[0], &mean)),
        check(
            "recomputed",
            apart.fold(0.0, |most: f64, d| if d > most || d.is_nan() { d } else { most }),
        ),
    ])
}

/// ‖a − b‖ / ‖b‖
pub(super) fn distance(got: &[f64], want: &[f64]) -> f64 {
    let apart = got.iter().zip(want).map(|(g, w)| (g - w).powi(2)).sum::<f64>().sqrt();
    apart / want.iter().map(|w| w * w).sum::<f64>().sqrt()
}

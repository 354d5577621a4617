//! A batch with a value that is not finite, in the middle of a training.

use super::recipe::StabilityRecipe;
use super::report::PoisonCheck;
use super::run::{trainer, with_causes};
use super::setup::{Batches, Rooms, module};
use crate::doctor::trial::{Failure, ensure};
use scenesplat_kernels::Precision;
use scenesplat_trainers::checkpoint::newest_checkpoint;
use scenesplat_trainers::{DataModule, Progress, TrainerConfig, TrainingModule};
use std::path::Path;

/// Steps of the training, and which one is poisoned.
const STEPS: usize = 8;
const POISONED: usize = 5;

/// Poisons a step, and goes on from the checkpoint before it.
pub(super) fn check(seed: u64, folder: &Path) -> Result<PoisonCheck, Failure> {
    let folder = folder.join("poison");
    let config = || {
        let mut config = TrainerConfig { seed, ..TrainerConfig::default() };
        config.checkpoint.dir = Some(folder.clone());
        config.checkpoint.every_steps = 1;
        config
    };
    let recipe = StabilityRecipe::LanguagePretraining;
    let rooms = |poisoned: Option<usize>| -> Result<Rooms, Failure> {
        Ok(Rooms::new(recipe, Batches::Even, seed, STEPS)?.poisoned_at(poisoned))
    };
    let clean = module(Precision::F32, seed)?;
    let plain = TrainerConfig { seed, ..TrainerConfig::default() };
    let data = |poisoned| rooms(poisoned).map(DataModule::new);
    trainer(recipe, &clean, plain)?.fit(&clean, &mut data(None)?, Progress::default())?;
    let hurt = module(Precision::F32, seed)?;
    let ended =
        trainer(recipe, &hurt, config())?.fit(&hurt, &mut data(Some(POISONED))?, <_>::default());
    let message = ended.err().map_or("went on".to_owned(), |error| with_causes(&error));
    let scene = rooms(None)?.name_of(POISONED)?;
    let words = [format!("step {POISONED}"), format!("{scene}: feat 3 of row 0 is NaN")];
    let named = words.iter().all(|word| message.contains(word));
    let newest = newest_checkpoint(&folder)?;
    let Some(newest) = newest else {
        return Err(Failure("the poisoned training left no checkpoint".to_owned()));
    };
    let healed = module(Precision::F32, seed)?;
    let mut again = trainer(recipe, &healed, config())?;
    let at = again.load_checkpoint(&newest, &healed)?;
    ensure!(at.step == POISONED as u64, "the newest checkpoint is of step {}", at.step);
    again.fit(&healed, &mut data(None)?, at)?;
    let recovered = values(&healed)? == values(&clean)?;
    std::fs::remove_dir_all(&folder)?;
    Ok(PoisonCheck { step: POISONED as u64, message, named, recovered })
}

/// Bits of all parameters and buffers.
fn values(module: &impl TrainingModule) -> Result<Vec<u32>, Failure> {
    let params = module.params();
    let mut all = Vec::new();
    for var in params.parameters().values().chain(params.buffers().values()) {
        let row = var.to_dtype(candle_core::DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
        all.extend(row.into_iter().map(f32::to_bits));
    }
    Ok(all)
}

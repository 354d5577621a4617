//! Level 3 at length: trainings of thousands of steps in every form that the loop has.
//!
//! {f32, bf16} × {even, uneven batches} × {plain, accumulated over 4, recomputed} × seeds on generated
//! rooms with a small network; then gradients of the forms beside each other, and a poisoned batch. Trainings
//! without labels have no such forms: {f32, bf16} × {even, uneven batches} × seeds of two recipes. There is
//! no f16 with a scaler: sums and parameters are f32 whatever the products are, so no step is skipped.

mod gradients;
mod poison;
mod recipe;
mod report;
mod run;
mod setup;

pub use recipe::StabilityRecipe;
pub use report::{GradientCheck, PoisonCheck, StabilityReport, StabilityRun};

use super::trial::Failure;
use scenesplat_kernels::Precision;
use setup::{Batches, Form, Setup};
use std::path::Path;
use std::time::Instant;

/// Which trainings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StabilitySettings {
    /// Optimizer steps of each, at least 1.
    pub steps: u64,
    /// Seeds of parameters, rooms and draws: each is a training of every form.
    pub seeds: Vec<u64>,
    /// What is learned, at least one; gradients of the forms and the poisoned batch belong to
    /// language pretraining.
    pub recipes: Vec<StabilityRecipe>,
}

impl Default for StabilitySettings {
    fn default() -> Self {
        Self { steps: 2000, seeds: vec![1, 2, 3], recipes: StabilityRecipe::ALL.to_vec() }
    }
}

/// Runs all trainings and checks. `go_on` gets the step under way and the share that is done before each step;
/// returning false cancels, and what is not finished is left out of the report, which says so.
///
/// `folder`: for the checkpoints of the poisoned run; nothing is left there.
///
/// # Errors
/// If there is no step, seed or recipe, or rooms, networks or checkpoints cannot be made. A training that fails is
/// no error here: the report names it.
pub fn stability(
    settings: &StabilitySettings,
    folder: &Path,
    go_on: &mut dyn FnMut(&str, f64) -> bool,
) -> Result<StabilityReport, Failure> {
    if settings.steps == 0 || settings.seeds.is_empty() || settings.recipes.is_empty() {
        let text = "a training has at least one step, one seed and one recipe";
        return Err(Failure(text.to_owned()));
    }
    let began = Instant::now();
    let all: Vec<Setup> = setups(&settings.recipes, &settings.seeds).collect();
    let (mut runs, mut stopped) = (Vec::new(), false);
    for (i, setup) in all.iter().enumerate() {
        let name = setup.name();
        let mut watch = |share: f64| go_on(&name, (i as f64 + share) / all.len() as f64);
        match run::train(setup, settings.steps, &mut watch)? {
            Some(run) => runs.push(run),
            None => {
                stopped = true;
                break;
            }
        }
    }
    let (mut gradients, mut poison) = (Vec::new(), None);
    let forms = settings.recipes.contains(&StabilityRecipe::LanguagePretraining);
    for precision in [Precision::F32, Precision::Bf16] {
        for batches in [Batches::Even, Batches::Uneven].into_iter().filter(|_| forms) {
            stopped |= !go_on("gradients of the forms", 1.0);
            if !stopped {
                gradients.extend(gradients::compare(precision, batches, settings.seeds[0])?);
            }
        }
    }
    stopped |= forms && !go_on("a poisoned batch", 1.0);
    if forms && !stopped {
        poison = Some(poison::check(settings.seeds[0], folder)?);
    }
    let seconds = began.elapsed().as_secs_f64();
    Ok(StabilityReport::new(settings, runs, gradients, poison, stopped, seconds))
}

/// Every form of every seed; without labels the plain one.
fn setups(recipes: &[StabilityRecipe], seeds: &[u64]) -> impl Iterator<Item = Setup> {
    let mut all = Vec::new();
    for &recipe in recipes {
        let forms: &[Form] = match recipe {
            StabilityRecipe::LanguagePretraining => {
                &[Form::Plain, Form::Accumulated, Form::Recomputed]
            }
            _ => &[Form::Plain],
        };
        for &seed in seeds {
            for precision in [Precision::F32, Precision::Bf16] {
                for batches in [Batches::Even, Batches::Uneven] {
                    for &form in forms {
                        all.push(Setup { recipe, precision, batches, form, seed });
                    }
                }
            }
        }
    }
    all.into_iter()
}

#[cfg(test)]
mod tests;

//! What the trainings came to.

use super::StabilitySettings;
use super::recipe::StabilityRecipe;
use super::setup::Setup;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Largest share of steps that may do nothing.
const MAY_SKIP: f64 = 0.005;
/// Least effective rank of the features, as a share of their width ...
const LEAST_RANK: f64 = 0.1;
/// ... from so many steps on; before, a network has not learnt to tell anything apart.
const RANK_FROM: u64 = 200;
/// What gradients of two forms may differ by, relative to their norm.
pub(super) const SAME: f64 = 1e-6;

/// One training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StabilityRun {
    /// What was learned.
    pub recipe: StabilityRecipe,
    /// Form of the numbers in products.
    pub precision: String,
    /// `even` or `uneven`: sizes of the scenes of a batch.
    pub batches: String,
    /// `plain`, `accumulated` or `recomputed`.
    pub form: String,
    /// Seed of parameters, rooms and draws.
    pub seed: u64,
    /// Optimizer steps that were planned.
    pub steps: u64,
    /// Steps whose loss was logged and finite.
    pub finite_steps: u64,
    /// Share of the steps that were not taken, or in which no row counted.
    pub skipped: f64,
    /// Mean loss of the first tenth of the steps.
    pub first_loss: f64,
    /// Mean loss of the last tenth.
    pub last_loss: f64,
    /// Effective rank of the features at the end.
    pub effective_rank: Option<f64>,
    /// Width of the features.
    pub width: usize,
    /// Mean cosine of features at the end, their mean taken off.
    pub centred_cosine: Option<f64>,
    /// Alarms about features and statistics.
    pub alarms: Vec<String>,
    /// Why it did not pass.
    pub problem: Option<String>,
    /// How long it took.
    pub seconds: f64,
}

impl StabilityRun {
    #[allow(clippy::too_many_arguments, reason = "what was seen, once")]
    pub(super) fn new(
        setup: &Setup,
        steps: u64,
        losses: &[f64],
        idle: u64,
        [effective_rank, centred_cosine]: [Option<f64>; 2],
        alarms: Vec<String>,
        problem: Option<String>,
        seconds: f64,
    ) -> Self {
        let finite_steps = losses.iter().filter(|loss| loss.is_finite()).count() as u64;
        let skipped = (steps - finite_steps.min(steps) + idle) as f64 / steps as f64;
        let part = losses.len().div_ceil(10);
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let mut run = Self {
            recipe: setup.recipe,
            precision: setup.precision.to_string(),
            batches: setup.batches.name().to_owned(),
            form: setup.form.name().to_owned(),
            seed: setup.seed,
            steps,
            finite_steps,
            skipped,
            first_loss: mean(&losses[..part]),
            last_loss: mean(&losses[losses.len() - part..]),
            effective_rank,
            width: setup.recipe.width(),
            centred_cosine,
            alarms,
            problem: None,
            seconds,
        };
        run.problem = problem.or_else(|| run.wrong());
        run
    }

    fn wrong(&self) -> Option<String> {
        if self.finite_steps < self.steps {
            return Some(format!("{} of {} losses are finite", self.finite_steps, self.steps));
        }
        if self.skipped >= MAY_SKIP {
            return Some(format!("{:.1} % of the steps did nothing", 100.0 * self.skipped));
        }
        if self.steps < RANK_FROM {
            return None;
        }
        let least = LEAST_RANK * self.width as f64;
        match self.effective_rank {
            Some(rank) if rank >= least => self.alarms.first().cloned(),
            Some(rank) => {
                Some(format!("the effective rank is {rank:.2}, at least {least} is expected"))
            }
            None => Some(format!("no effective rank, at least {least} is expected")),
        }
    }
}

/// Gradients of a form of the loop beside those of the plain one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GradientCheck {
    /// Form, precision and batches.
    pub name: String,
    /// Largest norm of a difference, relative to the norm of the plain gradients.
    pub relative: f64,
    /// What it may be.
    pub tolerance: f64,
    /// Whether it is not more.
    pub passed: bool,
}

/// A batch with a value that is not finite.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PoisonCheck {
    /// The step that it came in, from 0.
    pub step: u64,
    /// How the training ended there.
    pub message: String,
    /// Whether that names step, scene, attribute and row.
    pub named: bool,
    /// Whether the training that goes on from the checkpoint before it, with the batch as it should have
    /// been, ends with the bits of one that was never poisoned.
    pub recovered: bool,
}

/// What all of them came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StabilityReport {
    /// Steps that were asked for.
    pub steps: u64,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// What was learned.
    pub recipes: Vec<StabilityRecipe>,
    /// The trainings.
    pub runs: Vec<StabilityRun>,
    /// Gradients beside each other.
    pub gradients: Vec<GradientCheck>,
    /// The poisoned batch; `None` if it was stopped before.
    pub poison: Option<PoisonCheck>,
    /// Whether somebody ended it before it was done.
    pub stopped: bool,
    /// Trainings and checks that did not pass.
    pub failed: usize,
    /// How long all of it took.
    pub seconds: f64,
}

impl StabilityReport {
    pub(super) fn new(
        settings: &StabilitySettings,
        runs: Vec<StabilityRun>,
        gradients: Vec<GradientCheck>,
        poison: Option<PoisonCheck>,
        stopped: bool,
        seconds: f64,
    ) -> Self {
        let failed = runs.iter().filter(|run| run.problem.is_some()).count()
            + gradients.iter().filter(|check| !check.passed).count()
            + poison.iter().filter(|check| !(check.named && check.recovered)).count();
        let StabilitySettings { steps, seeds, recipes } = settings.clone();
        Self { steps, seeds, recipes, runs, gradients, poison, stopped, failed, seconds }
    }
}

impl fmt::Display for StabilityReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<17} {:<5} {:<6} {:<11} {:>4} {:>6} {:>15} {:>7} {:>9} {:>7} {:>7}",
            "",
            "",
            "batch",
            "form",
            "seed",
            "steps",
            "loss",
            "skipped",
            "rank",
            "cosine",
            "seconds"
        )?;
        for run in &self.runs {
            let of = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2}"));
            writeln!(
                f,
                "{:<17} {:<5} {:<6} {:<11} {:>4} {:>6} {:>15} {:>6.1}% {:>9} {:>7} {:>7.1}  {}",
                run.recipe.name(),
                run.precision,
                run.batches,
                run.form,
                run.seed,
                run.steps,
                format!("{:.3} → {:.3}", run.first_loss, run.last_loss),
                100.0 * run.skipped,
                format!("{}/{}", of(run.effective_rank), run.width),
                of(run.centred_cosine),
                run.seconds,
                run.problem.as_ref().map_or("ok".to_owned(), |why| format!("FAILED: {why}"))
            )?;
            for alarm in &run.alarms {
                writeln!(f, "      alarm: {alarm}")?;
            }
        }
        for GradientCheck { name, relative, tolerance, passed } in &self.gradients {
            let mark = if *passed { "ok" } else { "FAILED" };
            writeln!(f, "gradients {name}: {relative:.1e} of {tolerance:.0e}  {mark}")?;
        }
        if let Some(poison) = &self.poison {
            writeln!(f, "poisoned step {}: {}", poison.step, poison.message)?;
            let yes = |is: bool| if is { "yes" } else { "NO" };
            writeln!(f, "  named: {}; recovered: {}", yes(poison.named), yes(poison.recovered))?;
        }
        let end = if self.stopped { ", stopped before it was done" } else { "" };
        let count = self.runs.len();
        write!(f, "{count} trainings, {} failed, {:.1} s{end}", self.failed, self.seconds)
    }
}

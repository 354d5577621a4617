//! The time and the memory that a run may take.

use super::Args;
use super::frames::Frames;
use crate::session::Session;
use anyhow::Result;
use scenesplat::memory::{Bytes, can_reserve};
use scenesplat::optimisation::cost::{cap_of, memory_of, set_cap};
use scenesplat::optimisation::{
    Model, OptimiseSettings, Optimiser, StepCost, Strategy, TrainingFrame,
};
use std::time::Instant;

/// Steps that are timed; the first of each size is not.
const TIMED: usize = 4;

impl Args {
    /// Lowers the cap to what `--max-memory` holds. Refuses first Gaussians that no memory is there for: to run out of it
    /// later would end the program without a word.
    pub(super) fn bounded(
        &self,
        session: &Session<'_>,
        settings: OptimiseSettings,
        frames: &Frames,
    ) -> Result<OptimiseSettings> {
        let need = |gaussians: usize| memory_of(&settings, gaussians, &frames.train);
        let least = self.initial as usize;
        let first = need(least) - need(0);
        anyhow::ensure!(
            can_reserve(first),
            "--initial {least}: so many Gaussians need {}, which the system does not give this process; use a \
             smaller --initial",
            Bytes(first)
        );
        let (Some(limit), Some(cap)) = (self.max_memory, cap_of(&settings)) else {
            return Ok(settings);
        };
        anyhow::ensure!(
            need(least) <= limit.0,
            "--max-memory {limit}: the frames and {least} Gaussians need {}; use fewer or smaller \
             pictures, or a smaller --initial",
            Bytes(need(least))
        );
        let each = (need(cap) - need(0)) / cap.max(1) as u64;
        let most = ((limit.0 - need(0)) / each.max(1)) as usize;
        let mut out = settings;
        if most < cap {
            set_cap(&mut out, most.max(least));
            session
                .warn(format!("--max-memory {limit}: at most {most} Gaussians instead of {cap}"));
        }
        Ok(out)
    }

    /// Begins, with what the budget allows.
    pub(super) fn begin(
        &self,
        session: &Session<'_>,
        model: Model,
        frames: &Frames,
        settings: OptimiseSettings,
        began: Instant,
    ) -> Result<Optimiser> {
        let Some(budget) = self.budget else {
            return Ok(Optimiser::new(model, &frames.train, settings)?);
        };
        let _stage = session.receipt.stage("speed");
        let time = |half: u64| time(model.clone(), &frames.train, settings, half);
        let cost = StepCost { gaussians: model.len(), full: time(0)?, half: time(u64::MAX)? };
        let left = (budget.0 - began.elapsed().as_secs_f64()).max(1.0);
        let (chosen, text) = cost.fit(settings, left);
        session.progress.say(format!("--budget: {text}"));
        session.receipt.setting("budget", budget.0, &text);
        Ok(Optimiser::new(model, &frames.train, chosen)?)
    }
}

/// Seconds of a step, the middle of some.
fn time(
    model: Model,
    frames: &[TrainingFrame],
    settings: OptimiseSettings,
    half_steps: u64,
) -> Result<f64> {
    let settings = OptimiseSettings { half_steps, strategy: Strategy::Fixed, ..settings };
    let mut trial = Optimiser::new(model, frames, settings)?;
    trial.step(frames)?;
    let mut times = Vec::with_capacity(TIMED);
    for _ in 0..TIMED {
        let start = Instant::now();
        trial.step(frames)?;
        times.push(start.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    Ok(times[TIMED / 2])
}

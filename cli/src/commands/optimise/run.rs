//! The loop of `optimise`: steps, progress, previews, checkpoints, the end of time or memory.

use super::Args;
use super::frames::Frames;
use super::pictures::compared;
use super::previews::Previews;
use crate::progress::interrupted;
use crate::session::Session;
use anyhow::Result;
use scenesplat::memory::{Bytes, can_reserve};
use scenesplat::optimisation::cost::{memory_of, next_count};
use scenesplat::optimisation::{MeanScore, Optimiser, TrainingFrame, score_frame};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Steps that a line of progress is the mean of.
const WINDOW: u64 = 100;
/// Checkpoints that are kept.
const KEEP: usize = 2;
/// Frames that a point of the curve is measured at.
const CURVE_FRAMES: usize = 4;

/// A point of the curve.
#[derive(Debug, Clone, Serialize)]
pub(super) struct CurvePoint {
    pub(super) step: u64,
    /// Of steps alone, this run.
    pub(super) seconds: f64,
    /// Of up to four test frames, dB.
    pub(super) psnr: Option<f64>,
    pub(super) depth_l1: Option<f64>,
    pub(super) gaussians: usize,
}

impl CurvePoint {
    fn tell(&self, session: &Session<'_>) {
        if let Some(psnr) = self.psnr {
            session.progress.say(format!(
                "step {}: test {psnr:.2} dB, {} Gaussians, {:.1} s",
                self.step, self.gaussians, self.seconds
            ));
        }
    }
}

/// What came of the loop.
#[derive(Default)]
pub(super) struct Ran {
    pub(super) curve: Vec<CurvePoint>,
    pub(super) lines: String,
    /// Seconds of the steps alone.
    pub(super) seconds: f64,
    pub(super) steps: u64,
    /// Somebody asked to stop; the checkpoint is there.
    pub(super) stopped: Option<PathBuf>,
    pub(super) out_of_time: bool,
    /// Gaussians that the next refinement may have had, and bytes that they need: the system does not give them.
    pub(super) out_of_memory: Option<(usize, Bytes)>,
}

/// Sums over a window of steps.
#[derive(Default)]
struct Window {
    loss: f64,
    mse: f64,
    depth: f64,
    steps: u64,
    relocated: usize,
    added: usize,
    removed: usize,
    not_finite: usize,
}

impl Args {
    /// Steps until the end, the end of the time, or Ctrl-C.
    pub(super) fn steps(
        &self,
        session: &Session<'_>,
        optimiser: &mut Optimiser,
        frames: &Frames,
        previews: &mut Previews,
        began: Instant,
    ) -> Result<Ran> {
        let _stage = session.receipt.stage("steps");
        let total = optimiser.settings().steps;
        let out = &self.shared.out;
        let every = self.preview_every.unwrap_or((total / 10).max(1));
        let deadline = self.budget.map(|b| began + Duration::from_secs_f64(b.0));
        let mut ran = Ran::default();
        let mut window = Window::default();
        let mut checked = 0;
        while optimiser.steps_done() < total {
            let start = Instant::now();
            if deadline.is_some_and(|deadline| start > deadline) {
                ran.out_of_time = true;
                break;
            }
            ran.out_of_memory = lacks_memory(optimiser, &frames.train, &mut checked);
            if ran.out_of_memory.is_some() {
                break;
            }
            let report = optimiser.step(&frames.train)?;
            ran.seconds += start.elapsed().as_secs_f64();
            ran.steps += 1;
            let done = optimiser.steps_done();
            window.add(&report);
            if done.is_multiple_of(WINDOW) || done == total {
                let gaussians = optimiser.model().len();
                let line = window.line(done, gaussians, ran.seconds / ran.steps as f64);
                ran.lines += &(line.to_string() + "\n");
                let db = line["psnr"].as_f64().unwrap_or(f64::NAN);
                let text = format!("step {done}: {db:.2} dB, {gaussians} Gaussians");
                session.progress.advance(&text, done as f64 / total as f64);
                window = Window::default();
            }
            if every > 0 && (done.is_multiple_of(every) || done == total) {
                let point = self.look(optimiser, frames, ran.seconds)?;
                point.tell(session);
                ran.curve.push(point);
                let picture = compared(optimiser, frames.shown())?.1;
                previews.write(done, &picture)?;
            }
            let stop = interrupted();
            let due = self.checkpoint_every > 0 && done.is_multiple_of(self.checkpoint_every);
            if stop || (due && done < total) {
                let place = optimiser.save(&checkpoints(out), &frames.train, KEEP)?;
                if stop {
                    ran.stopped = Some(place);
                    break;
                }
            }
        }
        session.progress.finish();
        Ok(ran)
    }

    /// A point of the curve.
    fn look(&self, optimiser: &Optimiser, frames: &Frames, seconds: f64) -> Result<CurvePoint> {
        let settings = optimiser.settings();
        let degree = settings.sh_degree_at(optimiser.steps_done().saturating_sub(1));
        let of = if frames.test.is_empty() { &frames.train } else { &frames.test };
        let stride = of.len().div_ceil(CURVE_FRAMES).max(1);
        let mut scores = Vec::new();
        for frame in of.iter().step_by(stride) {
            scores.push(score_frame(optimiser.model(), frame, settings, degree)?.0);
        }
        let mean = MeanScore::of(&scores);
        Ok(CurvePoint {
            step: optimiser.steps_done(),
            seconds,
            psnr: mean.psnr,
            depth_l1: mean.depth_l1,
            gaussians: optimiser.model().len(),
        })
    }
}

/// What the next refinement may need and the system does not give: to run out of it there would end the program without a
/// word. `checked` is the number of Gaussians at the last look; it has to change for another one.
fn lacks_memory(
    optimiser: &Optimiser,
    frames: &[TrainingFrame],
    checked: &mut usize,
) -> Option<(usize, Bytes)> {
    let (settings, now) = (optimiser.settings(), optimiser.model().len());
    let next = next_count(settings, now);
    if next == now || std::mem::replace(checked, now) == now {
        return None;
    }
    let need = |gaussians| memory_of(settings, gaussians, frames) - memory_of(settings, 0, frames);
    // An array that grows takes twice its size, which the need counts; so far it may take its own.
    let more = need(next) - need(now) / 2;
    (!can_reserve(more)).then_some((next, Bytes(more)))
}

/// Where checkpoints are.
pub(super) fn checkpoints(out: &Path) -> PathBuf {
    out.join("checkpoints")
}

impl Window {
    fn add(&mut self, report: &scenesplat::optimisation::StepReport) {
        self.loss += report.image.loss;
        self.mse += report.image.mse;
        self.depth += report.depth.mean;
        self.steps += 1;
        self.relocated += report.refined.relocated;
        self.added += report.refined.added;
        self.removed += report.refined.removed;
        self.not_finite += report.refined.not_finite;
    }

    fn line(&self, step: u64, gaussians: usize, seconds_per_step: f64) -> serde_json::Value {
        let mean = |sum: f64| sum / self.steps.max(1) as f64;
        serde_json::json!({
            "step": step,
            "loss": mean(self.loss),
            "psnr": -10.0 * mean(self.mse).log10(),
            "depth": mean(self.depth),
            "gaussians": gaussians,
            "relocated": self.relocated,
            "added": self.added,
            "removed": self.removed,
            "not_finite": self.not_finite,
            "seconds_per_step": seconds_per_step,
        })
    }
}

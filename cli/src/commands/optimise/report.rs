//! The figures of `optimise`, and the pictures of its test.

use super::Args;
use super::frames::Frames;
use super::pictures::compared;
use super::run::Ran;
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::optimisation::{FrameScore, MeanScore, Optimiser, TrainingFrame};
use scenesplat::preview::write_png;
use scenesplat::scene::GaussianScene;
use serde_json::json;

/// Test frames that pictures are written of.
const SHOWN: usize = 4;
/// Frames of training that are scored.
const TRAIN_SCORED: usize = 20;
/// Opacity below which a Gaussian is not written.
const LEAST_OPACITY: f32 = 0.005;

impl Frames {
    /// The frame of the previews.
    pub(super) fn shown(&self) -> &TrainingFrame {
        self.test.first().unwrap_or(&self.train[0])
    }
}

impl Args {
    /// Scores the result, writes figures and pictures, and gives the Gaussians that are worth writing.
    pub(super) fn finish(
        &self,
        session: &Session<'_>,
        optimiser: &Optimiser,
        frames: &Frames,
        ran: &Ran,
    ) -> Result<GaussianScene> {
        let _stage = session.receipt.stage("score");
        let (test, train) = scores(session, optimiser, frames)?;
        let (mean, learned) = (MeanScore::of(&test), MeanScore::of(&train));
        let per_step = ran.seconds / ran.steps.max(1) as f64;
        let model = optimiser.model();
        let (scene, faint) = kept(&model.to_scene())?;
        let figures = json!({
            "test_psnr": mean.psnr,
            "test_psnr_masked": mean.psnr_masked,
            "test_psnr_corrected": mean.psnr_corrected,
            "test_ssim": mean.ssim,
            "test_ssim_masked": mean.ssim_masked,
            "depth_l1": mean.depth_l1.or(learned.depth_l1),
            "depth_l1_expected": mean.depth_l1_expected.or(learned.depth_l1_expected),
            "seconds_per_step": per_step,
            "seconds": ran.seconds,
            "steps": optimiser.steps_done(),
            "gaussians": scene.len(),
            "faint": faint,
            "train_psnr": learned.psnr,
            "train_psnr_masked": learned.psnr_masked,
            "train_psnr_corrected": learned.psnr_corrected,
            "train_ssim": learned.ssim,
            "ssim_border": optimiser.settings().ssim_border.name(),
            "holes": mean.holes,
            "frames": { "train": frames.train.len(), "test": frames.test.len() },
            "out_of_time": ran.out_of_time,
            "scene_scale": optimiser.scene_scale(),
            "settings": optimiser.settings(),
            "curve": ran.curve,
            "test": test,
        });
        let text = serde_json::to_string_pretty(&figures)? + "\n";
        session.write_text("optimise.json", &text)?;
        session.write_text("progress.jsonl", &ran.lines)?;
        if let Some(path) = &self.json {
            session.write_file(path, &text)?;
        }
        tell(&mean, &learned);
        print(&format!(
            "{} Gaussians ({faint} too faint to be written), {} steps, {per_step:.3} s a step",
            scene.len(),
            optimiser.steps_done()
        ));
        Ok(scene)
    }
}

/// The scores of the frames of the test and of some of training; writes pictures of the first ones of the test.
fn scores(
    session: &Session<'_>,
    optimiser: &Optimiser,
    frames: &Frames,
) -> Result<(Vec<FrameScore>, Vec<FrameScore>)> {
    let mut test = Vec::new();
    for (i, frame) in frames.test.iter().enumerate() {
        session.check_stop()?;
        let (score, picture) = compared(optimiser, frame)?;
        if i < SHOWN {
            session.write(&format!("test/{}.png", frame.name), |path| write_png(path, &picture))?;
        }
        test.push(score);
    }
    let stride = frames.train.len().div_ceil(TRAIN_SCORED).max(1);
    let train = frames.train.iter().step_by(stride);
    let train = train.map(|frame| Ok(compared(optimiser, frame)?.0)).collect::<Result<_>>()?;
    Ok((test, train))
}

/// Prints the mean scores of the test and of training: of whole pictures, then of what masks leave.
fn tell(mean: &MeanScore, learned: &MeanScore) {
    let number = |value: Option<f64>, unit: &str| {
        value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}{unit}"))
    };
    print(&format!(
        "test: {} PSNR, {} SSIM, {} depth L1 over {} frames; training: {} PSNR",
        number(mean.psnr, " dB"),
        number(mean.ssim, ""),
        number(mean.depth_l1, ""),
        mean.frames,
        number(learned.psnr, " dB"),
    ));
    let masked = if mean.psnr_masked.is_some() { mean } else { learned };
    if masked.psnr_masked.is_some() {
        print(&format!(
            "where masks are on: {} PSNR, {} SSIM",
            number(masked.psnr_masked, " dB"),
            number(masked.ssim_masked, "")
        ));
    }
    if let Some(db) = mean.psnr_corrected.or(learned.psnr_corrected) {
        print(&format!("{db:.3} dB with the exposure of each picture fitted"));
    }
}

/// Without what nobody sees and what is not finite, in the order of the rows; and how many those are.
fn kept(scene: &GaussianScene) -> Result<(GaussianScene, usize)> {
    let finite = |row: usize| {
        let s = scene;
        s.coord[row].iter().chain(&s.log_scale[row]).chain(&s.quat[row]).all(|v| v.is_finite())
    };
    let rows: Vec<usize> =
        (0..scene.len()).filter(|&i| scene.opacity(i) >= LEAST_OPACITY && finite(i)).collect();
    let faint = scene.len() - rows.len();
    Ok((scene.select_rows(&rows)?, faint))
}

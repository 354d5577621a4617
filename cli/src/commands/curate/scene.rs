//! A scene at the frames that it was made of.

use super::Args;
use super::capture::Judged;
use crate::session::Session;
use crate::terminal::print;
use anyhow::{Context, Result};
use scenesplat::models::Lpips;
use scenesplat::optimisation::curation::{SceneQuality, floaters};
use scenesplat::optimisation::{MeanScore, Model, OptimiseSettings, TrainingFrame, score_frame};
use scenesplat::scene::ReadOptions;
use std::path::Path;

/// What is said where the distance cannot be computed.
const NO_LPIPS: &str = "LPIPS skipped: weights not found (give them with --lpips-weights)";

impl Args {
    /// Measures the scene, decides, and writes it down.
    pub(super) fn measure(&self, session: &Session<'_>, judged: &Judged) -> Result<()> {
        let Some(path) = &self.scene else { return Ok(()) };
        let options = ReadOptions { sh_rest: true, ..self.source.options() };
        let mut opened = session.open_with(path, &options)?;
        // The frames are in the coordinates of the cameras' file.
        opened.loaded.scene.move_origin([0.0; 3]);
        let _stage = session.receipt.stage("score");
        let scene = &opened.loaded.scene;
        let model = Model::from_scene(scene, scene.sh_degree)?;
        let base = OptimiseSettings::scenesplat();
        let antialiased = self.antialiased.unwrap_or(scene.antialiased);
        let settings = OptimiseSettings { antialiased, far: 1e10, ..base };
        let lpips = self.lpips_weights.as_ref().map(|path| Lpips::load(path));
        let lpips = lpips.transpose().context("LPIPS: the weights cannot be used")?;
        let (mut scores, mut distances) = (Vec::new(), Vec::new());
        let scored = self.scored_frames(judged);
        for (i, frame) in scored.iter().enumerate() {
            session.check_stop()?;
            session.progress.advance("score", i as f64 / scored.len() as f64);
            let (score, drawn) = score_frame(&model, frame, &settings, scene.sh_degree)?;
            if let (Some(lpips), Some(rgb)) = (&lpips, &drawn.rgb) {
                let mut truth = Vec::new();
                frame.rgb.put(&mut truth);
                let size = [frame.view.width as usize, frame.view.height as usize];
                distances.push(lpips.distance(rgb, &truth, size[0], size[1])?);
            }
            scores.push(score);
        }
        session.progress.finish();
        let with_depth: Vec<TrainingFrame> = scored.into_iter().cloned().collect();
        let mut quality = SceneQuality {
            name: self.title(),
            frames: Some(judged.report.frames.len()),
            frames_kept: Some(judged.report.kept),
            gaussians: Some(scene.len()),
            // Values that no scene may have were repaired or left out while it was read, and said.
            not_finite: Some(opened.loaded.source_rows().saturating_sub(scene.len())),
            bytes: std::fs::metadata(path).ok().filter(|m| m.is_file()).map(|m| m.len()),
            miou: self.evaluation.as_deref().map(miou).transpose()?,
            ..SceneQuality::default()
        };
        quality.set_score(&MeanScore::of(&scores));
        quality.set_floaters(floaters(&model, &with_depth, &settings.raster())?);
        quality.set_coverage(judged.coverage);
        quality.lpips =
            (!distances.is_empty()).then(|| distances.iter().sum::<f64>() / distances.len() as f64);
        if lpips.is_none() {
            quality.notes.push(NO_LPIPS.to_owned());
            print(NO_LPIPS);
        }
        quality.decide(&self.gates());
        print(if quality.keep { "keep" } else { "reject" });
        for reason in &quality.reasons {
            print(&format!("  {}: {}", reason.gate, reason.text));
        }
        let text = serde_json::to_string_pretty(&quality)? + "\n";
        session.write_text("scene_quality.json", &text)?;
        Ok(())
    }

    /// Of the frames that were kept, evenly, as many as are scored at most.
    fn scored_frames<'a>(&self, judged: &'a Judged) -> Vec<&'a TrainingFrame> {
        let frames = judged.frames.iter().zip(&judged.report.frames);
        let kept: Vec<_> =
            frames.filter(|(_, judged)| judged.kept).map(|(frame, _)| frame).collect();
        let stride = kept.len().div_ceil(self.scored as usize).max(1);
        kept.into_iter().step_by(stride).collect()
    }

    fn title(&self) -> String {
        let folder = self.shared.out.file_name().unwrap_or_default().to_string_lossy();
        self.name.clone().unwrap_or_else(|| folder.into_owned())
    }
}

/// The mIoU of what `evaluate --json` wrote.
fn miou(path: &Path) -> Result<f64> {
    let named = || path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(named)?;
    let json: serde_json::Value = serde_json::from_str(&text).with_context(named)?;
    json["miou"].as_f64().with_context(|| format!("{}: has no number miou", named()))
}

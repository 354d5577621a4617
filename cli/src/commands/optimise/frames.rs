//! Frames of `optimise`, and the Gaussians that it begins with.

use super::Args;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::optimisation::frame::scale_of_cameras;
use scenesplat::optimisation::initial::{from_points, random_points};
use scenesplat::optimisation::{
    CaptureFolder, Model, OptimiseSettings, TrainingFrame, fused_points,
};
use scenesplat::scene::gaussian_scene::SH_C0;
use scenesplat::scene::{ReadOptions, SparsePoints, open_cameras};

/// What is learned from, what is tested on, and points that came with the cameras.
pub(super) struct Frames {
    pub(super) train: Vec<TrainingFrame>,
    pub(super) test: Vec<TrainingFrame>,
    points: Option<SparsePoints>,
    /// What was subtracted from the world of the cameras; all of the above is relative to it.
    pub(super) origin: [f64; 3],
}

impl Args {
    /// Reads all frames.
    pub(super) fn frames(&self, session: &Session<'_>) -> Result<Frames> {
        let _stage = session.receipt.stage("frames");
        let set = open_cameras(&self.cameras)?;
        let origin = set.far_origin();
        let set = set.relative_to(origin);
        if origin != [0.0; 3] {
            session
                .progress
                .say(format!("points are about {origin:?}: kept relative to that origin"));
        }
        let folder = CaptureFolder {
            images: &self.images,
            depth: self.depth.as_deref(),
            masks: self.masks.as_deref(),
            depth_scale: self.depth_scale,
        };
        let capture = folder.read(&set)?;
        for note in &capture.notes {
            session.progress.say(note);
            session.receipt.warning(note);
        }
        let (mut train, mut test) = (Vec::new(), Vec::new());
        let every = self.test_every;
        for (i, frame) in capture.frames.into_iter().enumerate() {
            let is_test = every > 1 && i.is_multiple_of(every);
            if is_test { &mut test } else { &mut train }.push(frame);
        }
        if train.is_empty() {
            // One frame: there is nothing to keep apart.
            train = std::mem::take(&mut test);
            session
                .warn("there is one frame: it is learned from, and nothing is left to test with");
        }
        if train.len() > 1 && scale_of_cameras(&train) == 1.0 {
            let first = train[0].view.centre();
            if train.iter().all(|f| f.view.centre() == first) {
                session.warn("all cameras are at one place: depth cannot be learned from pictures");
            }
        }
        let black = train.iter().filter(|f| (0..f.rgb.len()).all(|i| f.rgb.at(i) == 0.0)).count();
        if black > 0 {
            session.warn(format!("{black} of {} frames are black", train.len()));
        }
        let text = format!("{} frames to learn from, {} to test with", train.len(), test.len());
        session.progress.say(&text);
        session.receipt.setting("frames", train.len(), &text);
        Ok(Frames { train, test, points: set.points, origin })
    }

    /// The first Gaussians, and where they come from.
    pub(super) fn start(
        &self,
        session: &Session<'_>,
        frames: &Frames,
        settings: &OptimiseSettings,
    ) -> Result<Model> {
        let _stage = session.receipt.stage("first Gaussians");
        let most = self.initial as usize;
        let ((points, colors), from) = if let Some(path) = &self.points {
            let options = ReadOptions { sh_rest: true, ..ReadOptions::default() };
            let mut scene = session.open_with(path, &options)?.loaded.scene;
            scene.move_origin(frames.origin);
            let color = |dc: &[f32; 3]| dc.map(|v| (0.5 + SH_C0 * v).clamp(0.0, 1.0));
            let colors = scene.sh_dc.iter().map(color).collect();
            ((scene.coord, colors), format!("points of {}", path.display()))
        } else if let Some(sparse) = frames.points.as_ref().filter(|p| !p.coord.is_empty()) {
            let coord = sparse.coord.iter().map(|p| p.map(|v| v as f32)).collect();
            let color = sparse.color.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect();
            ((coord, color), "points that came with the cameras".to_owned())
        } else {
            let fused = fused_points(&frames.train, most);
            if fused.0.is_empty() {
                let from =
                    "RANDOM POINTS around the cameras: depths or a cloud (--points) are better";
                (random_points(most, around(&frames.train), self.seed)?, from.to_owned())
            } else {
                (fused, "the measured depths".to_owned())
            }
        };
        let (points, colors) = without_bad(points, colors);
        let model = from_points(&points, &colors, &settings.initial, self.seed)
            .with_context(|| format!("first Gaussians from {from}"))?;
        session.progress.say(format!("{} Gaussians to begin with, from {from}", model.len()));
        session.receipt.setting("initial", model.len(), &from);
        Ok(model)
    }
}

/// Points that are finite.
fn without_bad(points: Vec<[f32; 3]>, colors: Vec<[f32; 3]>) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let finite = |v: &[f32; 3]| v.iter().all(|v| v.is_finite());
    points.into_iter().zip(colors).filter(|(p, c)| finite(p) && finite(c)).unzip()
}

/// A box three times the size of what the cameras span, and at least of their own distance.
fn around(frames: &[TrainingFrame]) -> [[f32; 3]; 2] {
    let scale = scale_of_cameras(frames) as f32;
    let n = frames.len().max(1) as f32;
    let centres: Vec<[f32; 3]> = frames.iter().map(|f| f.view.centre()).collect();
    let mean = [0, 1, 2].map(|k| centres.iter().map(|c| c[k]).sum::<f32>() / n);
    [mean.map(|m| m - 3.0 * scale), mean.map(|m| m + 3.0 * scale)]
}

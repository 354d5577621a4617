//! Frames of `optimise`, and the Gaussians that it begins with.

use super::Args;
use super::args::InitArg;
use crate::error::refuse;
use crate::session::Session;
use anyhow::{Context, Result};
use scenesplat::optimisation::frame::scale_of_cameras;
use scenesplat::optimisation::initial::{Cloud, InitialSettings, from_points};
use scenesplat::optimisation::surfels::{Surfel, from_surfels, fused_surfels};
use scenesplat::optimisation::{
    CaptureFolder, Model, OptimiseSettings, TrainingFrame, fused_points, points_in_view, thin,
};
use scenesplat::scene::gaussian_scene::SH_C0;
use scenesplat::scene::{
    GaussianScene, ReadOptions, Similarity, SparsePoints, Up, open_cameras, up_of_cameras,
};

/// What is learned from, what is tested on, and points that came with the cameras.
pub(super) struct Frames {
    pub(super) train: Vec<TrainingFrame>,
    pub(super) test: Vec<TrainingFrame>,
    points: Option<SparsePoints>,
    /// What was subtracted from the world of the cameras; all of the above is relative to it.
    pub(super) origin: [f64; 3],
    /// Units of the cameras that all of the above takes for 1.
    pub(super) unit: f64,
}

impl Frames {
    /// The way up, by how the cameras were held.
    pub(super) fn up(&self) -> Option<Up> {
        let axes = |frame: &TrainingFrame| {
            let [right, down, _] = frame.view.world_to_camera;
            [right, down].map(|row| [row[0], row[1], row[2]].map(f64::from))
        };
        up_of_cameras(self.train.iter().chain(&self.test).map(axes))
    }

    /// Where neither depths nor points say how large things are, the scale of the cameras becomes the unit: presets are
    /// made for scenes of about that size.
    fn with_unit(mut self, has_cloud: bool) -> Self {
        let measured = |frame: &TrainingFrame| frame.depth.is_some();
        let has_points = self.points.as_ref().is_some_and(|points| !points.coord.is_empty());
        if has_cloud || has_points || self.train.iter().any(measured) {
            return self;
        }
        self.unit = scale_of_cameras(&self.train);
        for frame in self.train.iter_mut().chain(&mut self.test) {
            for row in &mut frame.view.world_to_camera {
                row[3] = (f64::from(row[3]) / self.unit) as f32;
            }
        }
        self
    }

    /// A scene in the coordinates of the cameras' file.
    pub(super) fn placed(&self, mut scene: GaussianScene) -> GaussianScene {
        if self.unit != 1.0 {
            scene.transform(&Similarity { scale: self.unit, ..Similarity::IDENTITY });
        }
        scene.origin = self.origin;
        scene
    }
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
        for (what, found) in &capture.found {
            session.tell_found(what, found);
        }
        for note in &capture.notes {
            session.warn(note);
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
        let frames = Frames { train, test, points: set.points, origin, unit: 1.0 };
        let frames = frames.with_unit(self.points.is_some());
        if frames.unit != 1.0 {
            let text = format!(
                "nothing says how large the scene is: {:.3} units are taken for 1",
                frames.unit
            );
            session.progress.say(&text);
            session.receipt.setting("unit", frames.unit, &text);
        }
        Ok(frames)
    }

    /// The first Gaussians, and where they come from.
    pub(super) fn start(
        &self,
        session: &Session<'_>,
        frames: &Frames,
        settings: &OptimiseSettings,
    ) -> Result<Model> {
        let _stage = session.receipt.stage("first Gaussians");
        let (model, from) = match self.surfels(frames)? {
            Some(surfels) => (
                from_surfels(&surfels, settings.initial.sh_degree)?,
                "the measured depths: flat Gaussians".to_owned(),
            ),
            None => self.at_first_points(session, frames, settings)?,
        };
        session.progress.say(format!("{} Gaussians to begin with, from {from}", model.len()));
        session.receipt.setting("initial", model.len(), &from);
        Ok(model)
    }

    /// Pieces of surface, if --init depth asks for them.
    fn surfels(&self, frames: &Frames) -> Result<Option<Vec<Surfel>>> {
        if self.init != InitArg::Depth {
            return Ok(None);
        }
        if self.points.is_some() {
            refuse!(
                "--init depth makes the first Gaussians of the depths; leave out --points, or --init"
            );
        }
        let surfels = fused_surfels(&frames.train, self.initial as usize);
        if surfels.is_empty() {
            refuse!(
                "--init depth: no frame has depths to make Gaussians of; give them with --depth"
            );
        }
        Ok(Some(surfels))
    }

    /// Gaussians at points, and where those come from.
    fn at_first_points(
        &self,
        session: &Session<'_>,
        frames: &Frames,
        settings: &OptimiseSettings,
    ) -> Result<(Model, String)> {
        let ((points, colors), from, initial) = self.first_points(session, frames, settings)?;
        let (points, colors) = without_bad(points, colors);
        let model = from_points(&points, &colors, &initial, self.seed)
            .with_context(|| format!("first Gaussians from {from}"))?;
        Ok((model, from))
    }

    /// Points, where they come from, and how their Gaussians begin.
    fn first_points(
        &self,
        session: &Session<'_>,
        frames: &Frames,
        settings: &OptimiseSettings,
    ) -> Result<(Cloud, String, InitialSettings)> {
        let initial = settings.initial;
        if let Some(path) = &self.points {
            let options = ReadOptions { sh_rest: true, ..ReadOptions::default() };
            let mut scene = session.open_with(path, &options)?.loaded.scene;
            scene.move_origin(frames.origin);
            let color = |dc: &[f32; 3]| dc.map(|v| (0.5 + SH_C0 * v).clamp(0.0, 1.0));
            let colors = scene.sh_dc.iter().map(color).collect();
            let from = format!("points of {}", path.display());
            return Ok(((scene.coord, colors), from, initial));
        }
        if let Some(sparse) = frames.points.as_ref().filter(|p| !p.coord.is_empty()) {
            let coord = sparse.coord.iter().map(|p| p.map(|v| v as f32)).collect();
            let color = sparse.color.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect();
            return Ok(((coord, color), "points that came with the cameras".to_owned(), initial));
        }
        let most = self.initial as usize;
        let fused = fused_points(&frames.train, most);
        if !fused.0.is_empty() {
            return Ok((fused, "the measured depths".to_owned(), initial));
        }
        let (cloud, place) = points_in_view(&frames.train, most, self.seed)?;
        let from = format!("{place}: depths or a cloud (--points) are better");
        Ok((cloud, from, thin(initial)))
    }
}

/// Points that are finite.
fn without_bad(points: Vec<[f32; 3]>, colors: Vec<[f32; 3]>) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let finite = |v: &[f32; 3]| v.iter().all(|v| v.is_finite());
    points.into_iter().zip(colors).filter(|(p, c)| finite(p) && finite(c)).unzip()
}

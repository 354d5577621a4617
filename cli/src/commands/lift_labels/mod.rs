//! `scenesplat lift-labels`

mod args;
mod collect;
mod depth;
mod glass;
mod index;
mod level;
mod photos;
mod pictures;
mod plan;
mod write;

use crate::error::{WrongUse, refuse};
use crate::session::Session;
use anyhow::Result;
use args::FormArg;
pub use args::{Args, FrameWeightsArg, LiftArgs, RobustRuleArg};
use pictures::Pictures;
use plan::Guard;
use scenesplat::datasets::effects::plan::EffectPlan;
use scenesplat::memory::Bytes;
use scenesplat::outputs::OpenedScene;
use scenesplat::rasterizer::Gaussians;
use scenesplat::rasterizer::lifting::LiftSettings;
use scenesplat::rasterizer::segments::{CameraMatches, SegmentFolder};
use scenesplat::scene::Camera;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.lifting.shared, line)?;
    // Whatever can be wrong with flags and names is found before anything expensive.
    args.check()?;
    for path in [&args.input.scene, &args.cameras, &args.segments] {
        session.outputs.reads(path)?;
    }
    let before = args.plan_before(&session)?;
    let (cameras, folder, matches) = args.pictures(&session)?;
    pictures::views(&cameras, &matches, &args.cameras)?;
    session.outputs.open_folder(if args.level.len() == 1 { args.lifting.files() } else { &[] })?;
    let opened = args.open(&session)?;
    let gaussians = Gaussians::from_scene(&opened.loaded.scene)?;
    args.record(&session)?;
    let origin = opened.loaded.scene.origin;
    let files = cameras.iter().map(|camera| camera.name.clone()).collect();
    let cameras = cameras.iter().map(|camera| camera.relative_to(origin)).collect();
    let labels = PictureLabels { cameras, files, folder, matches };
    args.lift_onto(&session, &opened, &gaussians, &labels, before.as_ref())?;
    session.finish()
}

/// Pictures whose segments have features.
pub(super) struct PictureLabels {
    /// All of a file, in its order.
    pub(super) cameras: Vec<Camera>,
    /// What their photos and depths are called.
    pub(super) files: Vec<String>,
    /// Their maps and features.
    pub(super) folder: SegmentFolder,
    /// Which frame belongs to which camera.
    pub(super) matches: CameraMatches,
}

impl Args {
    /// Refuses settings that could not be kept.
    pub(super) fn check(&self) -> Result<()> {
        self.finalise(&Guard::default()).check().map_err(|e| WrongUse(e.to_string()))?;
        self.check_form()?;
        self.lifting.check_left_over(&self.level)?;
        self.check_memory()?;
        self.check_effects()
    }

    /// Lifts labels onto the Gaussians of a scene, writes the files, and says what was decided.
    pub(super) fn lift_onto(
        &self,
        session: &Session<'_>,
        opened: &OpenedScene,
        gaussians: &Gaussians,
        labels: &PictureLabels,
        before: Option<&EffectPlan>,
    ) -> Result<()> {
        let PictureLabels { cameras, files, folder, matches } = labels;
        let views = pictures::views(cameras, matches, &self.cameras)?;
        let names = files.iter().zip(matches.frames()).filter(|(_, frame)| frame.is_some());
        let names: Vec<&str> = names.map(|(name, _)| name.as_str()).collect();
        let depths = self.lifting.measured_depths(session, &names)?;
        let pictures = Pictures::new(folder, pictures::paired(&views, matches), depths);
        let antialiased = self.lifting.antialiased.unwrap_or(opened.loaded.scene.antialiased);
        let depth = self.decide_depth(session, (gaussians, antialiased), &pictures)?;
        let settings = self.settings(depth, antialiased);
        let with_frames = cameras.iter().zip(matches.frames()).filter(|(_, frame)| frame.is_some());
        let with_frames: Vec<_> = with_frames.map(|(camera, _)| camera).collect();
        let weights = self.weigh(session, (gaussians, antialiased), &names, &with_frames)?;
        let glass = self.decide_glass(session, &opened.loaded.scene, before)?;
        let mut lifter = self.lift(session, gaussians, &pictures, &weights, &settings, &glass)?;
        self.note_glass(session, &lifter, glass);
        for (number, &level) in self.level.iter().enumerate() {
            if self.lifting.form == FormArg::Index {
                self.write_index(session, opened, &mut lifter, (number, level))?;
                continue;
            }
            let guard = self.decide(session, &mut lifter, number, level)?;
            self.write(session, opened, &mut lifter, number, level, guard)?;
        }
        session.progress.detail(session.receipt.plan_text(plan::LIFTING));
        Ok(())
    }

    /// Refuses a limit that could not be kept.
    fn check_memory(&self) -> Result<()> {
        // Trying depth agreement takes two lists of weights.
        let least = Bytes(LiftSettings::least_memory(self.level.len().max(2)));
        match self.lifting.max_memory {
            Some(limit) if limit < least => {
                refuse!("--max-memory {limit}: weights need at least {least}");
            }
            _ => Ok(()),
        }
    }

    fn open(&self, session: &Session<'_>) -> Result<OpenedScene> {
        let opened = session.open_with(&self.input.scene, &self.lifting.source.options())?;
        // A folder may hold the pictures, too.
        if self.cameras.is_file() {
            session.receipt.fingerprint("cameras", &self.cameras)?;
        }
        Ok(opened)
    }

    /// Notes in the receipt what changes the result.
    fn record(&self, session: &Session<'_>) -> Result<()> {
        let receipt = &session.receipt;
        self.lifting.rule.record(receipt);
        receipt.setting("segments", self.segments.display(), "maps and features");
        if self.erode > 0 {
            receipt.setting("erode", self.erode, "pixels along borders that label nothing");
        }
        if self.coverage > 0.0 {
            receipt.setting("coverage", self.coverage, "least labeled weight, pixels");
        }
        if self.labelled_share > 0.0 {
            receipt.setting("labelled_share", self.labelled_share, "least labeled part");
        }
        Ok(())
    }
}

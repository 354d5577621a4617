//! `scenesplat lift-labels`

mod args;
mod collect;
mod depth;
mod glass;
mod level;
mod photos;
mod pictures;
mod plan;
mod write;

use super::WrongUse;
use crate::session::Session;
use anyhow::Result;
pub use args::Args;
use clap::ValueEnum;
use collect::Guard;
use pictures::Pictures;
use scenesplat::memory::Bytes;
use scenesplat::outputs::OpenedScene;
use scenesplat::rasterizer::Gaussians;
use scenesplat::rasterizer::lifting::LiftSettings;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    // Whatever can be wrong with flags and names is found before anything expensive.
    args.finalise(&Guard::default()).check().map_err(|e| WrongUse(e.to_string()))?;
    args.check_memory()?;
    args.check_effects()?;
    for path in [&args.scene, &args.cameras, &args.segments] {
        session.outputs.reads(path)?;
    }
    let before = args.plan_before(&session)?;
    let (cameras, folder, matches) = args.pictures(&session)?;
    let views = pictures::views(&cameras, &matches, &args.cameras)?;
    session.make_out(if args.level.len() == 1 { &write::FILES } else { &[] })?;
    let opened = args.open(&session)?;
    let gaussians = Gaussians::from_scene(&opened.loaded.scene)?;
    args.record(&session)?;
    let pictures = Pictures::new(&folder, pictures::paired(&views, &matches), &args.depth);
    let settings = args.settings(args.decide_depth(&session, &gaussians, &pictures)?);
    let with_frames = cameras.iter().zip(&matches.frames).filter(|(_, frame)| frame.is_some());
    let with_frames: Vec<_> = with_frames.map(|(camera, _)| camera).collect();
    let weights = args.weigh(&session, &gaussians, &pictures, &with_frames)?;
    let glass = args.decide_glass(&session, &opened.loaded.scene, before.as_ref())?;
    let mut lifter = args.lift(&session, &gaussians, &pictures, &weights, &settings, &glass)?;
    args.note_glass(&session, &lifter, glass);
    for (number, &level) in args.level.iter().enumerate() {
        let guard = args.decide(&session, &mut lifter, number, level)?;
        args.write(&session, &opened, &mut lifter, number, level, guard)?;
    }
    session.progress.say(session.receipt.plan_text(plan::LIFTING));
    session.finish()
}

impl Args {
    /// Refuses a limit that could not be kept.
    fn check_memory(&self) -> Result<()> {
        // Trying depth agreement takes two lists of weights.
        let least = Bytes(LiftSettings::least_memory(self.level.len().max(2)));
        match self.max_memory {
            Some(limit) if limit < least => {
                let text = format!("--max-memory {limit}: weights need at least {least}");
                Err(WrongUse(text).into())
            }
            _ => Ok(()),
        }
    }

    fn open(&self, session: &Session<'_>) -> Result<OpenedScene> {
        let opened = session.open_with(&self.scene, &self.source.options())?;
        // A folder may hold the pictures, too.
        if self.cameras.is_file() {
            session.receipt.fingerprint("cameras", &self.cameras)?;
        }
        Ok(opened)
    }

    /// Notes in the receipt what changes the result.
    fn record(&self, session: &Session<'_>) -> Result<()> {
        let receipt = &session.receipt;
        let rule = self.rule.to_possible_value().map_or(String::new(), |v| v.get_name().to_owned());
        receipt.setting("rule", rule, "which pixels label a Gaussian");
        receipt.setting("segments", self.segments.display(), "maps and features");
        if self.erode > 0 {
            receipt.setting("erode", self.erode, "pixels along borders that label nothing");
        }
        if self.coverage > 0.0 {
            receipt.setting("coverage", self.coverage, "least labelled weight, pixels");
        }
        if self.labelled_share > 0.0 {
            receipt.setting("labelled_share", self.labelled_share, "least labelled part");
        }
        Ok(())
    }
}

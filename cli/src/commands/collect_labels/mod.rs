//! `scenesplat collect-labels`

mod args;
mod cache;
mod choice;
mod frames;
mod onnx;
mod sources;
mod work;

use crate::session::Session;
use anyhow::Result;
pub use args::Args;
use args::{FRAMES, SegmentsArg};
use scenesplat::rasterizer::segments::{SegmentFolder, SegmentOptions};
use scenesplat::rasterizer::{Gaussians, RasterSettings};
use scenesplat::taught::TEXTS;
use sources::{Labeler, Sources};
use work::Work;

use super::lift_labels::PictureLabels;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.lifting.shared, line)?;
    // Whatever can be wrong with flags and names is found before anything expensive.
    args.check()?;
    let mut sources = Sources::of(&session, args)?;
    session.outputs.reads(&args.input.scene)?;
    session.outputs.reads_any([args.cameras.as_deref(), args.images.as_deref()])?;
    if let SegmentsArg::Folder(folder) = &args.segments {
        session.outputs.reads(folder)?;
    }
    let mut photos = match args.render {
        None => frames::of_photos(&session, args)?,
        Some(_) => Vec::new(),
    };
    session.outputs.open_folder(args.lifting.files())?;
    let opened = session.open_with(&args.input.scene, &args.read_options())?;
    if let Some(cameras) = args.cameras.as_ref().filter(|path| path.is_file()) {
        session.receipt.fingerprint("cameras", cameras)?;
    }
    let origin = opened.loaded.scene.origin;
    photos.iter_mut().for_each(|frame| frame.camera = frame.camera.relative_to(origin));
    let gaussians = Gaussians::from_scene(&opened.loaded.scene)?;
    args.record(&session, &sources);
    let frames = match (args.render, args.max_frames) {
        (Some(count), _) => choice::planned(&session, args, &opened.loaded, &gaussians, count)?,
        (None, Some(most)) => choice::chosen(&session, photos, &gaussians, most)?,
        (None, None) => photos,
    };
    sources.assign(&session, &frames)?;
    let antialiased = args.lifting.antialiased.unwrap_or(opened.loaded.scene.antialiased);
    let raster = RasterSettings { antialiased, ..RasterSettings::default() };
    let work = Work { session: &session, args, sources: &sources, gaussians: &gaussians, raster };
    let cameras = work.run(&frames)?;
    {
        let _stage = session.receipt.stage("lifting");
        let folder =
            SegmentFolder::open(&args.lifting.shared.out.join(FRAMES), SegmentOptions::default())?;
        let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
        let matches = folder.match_cameras(&names)?;
        let files = frames.iter().map(|frame| frame.camera.name.clone()).collect();
        let labels = PictureLabels { cameras, files, folder, matches };
        let lifting = args.lifting(args.cameras.as_deref().unwrap_or(&args.input.scene))?;
        lifting.lift_onto(&session, &opened, &gaussians, &labels, None)?;
    }
    if let Labeler::Teacher { texts, .. } = &sources.labeler {
        let bytes = texts.to_safetensors()?;
        session.write(TEXTS, |path| std::fs::write(path, &bytes))?;
        let (scene, out) = (args.input.scene.display(), args.lifting.shared.out.display());
        session
            .progress
            .say(format!("next: scenesplat segment {scene} --taught {out} --out {out}/segmented"));
    }
    session.finish()
}

impl Args {
    /// Notes in the receipt what changes the result.
    fn record(&self, session: &Session<'_>, sources: &Sources) {
        let receipt = &session.receipt;
        self.lifting.rule.record(receipt);
        match &sources.labeler {
            Labeler::Pair { segmenter, encoder } => {
                receipt.setting("segmenter", segmenter.name(), "what cuts pictures into segments");
                receipt.setting("encoder", encoder.name(), "what describes segments");
            }
            Labeler::Teacher { teacher, .. } => {
                receipt.setting(
                    "teacher",
                    teacher.name(),
                    "what finds things and says their names",
                );
            }
        }
        if self.compat.is_some() {
            let why = "red and blue of whole frames are exchanged; a single segment gets the frame's feature";
            receipt.setting("compat", "original", why);
        }
    }
}

//! `scenesplat curate`

mod args;
mod capture;
mod scene;
mod table;

use crate::session::Session;
use anyhow::Result;
pub use args::Args;

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let session = Session::start(&args.shared, line)?;
    if let Some(folder) = &args.scenes {
        session.outputs.open_folder(&["scenes.md", "scenes.png"])?;
        table::write(&session, folder)?;
        return session.finish();
    }
    for path in [&args.cameras, &args.images, &args.depth, &args.scene].into_iter().flatten() {
        session.outputs.reads(path)?;
    }
    session.outputs.reads_any([args.lpips_weights.as_deref(), args.evaluation.as_deref()])?;
    session.outputs.open_folder(&["frames.json", "cameras.json"])?;
    let capture = args.judge(&session)?;
    if args.scene.is_some() {
        session.outputs.open_folder(&["scene_quality.json"])?;
        args.measure(&session, &capture)?;
    }
    session.finish()
}

//! What `convert` refuses before any work.

use super::Args;
use crate::error::refuse;
use crate::flags::SpzFrameArg;
use crate::outputs::Outputs;
use anyhow::Result;
use scenesplat::scene::SceneFormat;
use std::path::Path;

/// The format of the target, if it can be written.
pub fn target_format(args: &Args) -> Result<SceneFormat> {
    let can = || format!("what can be written: {}", SceneFormat::writable_endings());
    let to = args.to.display();
    let Some(format) = args.format.or_else(|| SceneFormat::from_path(&args.to)) else {
        refuse!("{to}: its ending names no format; give --format, or an ending of {}", can());
    };
    if !format.is_writable() {
        refuse!("{to}: {} files are read, not written; {}", format.name(), can());
    }
    let raw = format == SceneFormat::Spz && args.to_spz_frame == SpzFrameArg::Raw;
    if let (Some(_), Some(frame), false) = (args.frame, format.row().frame, raw) {
        refuse!(
            "--frame: {} files have the frame {frame}, and the scene is converted to it when it is \
             written; --frame would turn it a second time. Leave it out{}, or turn the scene itself \
             with --up or --rotate",
            format.name(),
            if format == SceneFormat::Spz { ", write --to-spz-frame raw" } else { "" }
        );
    }
    Ok(format)
}

/// Refuses a frame that the reader has left already.
pub fn check_source_frame(args: &Args, path: &Path, kind: SceneFormat) -> Result<()> {
    let raw = kind == SceneFormat::Spz && args.source.spz_frame == SpzFrameArg::Raw;
    let (Some(change), Some(frame)) = (args.frame, kind.row().frame.filter(|_| !raw)) else {
        return Ok(());
    };
    if change.from != frame {
        return Ok(());
    }
    refuse!(
        "--frame: {} is in the frame {frame} and was converted to RDF when it was read; write --frame \
         {}, without {frame}:",
        path.display(),
        change.to
    );
}

/// Refuses what would only fail after all the work.
pub fn check_paths(args: &Args, format: SceneFormat) -> Result<()> {
    if !args.overwrite && format != SceneFormat::NpyFolder && args.to.exists() {
        anyhow::bail!("{}: is there already (--overwrite replaces it)", args.to.display());
    }
    let outputs = Outputs::new(&args.to);
    args.from.iter().try_for_each(|from| outputs.reads(from))?;
    outputs.reads_any([args.features.as_deref()])?;
    let folders = [SceneFormat::NpyFolder, SceneFormat::SogFolder, SceneFormat::SogStreamed];
    if !folders.contains(&format) {
        // In place, if --overwrite says so; over the features never.
        let features = Outputs::new(&args.to);
        features.reads_any([args.features.as_deref()])?;
        features.claim("the target", &args.to)?;
        outputs.reads(&args.to)?;
    }
    outputs.claim_any("--json", args.json.as_ref())
}

//! `scenesplat convert`

mod args;
mod checks;
mod read;

use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::Result;
pub use args::Args;
use checks::{check_paths, target_format};
use scenesplat::inspect::{Floaters, find_floaters};
use scenesplat::scene::edit::EditReport;
use scenesplat::scene::{GaussianScene, WriteOptions, write_scene};
use serde_json::json;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let format = target_format(args)?;
    let progress = Progress::start(&args.running)?;
    check_paths(args, format)?;
    let source = read::read(args, format, &progress)?;
    let (scene, floaters) = without_floaters(args, source.scene, &progress)?;
    let before = scene.len();
    let (scene, edited) = args.edit(source.stated_up).apply(scene)?;
    if edited.rows.is_some() {
        progress.say(format!("{} of {before} Gaussians kept", scene.len()));
    }
    for line in turns(&edited) {
        progress.say(line);
    }
    if interrupted() {
        return Err(scenesplat::scene::SceneError::Stopped.into());
    }
    let options = WriteOptions {
        spz_version: args.spz_version,
        spz_frame: args.to_spz_frame.into(),
        lod_levels: args.lod_levels,
        overwrite: args.overwrite,
    };
    let step = format!("writing {}", format.name());
    let written = write_scene(&scene, &args.to, format, &options, &mut |done| {
        progress.advance(&step, done);
        !interrupted()
    });
    progress.finish();
    let report = written?;
    let left_out = match source.dropped {
        0 => String::new(),
        n => format!(
            " ({n} of {} rows of the source cannot be used and were left out)",
            source.source_rows
        ),
    };
    print(&format!("{}: {report}{left_out}", args.to.display()));
    if let Some(path) = &args.json {
        let done = json!({
            "from": source.about, "floaters": floaters, "edit": edited, "to": report
        });
        write_text(path, &(serde_json::to_string_pretty(&done)? + "\n"))?;
    }
    Ok(())
}

/// The scene without floaters, if they are to be removed, and what was.
fn without_floaters(
    args: &Args,
    scene: GaussianScene,
    progress: &Progress,
) -> Result<(GaussianScene, Option<Floaters>)> {
    if !args.remove_floaters {
        return Ok((scene, None));
    }
    let found = find_floaters(&scene);
    progress.say(format!("floaters: {found}"));
    if found.kept.is_empty() {
        anyhow::bail!("--remove-floaters: every Gaussian counts as one; nothing would be left");
    }
    let scene = if found.removed() > 0 { scene.select_rows(&found.kept)? } else { scene };
    Ok((scene, Some(found)))
}

/// What was turned, in words.
fn turns(edited: &EditReport) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(up) = &edited.up {
        let doubt = if up.is_sure() { "" } else { "; hardly more than a habit, --up AXIS says it" };
        let direction = up.direction.described();
        lines.push(format!("up was {direction} ({}{doubt}), and is +z now", up.evidence));
    }
    if let Some(level) = &edited.level {
        lines.push(if level.has_floor() {
            format!(
                "level: turned by {:.2} degrees and moved by {:.3} along z ({} flat Gaussians, {:.0} % \
                 of the flat surface, lie level)",
                level.tilt,
                -level.floor,
                level.rows,
                100.0 * level.share
            )
        } else {
            format!(
                "level: no level surface was found, the scene was not turned; its lowest part was put \
                 at z = 0 (moved by {:.3})",
                -level.floor
            )
        });
    }
    lines
}

//! `scenesplat convert`

mod args;
mod checks;
mod read;

use crate::progress::{Progress, interrupted};
use crate::terminal::{print, write_text};
use anyhow::Result;
pub use args::Args;
use checks::{check_paths, target_format};
use read::Source;
use scenesplat::inspect::{Floaters, find_floaters};
use scenesplat::scene::edit::{EditReport, SampleSize};
use scenesplat::scene::{GaussianScene, Up, WriteOptions, write_scene};
use serde_json::json;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let format = target_format(args)?;
    let progress = Progress::start(&args.running)?;
    check_paths(args, format)?;
    let mut source = read::read(args, format, &progress)?;
    let scene = std::mem::take(&mut source.scene);
    let (scene, floaters) = without_floaters(args, scene, &progress)?;
    let before = scene.len();
    let (scene, edited) = args.edit(source.stated_up).apply(scene)?;
    if edited.rows.is_some() {
        let mut text = format!("{} of {before} Gaussians kept", scene.len());
        if let Some(SampleSize::Count(few)) = args.sample.filter(|_| scene.len() <= 100) {
            text += &format!(" (--sample {few} is a number; --sample {few}% keeps a share)");
        }
        progress.say(text);
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
        stated_up: args.stated_after(&source, &edited, &progress),
        ..WriteOptions::default()
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

impl Args {
    /// The way up that the file is to state: as the source states it, turned like the scene.
    fn stated_after(
        &self,
        source: &Source,
        edited: &EditReport,
        progress: &Progress,
    ) -> Option<Up> {
        let stated = source.says_up.then_some(source.stated_up.direction)?;
        if self.rotate.is_some() || self.frame.is_some() {
            progress.say("what the source says of up is left out: the scene was turned");
            return None;
        }
        Some(if edited.up.is_some() { Up::PLUS_Z } else { stated })
    }
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

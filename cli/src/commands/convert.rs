//! `scenesplat convert`

use super::WrongUse;
use crate::flags::{SourceArgs, SpzFrameArg, parse_positive};
use crate::outputs::Outputs;
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use crate::session::set_threads;
use crate::terminal::{print, write_text};
use anyhow::{Context, Result};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use scenesplat::input::open_input;
use scenesplat::inspect::{Floaters, find_floaters};
use scenesplat::language_codes::compress_features;
use scenesplat::scene::edit::{
    CropBox, EditReport, EulerAngles, FrameChange, Offset, SampleSize, SceneEdit, UpSource, merge,
};
use scenesplat::scene::formats::FORMATS;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{
    GaussianScene, LanguageFeatures, ReadOptions, SceneFormat, WriteOptions, write_scene,
};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Writes a scene in another format, whole or in part; several scenes become one. Labels, scores,
/// instances and language codes go along. What the format cannot hold is said.
///
/// Changes are made in this order: floaters, crop, sample, harmonics, scale, frame, up and level,
/// rotation, translation.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes in any format: PLY, compressed PLY, .splat, .spz, SOG, .ksplat, glTF, folder of .npy
    /// files. Of several, the rows follow each other in one scene.
    #[arg(required = true, num_args = 1..)]
    pub from: Vec<PathBuf>,
    /// The new file; its ending says the format: .ply, .compressed.ply, .spz, .splat, .glb, .sog,
    /// meta.json (a SOG folder), lod-meta.json (a streamed SOG folder), or none (a folder of .npy
    /// files).
    pub to: PathBuf,
    /// The format, where the name does not say it.
    #[arg(long, value_name = "NAME", value_parser = format_parser())]
    pub format: Option<SceneFormat>,
    /// Removes Gaussians that `inspect` calls floaters (no neighbours where others have some) and
    /// giants (larger than the scene).
    #[arg(long)]
    pub remove_floaters: bool,
    /// Keeps the Gaussians with their centre in this box, in the coordinates of the source.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub crop: Option<CropBox>,
    /// Keeps that many Gaussians, or that part, chosen by --seed.
    #[arg(long, value_name = "N|P%")]
    pub sample: Option<SampleSize>,
    /// Cuts spherical harmonics above this degree.
    #[arg(long, value_name = "0..4", value_parser = clap::value_parser!(u8).range(0..=4))]
    pub sh: Option<u8>,
    /// Multiplies positions and sizes: 0.001 for a scene in millimetres.
    #[arg(long, value_name = "FACTOR", value_parser = parse_positive, allow_hyphen_values = true)]
    pub scale: Option<f64>,
    /// Renames the axes: the directions of +x, +y, +z as letters of right/left, up/down,
    /// forward/back. FROM is RDF if not given, the frame of scenes in memory. SPZ and glTF files have a
    /// frame of their own, are converted by themselves, and refuse this.
    #[arg(long, value_name = "[FROM:]TO")]
    pub frame: Option<FrameChange>,
    /// Turns the scene so that this direction of it becomes +z: +x, -x, +y, -y, +z, -z, or auto for
    /// the one that `inspect` finds.
    #[arg(long, value_name = "AXIS|auto", value_parser = parse_up_source, allow_hyphen_values = true)]
    pub up: Option<UpSource>,
    /// Turns the scene so that its floor lies level at z = 0; which direction is up is found, or said
    /// by --up.
    #[arg(long)]
    pub level: bool,
    /// Turns the scene about the axes x, then y, then z, by degrees.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub rotate: Option<EulerAngles>,
    /// Moves the scene, after all turns.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub translate: Option<Offset>,
    /// Makes language codes of this many numbers from the scene's language features.
    #[arg(long, value_name = "K")]
    pub language_code: Option<usize>,
    /// Language features for --language-code, one row per row of the source, as `scenesplat
    /// features` writes them.
    #[arg(long, value_name = "FILE.npy", requires = "language_code")]
    pub features: Option<PathBuf>,
    /// How to read the source.
    #[command(flatten)]
    pub source: SourceArgs,
    /// What an SPZ file is written in: rub, as the format prescribes, or raw, as in a PLY file, which
    /// some programs expect.
    #[arg(long, value_enum, default_value_t = SpzFrameArg::Rub)]
    pub to_spz_frame: SpzFrameArg,
    /// Version of an SPZ file to write.
    #[arg(long, value_name = "2..4", default_value_t = 4, value_parser = clap::value_parser!(u8).range(2..=4))]
    pub spz_version: u8,
    /// Levels of detail of a streamed SOG folder (lod-meta.json) to write; each has a quarter of the
    /// Gaussians of the one before.
    #[arg(long, value_name = "1..8", default_value_t = 4, value_parser = clap::value_parser!(u8).range(1..=8))]
    pub lod_levels: u8,
    /// Replaces the target if it exists.
    #[arg(long)]
    pub overwrite: bool,
    /// Writes what was done as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Seed of --sample and of the codes.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Threads; all cores by default. The file does not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Shows no progress.
    #[arg(long)]
    pub quiet: bool,
}

/// Names of the formats that can be written.
fn format_parser() -> impl TypedValueParser<Value = SceneFormat> {
    let writable = FORMATS.iter().filter(|row| row.is_writable());
    PossibleValuesParser::new(writable.map(|row| PossibleValue::new(row.name).help(row.about)))
        .try_map(|name| SceneFormat::from_name(&name).ok_or("no such format"))
}

fn parse_up_source(text: &str) -> Result<UpSource, String> {
    match text {
        "auto" => Ok(UpSource::Auto),
        axis => Ok(UpSource::Given(axis.parse()?)),
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let format = target_format(args)?;
    set_threads(args.threads)?;
    // A handler is there already when several commands run in one process.
    let _ = listen_for_interrupt();
    let progress = Progress::new(args.quiet);
    check_paths(args, format)?;
    let source = read(args, format, &progress)?;
    let (scene, floaters) = without_floaters(args, source.scene, &progress)?;
    let before = scene.len();
    let (scene, edited) = edit_of(args).apply(scene)?;
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

/// The format of the target, if it can be written.
fn target_format(args: &Args) -> Result<SceneFormat> {
    let can = || format!("what can be written: {}", SceneFormat::writable_endings());
    let to = args.to.display();
    let Some(format) = args.format.or_else(|| SceneFormat::from_path(&args.to)) else {
        let text =
            format!("{to}: its ending names no format; give --format, or an ending of {}", can());
        return Err(WrongUse(text).into());
    };
    if !format.is_writable() {
        let text = format!("{to}: {} files are read, not written; {}", format.name(), can());
        return Err(WrongUse(text).into());
    }
    let raw = format == SceneFormat::Spz && args.to_spz_frame == SpzFrameArg::Raw;
    if let (Some(_), Some(frame), false) = (args.frame, format.row().frame, raw) {
        let text = format!(
            "--frame: {} files have the frame {frame}, and the scene is converted to it when it is \
             written; --frame would turn it a second time. Leave it out{}, or turn the scene itself \
             with --up or --rotate",
            format.name(),
            if format == SceneFormat::Spz { ", write --to-spz-frame raw" } else { "" }
        );
        return Err(WrongUse(text).into());
    }
    Ok(format)
}

fn edit_of(args: &Args) -> SceneEdit {
    SceneEdit {
        crop: args.crop,
        sample: args.sample,
        sh_degree: args.sh,
        scale: args.scale,
        frame: args.frame,
        up: args.up,
        level: args.level,
        rotate: args.rotate,
        translate: args.translate,
        seed: args.seed,
    }
}

/// What is converted.
struct Source {
    scene: GaussianScene,
    source_rows: usize,
    dropped: usize,
    about: serde_json::Value,
}

/// Reads all scenes, makes one of them, and computes its language codes.
fn read(args: &Args, format: SceneFormat, progress: &Progress) -> Result<Source> {
    let options = ReadOptions {
        lang_feat: args.language_code.is_some() || format == SceneFormat::NpyFolder,
        sh_rest: args.sh != Some(0),
        ..args.source.options()
    };
    let (mut scenes, mut about) = (Vec::new(), Vec::new());
    let (mut source_rows, mut dropped, mut kept) = (0, 0, None);
    for (number, path) in args.from.iter().enumerate() {
        progress.advance("reading", number as f64 / args.from.len() as f64);
        let (opened, remark) = open_input(path, &options)?;
        progress.finish();
        let loaded = opened.loaded;
        if let Some(text) = remark {
            progress.say(text);
        }
        if !loaded.report.is_clean() || !loaded.report.notes.is_empty() {
            progress.say(format!("{}: {}", path.display(), loaded.report));
        }
        check_source_frame(args, path, loaded.kind)?;
        source_rows += loaded.source_rows();
        dropped += loaded.report.dropped_rows;
        about.push(json!({
            "path": path.display().to_string(),
            "format": if opened.converted { "points" } else { loaded.kind.name() },
            "gaussians": loaded.source_rows(),
            "read": loaded.report,
        }));
        kept = loaded.kept_rows;
        scenes.push(loaded.scene);
    }
    let (mut scene, merged) = merge(scenes)?;
    for note in &merged.notes {
        progress.say(format!("merged: {note}"));
    }
    if let Some(k) = args.language_code {
        add_codes(args, k, source_rows, kept.as_deref(), &mut scene, progress)?;
    }
    let about = match about.len() {
        1 => about.remove(0),
        _ => json!({ "scenes": about, "gaussians": source_rows, "notes": merged.notes }),
    };
    Ok(Source { scene, source_rows, dropped, about })
}

/// Refuses a frame that the reader has left already.
fn check_source_frame(args: &Args, path: &Path, kind: SceneFormat) -> Result<()> {
    let raw = kind == SceneFormat::Spz && args.source.spz_frame == SpzFrameArg::Raw;
    let (Some(change), Some(frame)) = (args.frame, kind.row().frame.filter(|_| !raw)) else {
        return Ok(());
    };
    if change.from != frame {
        return Ok(());
    }
    let text = format!(
        "--frame: {} is in the frame {frame} and was converted to RDF when it was read; write --frame \
         {}, without {frame}:",
        path.display(),
        change.to
    );
    Err(WrongUse(text).into())
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
        lines.push(format!("up was {} ({}{doubt}), and is +z now", up.axis, up.evidence));
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

/// Refuses what would only fail after all the work.
fn check_paths(args: &Args, format: SceneFormat) -> Result<()> {
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

/// Makes codes from the features of the scene or of a file.
fn add_codes(
    args: &Args,
    k: usize,
    source_rows: usize,
    kept: Option<&[u32]>,
    scene: &mut GaussianScene,
    progress: &Progress,
) -> Result<()> {
    if let Some(path) = &args.features {
        if args.from.len() > 1 {
            let text = "--features: has the rows of one scene; make the codes of each, then merge";
            return Err(WrongUse(text.to_owned()).into());
        }
        let file = NpyFile::open(path)?;
        let [rows, dim] = *file.shape() else {
            anyhow::bail!("{}: expected [N, D], got {:?}", path.display(), file.shape());
        };
        if rows != source_rows {
            anyhow::bail!("{}: has {rows} rows, the scene {source_rows}", path.display());
        }
        let mut values = file.read_f16()?;
        if let Some(kept) = kept {
            let picked =
                kept.iter().flat_map(|&r| &values[r as usize * dim..(r as usize + 1) * dim]);
            values = picked.copied().collect();
        }
        scene.lang_feat = Some(LanguageFeatures { values, dim });
        scene.valid_feat_mask = None;
    }
    let Some(features) = &scene.lang_feat else {
        let text = "--language-code: the scene has no language features; give --features FILE.npy";
        return Err(WrongUse(text.to_owned()).into());
    };
    let valid = scene.valid_feat_mask.as_deref();
    let done = compress_features(features, valid, k, args.seed, &mut |done| {
        progress.advance("language codes", done);
        !interrupted()
    });
    progress.finish();
    let done = done.context("--language-code")?;
    if done.not_finite > 0 {
        progress
            .say(format!("{} features hold NaN or infinity and count as missing", done.not_finite));
    }
    progress.say(format!(
        "language codes of {k} numbers keep a mean cosine of {:.4} (lowest {:.4}) to {} features",
        done.mean_cosine, done.lowest_cosine, done.valid
    ));
    scene.lang_code = Some(done.code);
    Ok(())
}

//! `scenesplat convert`

use super::WrongUse;
use crate::flags::{SourceArgs, SpzFrameArg};
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use crate::terminal::{print, write_text};
use anyhow::{Context, Result};
use clap::ValueEnum;
use scenesplat::convert::{CropBox, FrameChange, Sample, SceneEdit};
use scenesplat::input::open_input;
use scenesplat::language_codes::encode_features;
use scenesplat::scene::formats::npy::NpyFile;
use scenesplat::scene::{
    FeatureRows, GaussianScene, ReadOptions, SceneFormat, WriteOptions, write_scene,
};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Writes a scene in another format, whole or in part. Labels, scores, instances and language codes
/// go along. What the format cannot hold is said.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Any scene: PLY, compressed PLY, .splat, .spz, SOG, .ksplat, glTF, folder of .npy files.
    pub from: PathBuf,
    /// The new file; its ending says the format: .ply, .compressed.ply, .spz, .splat, .sog,
    /// meta.json (a SOG folder), or none (a folder of .npy files).
    pub to: PathBuf,
    /// The format, where the name does not say it.
    #[arg(long, value_enum, value_name = "NAME")]
    pub format: Option<FormatArg>,
    /// Keeps the Gaussians with their centre in this box, in the coordinates of the source.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub crop: Option<CropBox>,
    /// Keeps that many Gaussians, or that part, chosen by --seed.
    #[arg(long, value_name = "N|P%")]
    pub sample: Option<Sample>,
    /// Cuts spherical harmonics above this degree.
    #[arg(long, value_name = "0..4", value_parser = clap::value_parser!(u8).range(0..=4))]
    pub sh: Option<u8>,
    /// Multiplies positions and sizes: 0.001 for a scene in millimetres.
    #[arg(long, value_name = "FACTOR")]
    pub scale: Option<f64>,
    /// Turns the axes: the directions of +x, +y, +z as letters of right/left, up/down,
    /// forward/back. FROM is RDF if not given, the frame of scenes in memory. SPZ files have a frame of
    /// their own and need none of this.
    #[arg(long, value_name = "[FROM:]TO")]
    pub frame: Option<FrameChange>,
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

/// Formats by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FormatArg {
    /// Floats; loses nothing.
    Ply,
    /// Packed integers in chunks of 256, with a .labels.safetensors beside it for labels.
    CompressedPly,
    /// Niantic's container.
    Spz,
    /// 32 bytes a Gaussian, with a .labels.safetensors beside it for labels.
    Splat,
    /// Textures in one archive.
    Sog,
    /// Textures in a folder.
    SogFolder,
    /// Folder of .npy files.
    Npy,
}

impl From<FormatArg> for SceneFormat {
    fn from(name: FormatArg) -> Self {
        match name {
            FormatArg::Ply => Self::Ply,
            FormatArg::CompressedPly => Self::CompressedPly,
            FormatArg::Spz => Self::Spz,
            FormatArg::Splat => Self::Splat,
            FormatArg::Sog => Self::Sog,
            FormatArg::SogFolder => Self::SogFolder,
            FormatArg::Npy => Self::NpyFolder,
        }
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let Some(format) = args.format.map(Into::into).or_else(|| SceneFormat::from_path(&args.to))
    else {
        let text = format!("{}: its ending names no format; give --format", args.to.display());
        return Err(WrongUse(text).into());
    };
    if let Some(n) = args.threads {
        let built = rayon::ThreadPoolBuilder::new().num_threads(n).build_global();
        if n == 0 || (built.is_err() && rayon::current_num_threads() != n) {
            return Err(WrongUse(format!("--threads {n}: not possible here")).into());
        }
    }
    // A handler is there already when several commands run in one process.
    let _ = listen_for_interrupt();
    let progress = Progress::new(args.quiet);
    check_paths(args, format)?;
    progress.advance("reading", 0.0);
    let options = ReadOptions {
        lang_feat: args.language_code.is_some() || format == SceneFormat::NpyFolder,
        sh_rest: args.sh != Some(0),
        ..args.source.options()
    };
    let (opened, remark) = open_input(&args.from, &options)?;
    progress.finish();
    let loaded = opened.loaded;
    if let Some(text) = remark {
        progress.say(text);
    }
    if !loaded.report.is_clean() || !loaded.report.notes.is_empty() {
        progress.say(format!("{}: {}", args.from.display(), loaded.report));
    }
    let dropped = loaded.report.dropped_rows;
    let source_rows = loaded.source_rows();
    let about = json!({
        "path": args.from.display().to_string(),
        "format": if opened.converted { "points" } else { loaded.kind.name() },
        "gaussians": source_rows,
        "read": loaded.report,
    });
    let mut scene = loaded.scene;
    if let Some(k) = args.language_code {
        add_codes(args, k, source_rows, loaded.kept_rows.as_deref(), &mut scene, &progress)?;
    }
    let edit = SceneEdit {
        crop: args.crop,
        sample: args.sample,
        sh_degree: args.sh,
        scale: args.scale,
        frame: args.frame,
        seed: args.seed,
    };
    let before = scene.len();
    let (scene, rows) = edit.apply(scene)?;
    if rows.is_some() {
        progress.say(format!("{} of {before} Gaussians kept", scene.len()));
    }
    if interrupted() {
        return Err(scenesplat::scene::SceneError::Stopped.into());
    }
    let options = WriteOptions {
        spz_version: args.spz_version,
        spz_frame: args.to_spz_frame.into(),
        overwrite: args.overwrite,
    };
    let step = format!("writing {}", format.name());
    let written = write_scene(&scene, &args.to, format, &options, &mut |done| {
        progress.advance(&step, done);
        !interrupted()
    });
    progress.finish();
    let report = written?;
    let left_out = match dropped {
        0 => String::new(),
        n => format!(" ({n} of {source_rows} rows of the source cannot be used and were left out)"),
    };
    print(&format!("{}: {report}{left_out}", args.to.display()));
    if let Some(path) = &args.json {
        let text = serde_json::to_string_pretty(&json!({ "from": about, "to": report }))?;
        write_text(path, &(text + "\n"))?;
    }
    Ok(())
}

/// Refuses what would only fail after all the work.
fn check_paths(args: &Args, format: SceneFormat) -> Result<()> {
    if !args.overwrite && format != SceneFormat::NpyFolder && args.to.exists() {
        anyhow::bail!("{}: is there already (--overwrite replaces it)", args.to.display());
    }
    let Some(json) = &args.json else { return Ok(()) };
    let folder = json.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        anyhow::bail!("--json {}: the folder is not there", json.display());
    }
    let same = |other: &Path| {
        let full = |p: &Path| p.canonicalize().unwrap_or_else(|_| p.to_owned());
        other == json || full(other) == full(json)
    };
    if same(&args.to) || same(&args.from) {
        anyhow::bail!("--json {}: would replace the scene", json.display());
    }
    Ok(())
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
        scene.lang_feat = Some(FeatureRows { values, dim });
        scene.valid_feat_mask = None;
    }
    let Some(features) = &scene.lang_feat else {
        let text = "--language-code: the scene has no language features; give --features FILE.npy";
        return Err(WrongUse(text.to_owned()).into());
    };
    let valid = scene.valid_feat_mask.as_deref();
    let done = encode_features(features, valid, k, args.seed, &mut |done| {
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

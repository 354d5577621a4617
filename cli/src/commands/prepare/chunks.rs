//! `scenesplat prepare chunks`

use crate::error::refuse;
use crate::flags::Running;
use crate::progress::Progress;
use crate::threads::set_threads;
use anyhow::{Context, Result};
use scenesplat::datasets::prepare::{ChunkTransfer, transfer_to_chunks};
use scenesplat::scene::WholeFolder;
use scenesplat::scene::formats::npy::NpyFile;
use std::path::{Path, PathBuf};

/// Brings the labeled points of scenes to their chunks: of each chunk the points that are among the nearest of its
/// Gaussians. A chunk is called as its scene, with _ and a number.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder of the scenes: folders with pc_coord.npy.
    pub scenes: PathBuf,
    /// Folder of the chunks, as `chunk` writes it.
    pub chunks: PathBuf,
    /// Points around each Gaussian that may belong to a chunk.
    #[arg(long, value_name = "K", default_value_t = 16, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub neighbours: u16,
    /// How far they may be, meters.
    #[arg(long, value_name = "M", default_value = "0.25", value_parser = crate::flags::parse_positive)]
    pub max_distance: f64,
    /// Also makes CHUNKS_filtered with the chunks of which at least this share of the Gaussians has a language feature
    /// (valid_feat_mask). How the original's folders of that name were filtered is not published; this rule is ours.
    #[arg(long, value_name = "SHARE")]
    pub filtered: Option<f64>,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> Result<()> {
    if let Some(share) = args.filtered.filter(|s| !(0.0..=1.0).contains(s)) {
        refuse!("--filtered {share}: a share from 0 to 1");
    }
    set_threads(args.running.threads)?;
    let progress = Progress::new(args.running.quiet);
    let settings =
        ChunkTransfer { neighbours: usize::from(args.neighbours), max_distance: args.max_distance };
    let chunks = folders(&args.chunks)?;
    anyhow::ensure!(!chunks.is_empty(), "{}: holds no chunks", args.chunks.display());
    let (mut done, mut without) = (0, Vec::new());
    for (i, chunk) in chunks.iter().enumerate() {
        progress.advance(chunk, i as f64 / chunks.len() as f64);
        let scene = chunk.rsplit_once('_').map_or(chunk.as_str(), |(scene, _)| scene);
        let from = args.scenes.join(scene);
        if !from.join("pc_coord.npy").is_file() {
            without.push(chunk.as_str());
            continue;
        }
        transfer_to_chunks(&from, &args.chunks.join(chunk), &settings)
            .with_context(|| format!("chunk {chunk}"))?;
        done += 1;
    }
    progress.finish();
    progress.say(format!("{done} of {} chunks have labeled points", chunks.len()));
    if let Some(first) = without.first() {
        progress.say(format!(
            "{} chunks are of scenes without pc_coord.npy in {} ({first}, …)",
            without.len(),
            args.scenes.display()
        ));
    }
    anyhow::ensure!(done > 0, "no chunk is of a scene with labeled points");
    if let Some(share) = args.filtered {
        filter(args, &chunks, share, &progress)?;
    }
    Ok(())
}

/// Copies the chunks with enough language features.
fn filter(args: &Args, chunks: &[String], share: f64, progress: &Progress) -> Result<()> {
    let mut name = args.chunks.file_name().unwrap_or_default().to_owned();
    name.push("_filtered");
    let place = args.chunks.with_file_name(name);
    let whole = WholeFolder::create(&place)?;
    let mut kept = 0;
    for chunk in chunks {
        let from = args.chunks.join(chunk);
        let mask = from.join("valid_feat_mask.npy");
        let valid = match mask.is_file() {
            true => NpyFile::open(&mask)?.read_i64()?,
            false => Vec::new(),
        };
        let with = valid.iter().filter(|v| **v != 0).count() as f64;
        if valid.is_empty() || with < share * valid.len() as f64 {
            continue;
        }
        copy(&from, &whole.waiting().join(chunk))?;
        kept += 1;
    }
    anyhow::ensure!(kept > 0, "--filtered {share}: no chunk has so many language features");
    whole.commit()?;
    progress.say(format!("{kept} of {} chunks in {}", chunks.len(), place.display()));
    Ok(())
}

/// Names of the folders in a folder, sorted.
fn folders(path: &Path) -> Result<Vec<String>> {
    let list = std::fs::read_dir(path).with_context(|| path.display().to_string())?;
    let mut names = Vec::new();
    for entry in list {
        let entry = entry.with_context(|| path.display().to_string())?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.path().is_dir() && !name.starts_with('.') {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    std::fs::create_dir(to).with_context(|| to.display().to_string())?;
    for entry in std::fs::read_dir(from).with_context(|| from.display().to_string())? {
        let path = entry.with_context(|| from.display().to_string())?.path();
        if path.is_file() {
            let name = path.file_name().unwrap_or_default();
            std::fs::copy(&path, to.join(name)).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

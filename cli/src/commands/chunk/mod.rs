//! `scenesplat chunk`

mod names;
mod totals;

use crate::error::WrongUse;
use crate::flags::Running;
use crate::progress::{Progress, interrupted};
use anyhow::Result;
use names::chunk_names;
use scenesplat::datasets::DataError;
use scenesplat::datasets::chunking::{ChunkFolder, ChunkSettings};
use scenesplat::datasets::sources::{SceneFolders, SceneFoldersOptions};
use scenesplat::scene::{FolderLock, SceneError};
use std::path::PathBuf;
use totals::Totals;

/// Cuts scenes into overlapping squares for training. Every chunk is a folder of .npy files with all
/// arrays of its scene; language features are normalized. An interrupted run goes on where it was.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The folder of the scenes, or of their splits: folders of .npy files, or files of any format.
    pub root: PathBuf,
    /// Where the folder of chunks comes: DIR/SPLIT_grid1.0cm_chunk6x6_stride3x3.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Folder of ROOT to cut, and name of the chunks' folder; the scenes of ROOT itself otherwise.
    #[arg(long, value_name = "NAME")]
    pub split: Option<String>,
    /// Keeps one Gaussian in each cell of this size, meters (0.01 is the original's); all if not
    /// given.
    #[arg(long, value_name = "M", value_parser = crate::flags::parse_grid_size)]
    pub grid: Option<f64>,
    /// Sides of a chunk along x and y, meters.
    #[arg(long, num_args = 2, value_names = ["X", "Y"], default_values_t = [6.0, 6.0])]
    pub range: Vec<f64>,
    /// Distance from one chunk to the next along x and y, meters.
    #[arg(long, num_args = 2, value_names = ["X", "Y"], default_values_t = [3.0, 3.0])]
    pub stride: Vec<f64>,
    /// Leaves out chunks with fewer Gaussians.
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    pub min: usize,
    /// Keeps that many chunks of a scene at most, the fullest ones.
    #[arg(long, value_name = "N")]
    pub max_chunks: Option<usize>,
    /// A file with the names of the scenes to cut, one a line.
    #[arg(long, value_name = "FILE")]
    pub scenes: Option<PathBuf>,
    /// Seed of what is drawn.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Loses what the original loses: scenes not longer than range less stride, and Gaussians exactly
    /// where the last chunk ends.
    #[arg(long)]
    pub exact: bool,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let settings = settings(args)?;
    let progress = Progress::start(&args.running)?;
    let folders: Vec<String> = args.split.iter().cloned().collect();
    let scenes = SceneFolders::new(&args.root, &folders, SceneFoldersOptions::default())?;
    let names = chunk_names(&scenes, args.scenes.as_deref())?;
    let split = args.split.as_deref().unwrap_or("all");
    let folder = ChunkFolder::open(&args.out, split, settings)?;
    let _lock = FolderLock::acquire(folder.path())?;
    let mut total = Totals::default();
    for (i, (name, id)) in names.iter().enumerate() {
        let step = format!("{name} ({} of {})", i + 1, names.len());
        let source = scenes.path(id)?;
        let cut = folder.cut(name, source, &mut |done| {
            progress.advance(&step, done);
            !interrupted()
        });
        progress.finish();
        match cut {
            Ok(report) => total.add(&report, &progress),
            Err(error) if stopped(&error) => {
                let (done, all) = (total.scenes(), names.len());
                anyhow::bail!("stopped after {done} of {all} scenes; call it again to go on");
            }
            Err(error) => total.add_broken(id, error, &progress),
        }
    }
    total.say(folder.path());
    total.result()
}

fn settings(args: &Args) -> Result<ChunkSettings> {
    let pair = |values: &[f64]| match *values {
        [x, y] => Ok([x, y]),
        _ => Err(WrongUse("--range and --stride take two numbers".to_owned())),
    };
    let settings = ChunkSettings {
        grid_size: args.grid,
        range: pair(&args.range)?,
        stride: pair(&args.stride)?,
        minimum_size: args.min,
        max_chunks: args.max_chunks,
        seed: args.seed,
        exact: args.exact,
    };
    settings.check().map_err(|error| WrongUse(error.to_string()))?;
    Ok(settings)
}

fn stopped(error: &DataError) -> bool {
    matches!(error, DataError::Rows(source) if matches!(**source, SceneError::Stopped))
}

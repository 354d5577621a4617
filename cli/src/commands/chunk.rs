//! `scenesplat chunk`

use super::WrongUse;
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use crate::session::set_threads;
use crate::terminal::print;
use anyhow::{Context, Result};
use scenesplat::datasets::chunking::{ChunkFolder, ChunkReport, ChunkSettings};
use scenesplat::datasets::sources::{SceneFolders, SceneFoldersOptions};
use scenesplat::datasets::{DataError, DataSource};
use scenesplat::scene::input_file::read_text_file;
use scenesplat::scene::{FolderLock, SceneError};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Cuts scenes into overlapping squares for training. Every chunk is a folder of .npy files with all
/// arrays of its scene; language features are normalised. An interrupted run goes on where it was.
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
    /// Keeps one Gaussian in each cell of this size, metres (0.01 is the original's); all if not
    /// given.
    #[arg(long, value_name = "M")]
    pub grid: Option<f64>,
    /// Sides of a chunk along x and y, metres.
    #[arg(long, num_args = 2, value_names = ["X", "Y"], default_values_t = [6.0, 6.0])]
    pub range: Vec<f64>,
    /// Distance from one chunk to the next along x and y, metres.
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
    /// Threads; all cores by default. The chunks do not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Shows no progress.
    #[arg(long)]
    pub quiet: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let settings = settings(args)?;
    set_threads(args.threads)?;
    // A handler is there already when several commands run in one process.
    let _ = listen_for_interrupt();
    let progress = Progress::new(args.quiet);
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
                let done = total.scenes;
                anyhow::bail!(
                    "stopped after {done} of {} scenes; call it again to go on",
                    names.len()
                );
            }
            Err(error) => {
                let text = format!("{:#}", anyhow::Error::from(error));
                progress.say(format!("{id}: {text}"));
                total.broken.push(format!("{id}: {text}"));
            }
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

/// Scenes to cut: what their chunks are called, and their id.
fn chunk_names(scenes: &SceneFolders, subset: Option<&Path>) -> Result<Vec<(String, String)>> {
    let mut wanted: Option<BTreeSet<String>> = None;
    if let Some(path) = subset {
        let text = read_text_file(path).context("--scenes")?;
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
        wanted = Some(lines.map(str::to_owned).collect());
    }
    let mut by_name: BTreeMap<String, String> = BTreeMap::new();
    for id in scenes.scene_ids() {
        // The ending of a file is no part of the name of its chunks.
        let is_file = scenes.path(id)?.is_file();
        let stem = Path::new(id).file_stem().filter(|_| is_file).and_then(|stem| stem.to_str());
        let name = stem.unwrap_or(id).to_owned();
        if let Some(wanted) = &mut wanted
            && !wanted.remove(&name)
            && !wanted.remove(id)
        {
            continue;
        }
        if let Some(other) = by_name.insert(name.clone(), id.clone()) {
            anyhow::bail!("{other} and {id} would both give chunks called {name}_…; move one away");
        }
    }
    if let Some(unknown) = wanted.and_then(|wanted| wanted.into_iter().next()) {
        anyhow::bail!("--scenes: there is no scene called {unknown}");
    }
    Ok(by_name.into_iter().collect())
}

fn stopped(error: &DataError) -> bool {
    matches!(error, DataError::Rows(source) if matches!(**source, SceneError::Stopped))
}

/// What became of all scenes.
#[derive(Default)]
struct Totals {
    scenes: usize,
    chunks: usize,
    rows: usize,
    found: usize,
    without: Vec<String>,
    broken: Vec<String>,
}

impl Totals {
    fn add(&mut self, report: &ChunkReport, progress: &Progress) {
        self.scenes += 1;
        self.chunks += report.chunks.len();
        self.rows += report.chunks.iter().map(|(_, rows)| rows).sum::<usize>();
        self.found += report.found;
        if report.chunks.is_empty() {
            self.without.push(report.scene.clone());
        }
        let mut text = format!(
            "{}: {} Gaussians, {} after sampling, {:.1} m x {:.1} m, {}",
            report.scene,
            report.source_rows,
            report.sampled,
            report.extent[0],
            report.extent[1],
            count(report.chunks.len(), "chunk")
        );
        for (number, what) in [
            (report.found, "there already"),
            (report.below_minimum, "left out as too small"),
            (report.beyond_limit, "left out as too many"),
        ] {
            if number > 0 {
                text += &format!(", {number} {what}");
            }
        }
        for note in &report.notes {
            text += &format!("\n  {note}");
        }
        progress.say(text);
    }

    fn say(&self, folder: &Path) {
        let found = match self.found {
            0 => String::new(),
            n => format!(" ({n} of them there already)"),
        };
        print(&format!(
            "{}: {}{found} of {}, {}",
            folder.display(),
            count(self.chunks, "chunk"),
            count(self.scenes, "scene"),
            count(self.rows, "Gaussian")
        ));
        if !self.without.is_empty() {
            print(&format!("without a chunk: {}", self.without.join(", ")));
        }
    }

    fn result(&self) -> Result<()> {
        let Some(first) = self.broken.first() else { return Ok(()) };
        anyhow::bail!("{} could not be cut, the first: {first}", count(self.broken.len(), "scene"));
    }
}

/// A number with its noun.
fn count(number: usize, noun: &str) -> String {
    if number == 1 { format!("1 {noun}") } else { format!("{number} {noun}s") }
}

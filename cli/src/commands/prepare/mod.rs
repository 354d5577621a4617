//! `scenesplat prepare`

mod chunks;
mod frames;
mod scan;
mod splits;

use anyhow::Result;
use clap::Subcommand;

/// Makes what training reads of a benchmark's own files.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    part: Part,
}

#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "one a run")]
enum Part {
    /// A scene of Gaussians and the labeled scan of it: a folder of .npy files with labels, instances, normals and
    /// the labeled points.
    Scan(scan::Args),
    /// Brings the labeled points of scenes (pc_*.npy) to the chunks that were cut of them.
    Chunks(chunks::Args),
    /// The frames of a benchmark's scan: a folder of cameras, pictures and depths that optimise, curate, collect-labels
    /// and lift-labels read.
    Frames(frames::Args),
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    match &args.part {
        Part::Scan(args) => scan::run(args, line),
        Part::Chunks(args) => chunks::run(args),
        Part::Frames(args) => frames::run(args, line),
    }
}

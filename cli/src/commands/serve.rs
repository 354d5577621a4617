//! `scenesplat serve`

#[cfg(feature = "mcp")]
mod answers;
#[cfg(feature = "mcp")]
mod picture;
#[cfg(feature = "mcp")]
mod protocol;
#[cfg(feature = "mcp")]
mod tools;

use super::labelled::LabelArgs;
use crate::flags::Running;
use anyhow::Result;

/// Answers questions about a scene over the Model Context Protocol (MCP), on standard input and output, until the input ends:
/// which objects there are, what a phrase means, sizes and distances, and pictures from where a caller stands. A program such as
/// an assistant starts it (docs/mcp.md).
///
/// Labels are those that segment gives, or with --label-names those that the scene carries. The scene is read and labeled once;
/// requests wait for that. Messages go to standard error.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Where labels come from.
    #[command(flatten)]
    pub labels: LabelArgs,
    /// Speaks the Model Context Protocol, which is the only one there is.
    #[arg(long, required = true)]
    pub mcp: bool,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
}

/// Runs the command.
#[cfg(feature = "mcp")]
pub fn run(args: &Args, line: &str) -> Result<()> {
    protocol::run(args, line)
}

/// Says how the command is built.
#[cfg(not(feature = "mcp"))]
pub fn run(_: &Args, _: &str) -> Result<()> {
    crate::error::refuse!(
        "serve --mcp: this program was built without it; cargo build --release -p scenesplat-cli --features mcp has it (it \
         needs no further library)"
    )
}

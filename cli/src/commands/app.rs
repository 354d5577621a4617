//! `scenesplat app`

use crate::flags::{Running, Shared};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::memory::Bytes;
use scenesplat::page::write_app;
use std::path::{Path, PathBuf};

/// Writes one HTML file that labels scenes by itself: drop a .ply, .spz, .sog or .splat on it, and the network inside the
/// program labels it in the browser, shows it as view does, and saves it with labels.
///
/// It opens from disk in any browser with WebGL 2, needs no server, loads nothing and sends nothing; its policy forbids it.
/// Labels are those of segment (docs/app.md). Scenes may have up to two million Gaussians.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// The page.
    #[arg(long, value_name = "FILE.html", default_value = "scenesplat.html")]
    pub out: PathBuf,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
    /// Also writes what was done and what it cost as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub receipt: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let folder = args.out.parent().filter(|path| !path.as_os_str().is_empty());
    let shared = Shared {
        running: args.running.clone(),
        out: folder.unwrap_or(Path::new(".")).to_owned(),
        receipt: args.receipt.clone(),
    };
    let session = Session::start(&shared, line)?;
    session.outputs.claim("--out", &args.out)?;
    let waiting = session.outputs.file_path(&args.out)?;
    let report = write_app(&waiting)?;
    session.wrote(&waiting, report.bytes);
    let out = args.out.display();
    print(&format!("{out}: {}; opens from disk, drop a scene on it", Bytes(report.bytes)));
    session.finish_quietly()
}

//! `scenesplat app`

use crate::flags::{Running, Shared};
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::memory::Bytes;
use scenesplat::page::write_app;
use std::path::{Path, PathBuf};

/// The library for browsers, gzipped; made by `npm run engine` in the folder `page`. It lies here, not beside the page, so
/// that each package is below what the registry takes.
const ENGINE: &[u8] = include_bytes!("../../engine/engine.wasm.gz");

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
    let report = write_app(&waiting, ENGINE)?;
    session.wrote(&waiting, report.bytes);
    let out = args.out.display();
    print(&format!("{out}: {}; opens from disk, drop a scene on it", Bytes(report.bytes)));
    session.finish_quietly()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest, Sha256};
    use std::io::Read;

    #[test]
    fn it_is_one_file_below_15_mb_that_asks_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("app.html");
        let report = write_app(&path, ENGINE).unwrap();
        let page = std::fs::read_to_string(&path).unwrap();
        assert_eq!(report.bytes, page.len() as u64);
        assert!(report.bytes <= 15_000_000, "{report:?}");
        let names: Vec<&str> = report.blocks.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["weights", "phrases", "attribution", "engine", "program"]);
        assert_eq!(page.matches("<script").count(), names.len() + 1);
        assert!(page.contains("default-src 'none'") && !page.contains("connect-src 'self'"));
    }

    #[test]
    fn the_engine_is_the_one_that_its_hash_names() {
        let mut engine = Vec::new();
        flate2::read::GzDecoder::new(ENGINE).read_to_end(&mut engine).unwrap();
        assert!(engine.starts_with(b"\0asm"));
        let hex: String = Sha256::digest(&engine).iter().map(|b| format!("{b:02x}")).collect();
        let noted = include_str!("../../engine/engine.sha256");
        assert_eq!(noted.split_whitespace().next(), Some(hex.as_str()));
    }
}

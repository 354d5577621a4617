//! `scenesplat merge`

mod gaps;
mod scores;
mod table;

use super::evaluate::EVALUATION;
use super::many::{Manifest, Record, read_record};
use crate::error::refuse;
use crate::flags::Shared;
use crate::session::Session;
use crate::terminal::print;
use anyhow::Result;
use serde_json::json;
use std::path::PathBuf;

/// Joins what a command over many scenes left in a folder, in one process or as parts: checks that no scene is
/// missing, failed or damaged, and writes merged.json (scenes, files and their checksums: the same bytes however the
/// work was shared), merged.md and costs.json; of `evaluate` also evaluation.json, the figures of all scenes together.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The --out of the command over many scenes.
    pub folder: PathBuf,
    /// Reads every file and compares its checksum; without it names and sizes are looked at.
    #[arg(long)]
    pub verify: bool,
    /// Says nothing about the progress.
    #[arg(long)]
    pub quiet: bool,
}

/// What it writes.
const FILES: [&str; 3] = ["merged.json", "merged.md", "costs.json"];

/// Runs the command.
pub fn run(args: &Args, line: &str) -> Result<()> {
    let Some(manifest) = Manifest::read(&args.folder)? else {
        refuse!(
            "{}: no manifest.json; this is not the --out of a command over many scenes",
            args.folder.display()
        );
    };
    let shared = Shared::into_folder(&args.folder, args.quiet);
    let session = Session::start(&shared, line)?;
    let mut records: Vec<Record> = Vec::new();
    let mut gaps = gaps::Gaps::of(manifest.scenes.len());
    for (place, entry) in manifest.scenes.iter().enumerate() {
        session.check_stop()?;
        session.progress.advance("scenes", place as f64 / manifest.scenes.len() as f64);
        let record = read_record(&args.folder, &entry.name)?;
        records.extend(gaps.check(&args.folder, entry, record, args.verify));
    }
    session.progress.finish();
    gaps.check_jobs(&records);
    gaps.refuse()?;
    let is_evaluation = manifest.command == "evaluate";
    let more: &[&str] = if is_evaluation { &[EVALUATION] } else { &[] };
    session.outputs.open_folder(&[&FILES[..], more].concat())?;
    let write = |name: &str, text: &str| -> Result<()> {
        session.write_text(name, text)?;
        Ok(())
    };
    let total = if is_evaluation { Some(scores::total(&args.folder, &records)?) } else { None };
    let merged = json!({
        "command": manifest.command,
        "scenes": records.iter().map(table::figures).collect::<Vec<_>>(),
        "rows_in": records.iter().map(|r| r.rows_in).sum::<u64>(),
        "rows_out": records.iter().map(|r| r.rows_out).sum::<u64>(),
        "bytes": records.iter().flat_map(|r| &r.outputs).map(|o| o.bytes).sum::<u64>(),
        "settings": records.first().map(|r| &r.job.settings),
        "version": records.first().map(|r| &r.job.version),
    });
    write("merged.json", &(serde_json::to_string_pretty(&merged)? + "\n"))?;
    let table = table::markdown(&manifest.command, &records);
    write("merged.md", &table)?;
    write("costs.json", &(serde_json::to_string_pretty(&table::costs(&records))? + "\n"))?;
    if let Some(total) = &total {
        write(EVALUATION, &(serde_json::to_string_pretty(total)? + "\n"))?;
    }
    print(&table::summary(&records));
    session.finish()
}

//! `scenesplat bench`

use crate::bench::process::{Scratch, measure_here, measure_in_a_process};
use crate::bench::{Settings, Step, names, run as run_rows};
use crate::error::refuse;
use crate::flags::Running;
use crate::outputs::Outputs;
use crate::progress::{Progress, listen_for_interrupt};
use crate::terminal::{print, write_text};
use anyhow::{Result, bail};
use scenesplat::kernels::Precision;
use std::path::{Path, PathBuf};

/// Measures how fast networks and kernels are on this machine, and how far from the least time that
/// it would allow. Needs no files. Run nothing else meanwhile.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Also writes everything as JSON here.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Only this row, with more samples; may be given several times.
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Precision of matrix products: f32, split, bf16 or int8; may be given several times. f32 and bf16 if
    /// not given.
    #[arg(long, value_name = "NAME")]
    pub precision: Vec<Precision>,
    /// Threads and progress.
    #[command(flatten)]
    pub running: Running,
    /// Small inputs: whether everything works, not how fast.
    #[arg(long)]
    pub quick: bool,
    /// One row, in this process: what the command starts itself with.
    #[arg(long, hide = true, value_name = "JSON")]
    pub measure: Option<String>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if let Some(request) = &args.measure {
        return measure_here(request);
    }
    if args.running.threads == Some(0) {
        refuse!("--threads 0: at least one thread is needed");
    }
    for name in &args.only {
        if !names().any(|n| n == name) {
            let all = names().collect::<Vec<_>>().join(", ");
            refuse!("--only {name}: no such row; the rows are {all}");
        }
    }
    Outputs::new(Path::new("")).claim_any("--json", args.json.as_ref())?;
    // A handler is there already when several commands run in one process.
    let _ = listen_for_interrupt();
    let progress = Progress::new(args.running.quiet);
    let scratch = Scratch::new()?;
    let mut precisions = args.precision.clone();
    precisions.sort_unstable();
    precisions.dedup();
    if precisions.is_empty() {
        precisions = vec![Precision::F32, Precision::Bf16];
    }
    let settings = Settings {
        only: args.only.clone(),
        precisions,
        threads: args.running.threads.unwrap_or_else(rayon::current_num_threads),
        quick: args.quick,
        scratch: scratch.path().to_owned(),
    };
    let report = run_rows(&settings, &mut measure_in_a_process, &mut |step| match step {
        Step::Begins(i, of, name, precision) => {
            progress.say(format!("{i}/{of} {name} {precision} …"));
        }
        Step::Done(row) => progress.say(format!("    {row}")),
        Step::Failed(failure) => progress.say(format!("    failed: {}", failure.reason)),
    })?;
    print(&report.to_string());
    if let Some(path) = &args.json {
        write_text(path, &(serde_json::to_string_pretty(&report)? + "\n"))?;
        progress.say(format!("wrote {}", path.display()));
    }
    if !report.failed.is_empty() {
        let names: Vec<&str> = report.failed.iter().map(|f| f.name.as_str()).collect();
        bail!("{} rows could not be measured: {}", names.len(), names.join(", "));
    }
    Ok(())
}

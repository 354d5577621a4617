//! `scenesplat bench`

use super::WrongUse;
use crate::bench::{Measured, Request, Settings, Step, Stopped, measure, names, run as run_rows};
use crate::outputs::Outputs;
use crate::progress::{Progress, interrupted, listen_for_interrupt};
use crate::terminal::{print, write_text};
use anyhow::{Context, Result, bail};
use scenesplat::kernels::Precision;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

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
    /// Precision of matrix products: f32, split or bf16; may be given several times. f32 and bf16 if
    /// not given.
    #[arg(long, value_name = "NAME")]
    pub precision: Vec<Precision>,
    /// Threads; all cores by default.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Small inputs: whether everything works, not how fast.
    #[arg(long)]
    pub quick: bool,
    /// Shows no progress.
    #[arg(long)]
    pub quiet: bool,
    /// One row, in this process: what the command starts itself with.
    #[arg(long, hide = true, value_name = "JSON")]
    pub measure: Option<String>,
}

/// How often a row's process is looked at.
const POLL: Duration = Duration::from_millis(20);

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if let Some(request) = &args.measure {
        return measure_here(request);
    }
    if args.threads == Some(0) {
        return Err(WrongUse("--threads 0: at least one thread is needed".to_owned()).into());
    }
    for name in &args.only {
        if !names().any(|n| n == name) {
            let all = names().collect::<Vec<_>>().join(", ");
            return Err(WrongUse(format!("--only {name}: no such row; the rows are {all}")).into());
        }
    }
    Outputs::new(Path::new("")).claim_any("--json", args.json.as_ref())?;
    // A handler is there already when several commands run in one process.
    let _ = listen_for_interrupt();
    let progress = Progress::new(args.quiet);
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
        threads: args.threads.unwrap_or_else(rayon::current_num_threads),
        quick: args.quick,
        scratch: scratch.0.clone(),
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

/// A folder that goes when this does.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos());
        let name = format!("scenesplat-bench-{}-{now}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        // Not into a folder, or behind a link, that somebody else has put there.
        std::fs::create_dir(&folder)
            .with_context(|| format!("{}: cannot make a scratch folder", folder.display()))?;
        Ok(Self(folder))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // A rest in the system's folder for such does no harm.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Ends the process when dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It has ended already, unless something went wrong or the user stopped.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Measures a row in a fresh process of this program.
fn measure_in_a_process(request: &Request) -> Result<Measured> {
    if interrupted() {
        return Err(Stopped.into());
    }
    let program = std::env::current_exe().context("cannot find this program")?;
    let child = Command::new(program)
        .args(["bench", "--measure", &serde_json::to_string(request)?])
        // Its end tells the row that this process is gone.
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start a process for the row")?;
    let mut child = Running(child);
    // The answer is far smaller than a pipe, so nothing needs to be read until the end.
    let status = loop {
        if interrupted() {
            return Err(Stopped.into());
        }
        if let Some(status) = child.0.try_wait()? {
            break status;
        }
        std::thread::sleep(POLL);
    };
    // Ctrl-C reaches the row's process too, perhaps first.
    if interrupted() {
        return Err(Stopped.into());
    }
    let mut answer = String::new();
    let mut said = String::new();
    if let (Some(out), Some(err)) = (&mut child.0.stdout, &mut child.0.stderr) {
        out.read_to_string(&mut answer)?;
        err.read_to_string(&mut said)?;
    }
    if !status.success() {
        let said = said.trim().trim_start_matches("error: ");
        match status.code() {
            Some(_) if !said.is_empty() => bail!("{said}"),
            _ => bail!("its process ended with {status}; perhaps there is too little memory"),
        }
    }
    serde_json::from_str(&answer).context("the row's process gave no answer")
}

/// Measures one row in this process and prints what it found.
fn measure_here(request: &str) -> Result<()> {
    let request: Request = serde_json::from_str(request)
        .map_err(|e| WrongUse(format!("--measure: {e}; it is for the program itself")))?;
    let built = rayon::ThreadPoolBuilder::new().num_threads(request.threads).build_global();
    if built.is_err() && rayon::current_num_threads() != request.threads {
        bail!("--threads {}: the system does not allow that many", request.threads);
    }
    std::thread::spawn(|| {
        // Whatever started this holds the other end and writes nothing.
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        std::process::exit(1);
    });
    print(&serde_json::to_string(&measure(&request)?)?);
    Ok(())
}

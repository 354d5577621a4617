//! Each row of `bench` in a process of its own, so that none is slowed by what another left behind.

use super::{Measured, Request, Stopped, measure};
use crate::defaults::FILE_VARIABLE;
use crate::error::WrongUse;
use crate::progress::interrupted;
use crate::terminal::{print, this_program};
use anyhow::{Context, Result, bail};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How often a row's process is looked at.
const POLL: Duration = Duration::from_millis(20);

/// A folder that goes when this does.
pub struct Scratch(PathBuf);

impl Scratch {
    /// A new, empty one among the system's temporary files.
    pub fn new() -> Result<Self> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos());
        let name = format!("scenesplat-bench-{}-{now}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        // Not into a folder, or behind a link, that somebody else has put there.
        std::fs::create_dir(&folder)
            .with_context(|| format!("{}: cannot make a scratch folder", folder.display()))?;
        Ok(Self(folder))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
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
pub fn measure_in_a_process(request: &Request) -> Result<Measured> {
    let request = serde_json::to_string(request)?;
    let answer = run_in_a_process(&["bench", "--measure", &request], &[])?;
    serde_json::from_str(&answer).context("the row's process gave no answer")
}

/// Runs this program once more, with these variables beside its own, and gives what it printed, which
/// has to be shorter than a pipe holds: 64 KiB. Ends it when the user asks to stop.
pub fn run_in_a_process(args: &[&str], variables: &[(&str, &str)]) -> Result<String> {
    if interrupted() {
        return Err(Stopped.into());
    }
    let child = this_program()?
        .args(args)
        .envs(variables.iter().copied())
        // The words say all that it is to do.
        .env(FILE_VARIABLE, "")
        // Its end tells the process that this one is gone.
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start a process of this program")?;
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
    // Ctrl-C reaches the other process too, perhaps first.
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
    Ok(answer)
}

/// Ends this process when the one that started it, which holds the other end and writes nothing, is
/// gone.
pub fn end_with_parent() {
    std::thread::spawn(|| {
        let _ = std::io::stdin().read_to_end(&mut Vec::new());
        std::process::exit(1);
    });
}

/// Measures one row in this process and prints what it found.
pub fn measure_here(request: &str) -> Result<()> {
    let request: Request = serde_json::from_str(request)
        .map_err(|e| WrongUse(format!("--measure: {e}; it is for the program itself")))?;
    let built = rayon::ThreadPoolBuilder::new().num_threads(request.threads).build_global();
    if built.is_err() && rayon::current_num_threads() != request.threads {
        bail!("--threads {}: the system does not allow that many", request.threads);
    }
    end_with_parent();
    print(&serde_json::to_string(&measure(&request)?)?);
    Ok(())
}

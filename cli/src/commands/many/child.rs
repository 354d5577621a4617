//! One scene in a process of its own: what it takes of memory, and what becomes of it, is its own affair.

use crate::defaults::FILE_VARIABLE;
use crate::log::last_error;
use crate::progress::interrupted;
use crate::terminal::this_program;
use anyhow::{Context, Result};
use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

/// How often the process is looked at.
const POLL: Duration = Duration::from_millis(20);
/// Most of what it says last that is kept as the reason.
const KEPT: usize = 4000;

/// What became of a process.
pub enum Ended {
    /// It ended well.
    Well,
    /// It failed, for this reason.
    Failed(String),
    /// The user stopped it.
    Stopped,
}

/// Runs this program with those words, and passes on what it says.
///
/// # Errors
/// If it cannot be started.
pub fn run(words: &[OsString]) -> Result<Ended> {
    let mut command = this_program()?;
    // The words hold what a file of defaults gave.
    command.args(words).env(FILE_VARIABLE, "").stdin(Stdio::null()).stderr(Stdio::piped());
    end_with_this_process(&mut command);
    let mut child = command.spawn().context("cannot start a process for the scene")?;
    let said = child.stderr.take().map(|err| std::thread::spawn(move || pass_on(err)));
    let status = wait(&mut child)?;
    let said = said.and_then(|thread| thread.join().ok()).unwrap_or_default();
    if interrupted() {
        return Ok(Ended::Stopped);
    }
    Ok(if status.success() { Ended::Well } else { Ended::Failed(reason(&said, status)) })
}

fn wait(child: &mut Child) -> Result<ExitStatus> {
    let mut told = false;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if interrupted() && !told {
            told = true;
            stop(child);
        }
        std::thread::sleep(POLL);
    }
}

/// Asks it to stop, as Ctrl-C does.
fn stop(child: &mut Child) {
    #[cfg(unix)]
    if let Ok(id) = libc::pid_t::try_from(child.id()) {
        // SAFETY: a signal to a process that was started here and not yet waited for.
        unsafe { libc::kill(id, libc::SIGTERM) };
    }
    #[cfg(not(unix))]
    let _ = child.kill();
}

/// Nobody would wait for it any more.
fn end_with_this_process(command: &mut Command) {
    #[cfg(target_os = "linux")]
    {
        use std::os::unix::process::CommandExt;
        // SAFETY: between fork and exec only this system call is made, which takes no lock and no memory.
        unsafe {
            command.pre_exec(|| {
                libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL);
                Ok(())
            });
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = command;
}

/// Passes on what is said, and keeps the end of it.
fn pass_on(from: impl Read) -> String {
    let mut kept = String::new();
    let mut from = BufReader::new(from);
    let mut line = Vec::new();
    while matches!(from.read_until(b'\n', &mut line), Ok(1..)) {
        // Whether anybody reads it changes nothing.
        let _ = std::io::stderr().write_all(&line);
        kept += &String::from_utf8_lossy(&line);
        if kept.len() > 2 * KEPT {
            let mut from = kept.len() - KEPT;
            while !kept.is_char_boundary(from) {
                from += 1;
            }
            kept.drain(..from);
        }
        line.clear();
    }
    kept
}

/// Why it failed: its error, or how it ended.
fn reason(said: &str, status: ExitStatus) -> String {
    if let Some(error) = last_error(said).filter(|_| status.code().is_some()) {
        return error;
    }
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;
        if let Some(signal) = status.signal() {
            let memory =
                if signal == libc::SIGKILL { "; perhaps there was too little memory" } else { "" };
            return format!("its process was ended by signal {signal}{memory}");
        }
    }
    let last = said.trim().lines().last().unwrap_or("it said nothing");
    format!("its process ended with {status}: {last}")
}

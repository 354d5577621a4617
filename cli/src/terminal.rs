//! What goes to standard output and error, and small text files.

use crate::caller::caller;
use crate::log::{self, Level};
use anyhow::{Context, Result, bail};
use scenesplat::scene::{AtomicFile, printable_text};
use std::cell::{Cell, RefCell};
use std::ffi::OsString;
use std::io::{Error, ErrorKind, IsTerminal, Write, stderr};
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// Writes a text file, which appears when it is complete. Gives its size.
pub fn write_text(path: &Path, text: &str) -> Result<u64> {
    AtomicFile::write(path, text.as_bytes())?;
    Ok(text.len() as u64)
}

/// What a command printed.
#[derive(Debug, Default)]
pub struct Captured {
    /// To standard output.
    pub stdout: Vec<u8>,
    /// To standard error.
    pub stderr: Vec<u8>,
}

thread_local! {
    /// Where text of this thread goes instead of standard output and error.
    static CAPTURED: RefCell<Option<Captured>> = const { RefCell::new(None) };
    /// The first thing that went wrong with standard output.
    static FAILED: Cell<Option<Error>> = const { Cell::new(None) };
    /// What the command warned of.
    static WARNINGS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
    /// Whether a warning is an error.
    static STRICT: Cell<bool> = const { Cell::new(false) };
}

/// Gives the result of `work` with what it printed on this thread.
pub fn captured<T>(work: impl FnOnce() -> T) -> (T, Captured) {
    let around = CAPTURED.replace(Some(Captured::default()));
    let result = work();
    (result, CAPTURED.replace(around).unwrap_or_default())
}

/// Whether standard error is a terminal that a bar can move on.
pub fn is_terminal() -> bool {
    CAPTURED.with_borrow(Option::is_none) && stderr().is_terminal()
}

/// How this program is started, where its file is another's, such as an interpreter's.
static STARTED_BY: OnceLock<Vec<OsString>> = OnceLock::new();

/// Says how this program is started: the words before its arguments. Of several calls the first counts.
pub fn started_by(words: Vec<OsString>) {
    let _ = STARTED_BY.set(words);
}

/// The command that starts this program once more.
///
/// # Errors
/// If a command runs inside of another program, or the system does not tell.
pub fn this_program() -> Result<Command> {
    if CAPTURED.with_borrow(Option::is_some) || caller().is_some() {
        bail!("this command starts the program once more: run it as a process");
    }
    if let Some((program, words)) = STARTED_BY.get().and_then(|words| words.split_first()) {
        let mut command = Command::new(program);
        command.args(words);
        return Ok(command);
    }
    Ok(Command::new(std::env::current_exe().context("cannot find this program")?))
}

/// Writes text to standard output; [`check_output`] tells whether it got there.
pub fn print(text: &str) {
    let line = format!("{}\n", printable_text(text));
    note(CAPTURED.with_borrow_mut(|captured| match captured {
        Some(Captured { stdout, .. }) => stdout.write_all(line.as_bytes()),
        None => std::io::stdout().write_all(line.as_bytes()),
    }));
}

/// Writes bytes to standard error. A closed standard error is no reason to fail.
pub fn tell(text: &[u8]) {
    let _ = CAPTURED.with_borrow_mut(|captured| match captured {
        Some(Captured { stderr, .. }) => stderr.write_all(text),
        None => stderr().write_all(text),
    });
}

/// Writes a message to standard error.
pub fn say(level: Level, text: &str) {
    tell(format!("{}\n", log::line_of(level, text)).as_bytes());
}

/// Writes clap's help, version or error, in color on a terminal.
pub fn print_usage(usage: &clap::Error) {
    let text = usage.render();
    if usage.use_stderr() && log::is_json() {
        let text = text.to_string();
        say(Level::Error, text.trim_start_matches("error: "));
    } else if CAPTURED.with_borrow(Option::is_none) {
        let written = usage.print();
        // Help is no result: who stops reading it has read enough.
        let is_lost = |e: &Error| !usage.use_stderr() && e.kind() != ErrorKind::BrokenPipe;
        if written.as_ref().is_err_and(is_lost) {
            note(written);
        }
    } else if usage.use_stderr() {
        tell(text.to_string().as_bytes());
    } else {
        print(text.to_string().trim_end_matches('\n'));
    }
}

/// Notes what became of writing to standard output.
fn note(written: std::io::Result<()>) {
    if let Err(error) = written {
        FAILED.set(FAILED.take().or(Some(error)));
    }
}

/// Begins a command: nothing was warned of yet. `strict`: warnings are errors.
pub fn forget_warnings(strict: bool) {
    WARNINGS.take();
    STRICT.set(strict);
}

/// Begins one of several requests of a command: what an earlier one warned of is told again.
#[cfg(feature = "mcp")]
pub fn tell_warnings_again() {
    WARNINGS.take();
}

/// Notes a warning. Whether it is new: each is told once.
pub fn note_warning(text: &str) -> bool {
    WARNINGS.with_borrow_mut(|known| {
        let is_new = !known.iter().any(|one| one == text);
        if is_new {
            known.push(text.to_owned());
        }
        is_new
    })
}

/// That nothing was warned of, where warnings are errors.
///
/// # Errors
/// If something was.
pub fn check_warnings() -> Result<()> {
    WARNINGS.with_borrow(|all| match all.as_slice() {
        [first, rest @ ..] if STRICT.get() => {
            let more =
                if rest.is_empty() { String::new() } else { format!(" and {} more", rest.len()) };
            bail!("--warnings-as-errors: {first}{more}")
        }
        _ => Ok(()),
    })
}

/// Whether everything that was printed got where it goes.
///
/// # Errors
/// If it did not, as on a full disk, or into a pipe that nobody reads any more.
pub fn check_output() -> Result<()> {
    note(std::io::stdout().flush());
    match FAILED.take() {
        Some(error) => Err(error).context("standard output: the results could not be written"),
        None => Ok(()),
    }
}

/// Writes an error with all its causes to standard error.
pub fn print_error(error: &anyhow::Error) {
    say(Level::Error, &without_waiting_names(&format!("{error:#}")));
    let missing = scenesplat::models::missing_kernels();
    if !missing.is_empty() {
        let text = format!(
            "an operation asked for CUDA kernels that this program has not: {} (docs/devices.md); compute on cpu",
            missing.join(", ")
        );
        say(Level::Info, &text);
    }
}

/// Paths as users know them: without the folders, `.new.<16 digits>.part`, in which files wait.
fn without_waiting_names(text: &str) -> String {
    const BEGIN: &str = ".new.";
    const END: &str = ".part";
    const DIGITS: usize = 16;
    let (mut shown, mut rest) = (String::new(), text);
    while let Some(at) = rest.find(BEGIN) {
        let (before, name) = rest.split_at(at);
        let tail = &name[BEGIN.len()..];
        let digits = tail.bytes().take_while(u8::is_ascii_hexdigit).count();
        shown += before;
        match tail.get(digits..).and_then(|tail| tail.strip_prefix(END)) {
            Some(after) if digits == DIGITS => rest = after.trim_start_matches(['/', '\\']),
            _ => {
                shown += BEGIN;
                rest = tail;
            }
        }
    }
    shown + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_files_by_their_final_names() {
        let cases = [
            ("out/.new.0123456789abcdef.part/labels.npy: full", "out/labels.npy: full"),
            (".new.0123456789abcdef.part/a, b.new.txt", "a, b.new.txt"),
            ("a.new.0123.part/b", "a.new.0123.part/b"),
            ("nothing", "nothing"),
        ];
        for (text, shown) in cases {
            assert_eq!(without_waiting_names(text), shown);
        }
    }
}

//! What goes to standard output and error, and small text files.

use anyhow::{Context, Result};
use scenesplat::scene::{AtomicFile, printable_text};
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Writes a text file, which appears when it is complete. Gives its size.
pub fn write_text(path: &Path, text: &str) -> Result<u64> {
    AtomicFile::write(path, text.as_bytes())?;
    Ok(text.len() as u64)
}

/// The first thing that went wrong with standard output.
static FAILED: Mutex<Option<std::io::Error>> = Mutex::new(None);

/// Writes text to standard output; [`check_output`] tells whether it got there.
pub fn print(text: &str) {
    note(writeln!(std::io::stdout(), "{}", printable_text(text)));
}

/// Notes what became of writing to standard output.
pub fn note(written: std::io::Result<()>) {
    if let Err(error) = written
        // Whoever reads no further, as `head` does, has what it wants.
        && error.kind() != ErrorKind::BrokenPipe
    {
        FAILED.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// Whether everything that was printed got where it goes.
///
/// # Errors
/// If it did not, as on a full disk; a pipe that nobody reads any more is no error.
pub fn check_output() -> Result<()> {
    note(std::io::stdout().flush());
    match FAILED.lock().unwrap_or_else(PoisonError::into_inner).take() {
        Some(error) => Err(error).context("standard output: the results could not be written"),
        None => Ok(()),
    }
}

/// Writes an error with all its causes to standard error.
pub fn print_error(error: &anyhow::Error) {
    let text = without_waiting_names(&format!("{error:#}"));
    let _ = writeln!(std::io::stderr(), "error: {}", printable_text(&text));
    let missing = scenesplat::models::missing_kernels();
    if !missing.is_empty() {
        let names = missing.join(", ");
        let _ = writeln!(
            std::io::stderr(),
            "an operation asked for CUDA kernels that this program has not: {names} (docs/devices.md); compute on cpu"
        );
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

//! What goes to standard output and error, and small text files.

use anyhow::Result;
use scenesplat::scene::AtomicFile;
use std::io::Write;
use std::path::Path;

/// Writes a text file, which appears when it is complete. Gives its size.
pub fn write_text(path: &Path, text: &str) -> Result<u64> {
    AtomicFile::write(path, text.as_bytes())?;
    Ok(text.len() as u64)
}

/// Writes text to standard output.
pub fn print(text: &str) {
    // A closed pipe is no reason to fail.
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Writes an error with all its causes to standard error.
pub fn print_error(error: &anyhow::Error) {
    let _ = writeln!(std::io::stderr(), "error: {error:#}");
}

//! What goes to standard output and error, and small text files.

use anyhow::{Context, Result};
use std::io::Write;
use std::path::Path;

/// Writes a text file beside its place and renames it. Gives its size.
pub fn write_text(path: &Path, text: &str) -> Result<u64> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".partial");
    std::fs::write(&beside, text)
        .and_then(|()| std::fs::rename(&beside, path))
        .with_context(|| path.display().to_string())?;
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

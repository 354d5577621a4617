//! The vectors of a phrase table.

use crate::outputs::Outputs;
use crate::progress::Progress;
use crate::terminal::print;
use anyhow::Result;
use scenesplat::phrases::{PhraseTable, TextEncoder};
use std::path::Path;

/// Encodes the phrases and writes their vectors.
pub fn run(
    outputs: &Outputs,
    encoder: &TextEncoder,
    phrases: Vec<String>,
    path: &Path,
) -> Result<()> {
    let (progress, count) = (Progress::new(false), phrases.len());
    let table = PhraseTable::build(encoder, phrases, &mut |done| {
        progress.advance("encoding", done as f64 / count.max(1) as f64);
    })?;
    progress.finish();
    let bytes = table.to_bytes()?;
    outputs.file(path, &bytes)?;
    let (phrases, numbers, size) = (table.len(), table.dim(), bytes.len());
    print(&format!("{}: {phrases} phrases, {numbers} numbers each, {size} bytes", path.display()));
    Ok(())
}

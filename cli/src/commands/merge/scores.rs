//! The figures of `evaluate` over all scenes.

use crate::commands::evaluate::{EVALUATION, Written, tell_report};
use crate::commands::many::Record;
use anyhow::{Context, Result, bail};
use scenesplat::evaluation::EvaluationReport;
use serde_json::{Value, json};
use std::path::Path;

/// Prints and gives what `evaluate` would say of all scenes at once, but for its time.
///
/// # Errors
/// If a part cannot be read, or is about other classes.
pub fn total(folder: &Path, records: &[Record]) -> Result<Value> {
    let mut parts: Vec<Written> = Vec::with_capacity(records.len());
    for record in records {
        let path = folder.join(&record.name).join(EVALUATION);
        let part = Written::read(&path)?;
        if let Some(first) = parts.first()
            && (first.classes != part.classes
                || first.excluded != part.excluded
                || first.vote_k != part.vote_k)
        {
            bail!("{}: other classes or votes than {}", path.display(), records[0].name);
        }
        parts.push(part);
    }
    let report = EvaluationReport::sum(parts.iter().map(|part| &part.counts))
        .context("the evaluations cannot be added up: some scored labels and some did not")?;
    let first = parts.first().context("there is no scene")?;
    let meaningless = parts.iter().any(|part| part.meaningless);
    let mut json = tell_report(&report, &first.classes, meaningless);
    json["scenes"] = json!(parts.len());
    json["excluded"] = first.excluded.clone();
    json["vote_k"] = first.vote_k.clone();
    Ok(json)
}

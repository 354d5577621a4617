//! Scenes as rows.

use crate::commands::many::Record;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// What is the same each time.
pub fn figures(record: &Record) -> Value {
    json!({
        "name": record.name, "scene": record.scene, "inputs": record.job.inputs,
        "rows_in": record.rows_in, "rows_out": record.rows_out, "outputs": record.outputs,
    })
}

/// As a table.
pub fn markdown(command: &str, records: &[Record]) -> String {
    let mut text = format!("# {command}: {} scenes\n\n", records.len());
    text += "| scene | Gaussians read | written | files | MB |\n|---|---:|---:|---:|---:|\n";
    for r in records {
        let bytes: u64 = r.outputs.iter().map(|output| output.bytes).sum();
        let megabytes = bytes as f64 / 1e6;
        let name = r.name.replace('|', "\\|");
        let row = (r.rows_in, r.rows_out, r.outputs.len());
        // Writing to a string cannot fail.
        let _ = writeln!(text, "| {name} | {} | {} | {} | {megabytes:.2} |", row.0, row.1, row.2);
    }
    text
}

/// Time and memory.
pub fn costs(records: &[Record]) -> Value {
    let mut stages: BTreeMap<&str, f64> = BTreeMap::new();
    for stage in
        records.iter().flat_map(|r| &r.cost.stages).filter(|stage| !stage.name.contains('/'))
    {
        *stages.entry(&stage.name).or_default() += stage.seconds;
    }
    let seconds: f64 = records.iter().map(|r| r.cost.seconds).sum();
    let each = |r: &Record| json!({ "name": r.name, "seconds": r.cost.seconds, "peak_memory_bytes": r.cost.peak_memory_bytes });
    json!({
        "seconds": seconds,
        "mean_seconds": seconds / records.len().max(1) as f64,
        "stages": stages,
        "peak_memory_bytes": records.iter().filter_map(|r| r.cost.peak_memory_bytes).max(),
        "scenes": records.iter().map(each).collect::<Vec<_>>(),
    })
}

/// One line.
pub fn summary(records: &[Record]) -> String {
    let rows: u64 = records.iter().map(|r| r.rows_in).sum();
    let seconds: f64 = records.iter().map(|r| r.cost.seconds).sum();
    let mean = seconds / records.len().max(1) as f64;
    format!(
        "{} scenes, none missing: {rows} Gaussians, {seconds:.1} s of work, {mean:.2} s a scene",
        records.len()
    )
}

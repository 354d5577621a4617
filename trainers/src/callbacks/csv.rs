//! The log as a table, for spreadsheets and data frames.

use super::json_lines::LoggedValue;
use crate::TrainError;
use scenesplat_scene::AtomicFile;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

/// Writes a log as comma-separated values: a row for each step, with its epoch, and a column for each name. What was
/// not measured at a step is empty.
///
/// # Errors
/// If the file cannot be written.
pub fn write_csv(log: &[LoggedValue], path: &Path) -> Result<(), TrainError> {
    AtomicFile::write(path, table(log).as_bytes())?;
    Ok(())
}

fn table(log: &[LoggedValue]) -> String {
    let names: BTreeSet<&str> = log.iter().map(|value| value.name.as_str()).collect();
    let mut rows: BTreeMap<u64, (u64, BTreeMap<&str, f64>)> = BTreeMap::new();
    for value in log {
        let row = rows.entry(value.step).or_insert_with(|| (value.epoch, BTreeMap::new()));
        row.1.insert(&value.name, value.value);
    }
    let mut text = String::from("step,epoch");
    names.iter().for_each(|name| {
        text.push(',');
        text.push_str(&cell(name));
    });
    text.push('\n');
    for (step, (epoch, values)) in rows {
        let _ = write!(text, "{step},{epoch}");
        for name in &names {
            text.push(',');
            if let Some(value) = values.get(name) {
                let _ = write!(text, "{value}");
            }
        }
        text.push('\n');
    }
    text
}

/// A text as a cell; in quotes if it would be read as several.
fn cell(text: &str) -> String {
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_a_step_and_a_column_a_name() {
        let value = |step, epoch, name: &str, value| LoggedValue {
            step,
            epoch,
            name: name.to_owned(),
            value,
        };
        let log = [
            value(1, 0, "train/loss", 0.5),
            value(1, 0, "train/grad_norm", 2.0),
            value(2, 0, "train/loss", f64::NAN),
            value(2, 0, "a,\"b\"/mIoU", 1e-7),
        ];
        let expected = "step,epoch,\"a,\"\"b\"\"/mIoU\",train/grad_norm,train/loss\n\
                        1,0,,2,0.5\n2,0,0.0000001,,NaN\n";
        assert_eq!(table(&log), expected);
        assert_eq!(table(&[]), "step,epoch\n");
    }
}

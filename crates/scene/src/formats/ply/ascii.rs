//! Ascii PLY data, converted to the binary form once.

use super::header::{Header, PlyPropertyKind, PlyType};
use crate::SceneError;
use std::path::Path;

/// Little-endian binary data that say the same, and the number of bytes after the last row.
///
/// One row is one line; blank lines are skipped. A line with too few or too many values is an
/// error rather than a shift of everything after it.
pub(super) fn to_binary(
    text: &[u8],
    header: &Header,
    path: &Path,
) -> Result<(Vec<u8>, usize), SceneError> {
    check_counts(text, header, path)?;
    let mut out = Vec::new();
    let mut lines = Lines { text, at: 0 };
    for element in &header.elements {
        if element.properties.is_empty() {
            continue;
        }
        for row in 0..element.count {
            let bad = |problem: String| {
                let problem = format!("element {}, row {row}: {problem}", element.name);
                SceneError::format(path, problem, "")
            };
            let Some(line) = lines.next_row() else {
                return Err(bad(format!("the file ends here, {} rows are due", element.count)));
            };
            let mut words = line.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty());
            for property in &element.properties {
                let mut value = |ty: PlyType| -> Result<f64, SceneError> {
                    let word = words.next();
                    let word = word
                        .ok_or_else(|| bad(format!("no value for property {}", property.name)))?;
                    push(word, ty, &mut out).ok_or_else(|| {
                        let word = String::from_utf8_lossy(&word[..word.len().min(40)]);
                        bad(format!(
                            "property {} holds {word:?}, which is no {}",
                            property.name,
                            ty.name()
                        ))
                    })
                };
                match property.kind {
                    PlyPropertyKind::Scalar(ty) => {
                        value(ty)?;
                    }
                    PlyPropertyKind::List { count, item } => {
                        let length = value(count)?;
                        // A length is a whole number of at most 32 bits; `value` ends a list
                        // that promises more than its line holds.
                        for _ in 0..length.max(0.0) as u64 {
                            value(item)?;
                        }
                    }
                }
            }
            if words.next().is_some() {
                return Err(bad("more values than properties".to_owned()));
            }
        }
    }
    let rest = &text[lines.at..];
    let leftover = if rest.iter().all(u8::is_ascii_whitespace) { 0 } else { rest.len() };
    Ok((out, leftover))
}

/// Refuses counts that the file is too short for, before any row is read.
fn check_counts(text: &[u8], header: &Header, path: &Path) -> Result<(), SceneError> {
    let mut words = 0u128;
    for element in &header.elements {
        words += element.count as u128 * element.properties.len() as u128;
        // A value is at least one character and, but for the last, a separator.
        if (words * 2).saturating_sub(1) > text.len() as u128 {
            return Err(SceneError::format(
                path,
                format!(
                    "element {} should have {} rows of {} values, but the file has only {} bytes \
                     of data",
                    element.name,
                    element.count,
                    element.properties.len(),
                    text.len()
                ),
                "the file is cut short, or its header counts too many rows",
            ));
        }
    }
    Ok(())
}

struct Lines<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> Lines<'a> {
    /// The next line that is not blank.
    fn next_row(&mut self) -> Option<&'a [u8]> {
        while self.at < self.text.len() {
            let rest = &self.text[self.at..];
            let length = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
            self.at += (length + 1).min(rest.len());
            let line = &rest[..length];
            if !line.iter().all(u8::is_ascii_whitespace) {
                return Some(line);
            }
        }
        None
    }
}

/// Appends the value of a word; `None` if it is no value of that type.
fn push(word: &[u8], ty: PlyType, out: &mut Vec<u8>) -> Option<f64> {
    let word = std::str::from_utf8(word).ok()?;
    if ty == PlyType::F32 {
        // Parsed at its own precision: by way of f64 it would be rounded twice.
        let value = word.parse::<f32>().ok().or_else(|| c_library_name(word).map(|v| v as f32))?;
        out.extend_from_slice(&value.to_le_bytes());
        return Some(f64::from(value));
    }
    if ty == PlyType::F64 {
        let value = word.parse::<f64>().ok().or_else(|| c_library_name(word))?;
        out.extend_from_slice(&value.to_le_bytes());
        return Some(value);
    }
    let value = match word.parse::<i64>() {
        Ok(value) => value,
        // Some writers put `3.0` or `3e0` into integer columns.
        Err(_) => {
            let value = word.parse::<f64>().ok()?;
            if value.fract() != 0.0 || value.abs() > 4e9 {
                return None;
            }
            value as i64
        }
    };
    match ty {
        PlyType::I8 => out.extend_from_slice(&i8::try_from(value).ok()?.to_le_bytes()),
        PlyType::U8 => out.extend_from_slice(&u8::try_from(value).ok()?.to_le_bytes()),
        PlyType::I16 => out.extend_from_slice(&i16::try_from(value).ok()?.to_le_bytes()),
        PlyType::U16 => out.extend_from_slice(&u16::try_from(value).ok()?.to_le_bytes()),
        PlyType::I32 => out.extend_from_slice(&i32::try_from(value).ok()?.to_le_bytes()),
        _ => out.extend_from_slice(&u32::try_from(value).ok()?.to_le_bytes()),
    }
    Some(value as f64)
}

/// The spellings of NaN and infinity by C libraries: `-nan(ind)`, `1.#QNAN`, `-1.#INF`.
fn c_library_name(word: &str) -> Option<f64> {
    let lower = word.to_ascii_lowercase();
    let negative = lower.starts_with('-');
    let name = lower.trim_start_matches(['+', '-']);
    if name.starts_with("1.#inf") {
        return Some(if negative { f64::NEG_INFINITY } else { f64::INFINITY });
    }
    (name.starts_with("1.#") || name.starts_with("nan(")).then_some(f64::NAN)
}

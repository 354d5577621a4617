//! Files that extend others, and variables in them.

use super::Result;
use crate::experiment::error::{ExperimentError, Place};
use scenesplat_models::BackboneConfig;
use std::path::{Path, PathBuf};

/// A file joined with those it extends. `seen`: the files on the way here.
pub(super) fn read_table(
    path: &Path,
    variable: &dyn Fn(&str) -> Option<String>,
    seen: &mut Vec<PathBuf>,
) -> Result<toml::Table> {
    let place = || path.display().to_string();
    let here = path.canonicalize().map_err(ExperimentError::io(path))?;
    if seen.contains(&here) {
        return Err(ExperimentError::Circle { path: path.to_owned() });
    }
    seen.push(here);
    let text = scenesplat_scene::input_file::read_text_file(path)?;
    let text = with_variables(&text, variable).at(place)?;
    // Without the line, which may be one of a file that this configuration should not name.
    let mut own = text.parse::<toml::Table>().map_err(|e| not_toml(&text, &e)).at(place)?;
    let Some(base) = own.remove("extends") else { return Ok(own) };
    let toml::Value::String(base) = base else {
        let problem = format!("expected the path of a file, got {base}");
        return Err(ExperimentError::setting("extends", problem)).at(place);
    };
    let base = path.parent().unwrap_or(Path::new("")).join(base);
    let mut joined = read_table(&base, variable, seen)?;
    join(&mut joined, own);
    Ok(joined)
}

/// Where a file is no TOML, and why, without what stands there.
fn not_toml(text: &str, error: &toml::de::Error) -> ExperimentError {
    let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
    let line = 1 + before.matches('\n').count();
    ExperimentError::setting(format!("line {line}"), format!("no TOML: {}", error.message()))
}

/// Replaces `${NAME}` by its value.
fn with_variables(text: &str, variable: &dyn Fn(&str) -> Option<String>) -> Result<String> {
    let mut out = String::with_capacity(text.len());
    for (number, line) in text.lines().enumerate() {
        let code = line.split('#').next().unwrap_or("");
        let mut rest = line;
        // A variable in a comment is an example.
        while let (Some(start), true) = (rest.find("${"), code.contains("${")) {
            let Some(length) = rest[start..].find('}') else { break };
            let name = &rest[start + 2..start + length];
            let value = variable(name).ok_or_else(|| {
                ExperimentError::setting(format!("${{{name}}}"), "set this environment variable")
            });
            let value = value.at(|| format!("line {}", number + 1))?;
            out.push_str(&rest[..start]);
            out.push_str(&value);
            rest = &rest[start + length + 1..];
        }
        out.push_str(rest);
        out.push('\n');
    }
    Ok(out)
}

/// Sets what a change such as `trainer.epochs=3` says.
pub(super) fn set(table: &mut toml::Table, change: &str) -> Result<()> {
    let wrong = |problem: String| ExperimentError::setting(change, problem);
    let Some((path, text)) = change.split_once('=') else {
        return Err(wrong("expected KEY=VALUE, as in trainer.epochs=3".to_owned()));
    };
    let (path, text) = (path.trim(), text.trim());
    // Names of presets, precisions and files need no quotes.
    let value = format!("value = {text}").parse::<toml::Table>().ok();
    let value = value.and_then(|mut table| table.remove("value"));
    let value = value.unwrap_or_else(|| toml::Value::String(text.to_owned()));
    let (parents, name) = path.rsplit_once('.').map_or((None, path), |(p, n)| (Some(p), n));
    if path.split('.').any(str::is_empty) {
        return Err(wrong(format!("{path:?} is no path of a setting")));
    }
    let mut at = table;
    let mut keys = parents.into_iter().flat_map(|parents| parents.split('.'));
    while let Some(key) = keys.next() {
        let entry = at.entry(key).or_insert_with(|| toml::Value::Table(toml::Table::new()));
        at = match entry {
            toml::Value::Table(inner) => inner,
            toml::Value::Array(list) => {
                let count = list.len();
                let index = keys.next().and_then(|index| index.parse::<usize>().ok());
                let tables = list.iter_mut().map(toml::Value::as_table_mut);
                let found = index.and_then(|index| tables.into_iter().nth(index)).flatten();
                found.ok_or_else(|| {
                    wrong(format!("{key} is a list of {count}: {key}.0 is the first of its tables"))
                })?
            }
            other => return Err(wrong(format!("{key} is {other}, and holds no settings"))),
        };
    }
    if let Some(toml::Value::Array(list)) = at.get(name)
        && list.iter().any(toml::Value::is_table)
        && !value.is_array()
    {
        return Err(wrong(format!("{name} is a list of {}, not a value", list.len())));
    }
    at.insert(name.to_owned(), value);
    Ok(())
}

/// Puts `own` over `base`. A table that changes its `type` replaces the other: its fields are none
/// of the new one's.
fn join(base: &mut toml::Table, own: toml::Table) {
    for (key, value) in own {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(old)), toml::Value::Table(new)) if !is_another(old, &new) => {
                join(old, new);
            }
            (_, value) => _ = base.insert(key, value),
        }
    }
}

/// Whether a table is about something else than the other: its `type` or its `architecture` differs.
fn is_another(old: &toml::Table, new: &toml::Table) -> bool {
    let name = |table: &toml::Table, default: &str| match table.get("architecture") {
        Some(toml::Value::String(name)) => name.clone(),
        _ => default.to_owned(),
    };
    let usual = name(old, BackboneConfig::NAMES[0]);
    name(new, &usual) != usual || (new.contains_key("type") && new.get("type") != old.get("type"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> toml::Table {
        text.parse().unwrap()
    }

    #[test]
    fn files_are_joined() {
        let mut base = table("a = 1\nlist = [1, 2]\n[t]\nx = 1\ny = 2\n[s]\ntype = 'p'\nq = 1");
        join(&mut base, table("list = [3]\n[t]\ny = 5\n[s]\ntype = 'other'"));
        let expected = table("a = 1\nlist = [3]\n[t]\nx = 1\ny = 5\n[s]\ntype = 'other'");
        assert_eq!(base, expected);
    }

    #[test]
    fn another_architecture_takes_no_fields() {
        let mut base = table("[model]\nstride = [2]\nmlp_ratio = 2");
        let same = "[model]\narchitecture = 'point_transformer_v3'\nstride = [4]";
        join(&mut base, table(same));
        assert_eq!(base, table(&format!("{same}\nmlp_ratio = 2")));
        let other = "[model]\narchitecture = 'point_transformer_v2'\nstride = [3]";
        join(&mut base, table(other));
        assert_eq!(base, table(other));
        join(&mut base, table("[model]\nstride = [2]"));
        assert_eq!(base, table(&other.replace('3', "2")));
    }

    #[test]
    fn a_file_that_is_no_toml_is_not_shown() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("a.toml"), "extends = 'accounts'").unwrap();
        std::fs::write(at("accounts"), "x = 1\nroot:secret:0:0\n").unwrap();
        let none = |_: &str| None;
        let error = read_table(&at("a.toml"), &none, &mut Vec::new()).unwrap_err();
        let text = format!("{:#}", anyhow::Error::from(error));
        assert!(text.contains("accounts") && text.contains("line 2"), "{text}");
        assert!(!text.contains("secret") && !text.contains("root"), "{text}");
    }

    #[test]
    fn unset_variables_are_named_with_their_line() {
        let none = |_: &str| None;
        let error = with_variables("x = 1\ny = '${ROOT}'", &none).unwrap_err();
        let text = format!("{:#}", anyhow::Error::from(error));
        assert!(text.contains("line 2") && text.contains("${ROOT}"), "{text}");
        assert_eq!(with_variables("# ${ROOT}", &none).unwrap(), "# ${ROOT}\n");
        let some = |name: &str| Some(format!("/{name}"));
        assert_eq!(with_variables("a = '${X}/b/${Y}'", &some).unwrap(), "a = '/X/b//Y'\n");
    }
}

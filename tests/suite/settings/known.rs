//! Which settings there are, as the program says itself when it refuses one.

use scenesplat::datasets::transforms::TransformConfig;
use scenesplat::experiment::ExperimentConfig;
use serde_json::{Value, json};
use std::collections::BTreeSet;

pub const UNKNOWN: &str = "zzz_no_setting";

/// Names that an error offers.
pub fn offered(error: &str) -> Option<Vec<String>> {
    let (_, rest) = error.split_once(&format!("`{UNKNOWN}`"))?;
    let names = rest.split('`').skip(1).step_by(2);
    Some(names.map(str::to_owned).collect())
}

/// Fields of the table at `pointer`; `None` if it is a value with a name, such as `{ last = 75.0 }`.
pub fn fields_of(config: &Value, pointer: &str) -> Option<Vec<String>> {
    let mut config = config.clone();
    let table = config.pointer_mut(pointer).unwrap().as_object_mut().unwrap();
    table.insert(UNKNOWN.to_owned(), json!(1));
    let mut fields: Vec<String> = table.keys().cloned().collect();
    let error = serde_json::from_value::<ExperimentConfig>(config).unwrap_err().to_string();
    if error.contains("map with a single key") {
        return None;
    }
    let offered = offered(&error).unwrap_or_else(|| panic!("{pointer}: {error}"));
    // What a table reads before it asks its parts for the rest.
    fields.retain(|name| name != UNKNOWN && !offered.contains(name));
    Some(fields.into_iter().chain(offered).collect())
}

/// Names that may stand at `pointer`.
pub fn names_of(config: &Value, pointer: &str) -> Vec<String> {
    let mut config = config.clone();
    *config.pointer_mut(pointer).unwrap() = json!(UNKNOWN);
    let error = serde_json::from_value::<ExperimentConfig>(config).unwrap_err().to_string();
    if let Some(names) = offered(&error) {
        return names;
    }
    // The names of architectures are in a sentence.
    let (_, names) = error.split_once("known are ").unwrap_or_else(|| panic!("{error}"));
    names.split(", ").map(str::to_owned).collect()
}

/// What kind of table it is.
pub fn kind(table: &Value) -> Option<&str> {
    ["type", "architecture"].iter().find_map(|field| table.get(*field)).and_then(Value::as_str)
}

/// The name that [`settings_of`] gives to the setting at `pointer`.
pub fn name_of(config: &Value, pointer: &str) -> String {
    let (mut name, mut at) = (String::new(), String::new());
    for part in pointer.split('/').skip(1) {
        if let Some(kind) = config.pointer(&at).and_then(kind) {
            name += &format!("({kind})");
        }
        match part.parse::<usize>() {
            Ok(_) => name += "[*]",
            Err(_) if name.is_empty() => name += part,
            Err(_) => name += &format!(".{part}"),
        }
        at += &format!("/{part}");
    }
    name
}

/// All settings of an experiment, as `train[*].source(generic).root`.
pub fn settings_of(config: &Value) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    walk(config, "", "", &mut found);
    found
}

fn walk(config: &Value, pointer: &str, name: &str, found: &mut BTreeSet<String>) {
    let value = config.pointer(pointer).unwrap();
    let table = value.as_object().unwrap();
    let name = match kind(value) {
        Some(kind) => format!("{name}({kind})"),
        None => name.to_owned(),
    };
    let Some(fields) = fields_of(config, pointer) else {
        found.insert(name);
        return;
    };
    for field in fields {
        let here = if name.is_empty() { field.clone() } else { format!("{name}.{field}") };
        let at = format!("{pointer}/{field}");
        match table.get(&field) {
            // Steps have a test of their own.
            Some(_) if field == "transforms" => _ = found.insert(here),
            Some(Value::Object(_)) => walk(config, &at, &here, found),
            Some(Value::Array(entries)) if entries.iter().any(Value::is_object) => {
                for i in 0..entries.len() {
                    walk(config, &format!("{at}/{i}"), &format!("{here}[*]"), found);
                }
            }
            _ => _ = found.insert(here),
        }
    }
}

/// Steps of transforms with their fields.
pub fn steps() -> Vec<(String, Vec<String>)> {
    let ask = |step: Value| {
        let error = serde_json::from_value::<TransformConfig>(step).unwrap_err().to_string();
        offered(&error).unwrap_or_else(|| panic!("{error}"))
    };
    let names = ask(json!({ "type": UNKNOWN }));
    let with_fields = |name: String| {
        let fields = ask(json!({ "type": name, UNKNOWN: 1 }));
        (name, fields)
    };
    names.into_iter().map(with_fields).collect()
}

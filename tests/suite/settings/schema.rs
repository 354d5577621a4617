//! The JSON schema of experiments: what `scenesplat schema train` prints is what the program takes. It is made here, by
//! asking the program itself, as the list of settings is; `SCENESPLAT_WRITE_SCHEMA=1` writes it.

use super::bases::{self, read};
use super::known::{UNKNOWN, fields_of, kind, names_of, offered, steps};
use super::{Data, holds};
use scenesplat::experiment::{ExperimentConfig, SCHEMA};
use scenesplat_test_support::schema_problems;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The error of an experiment in which something else stands at a place; empty if there is none.
fn error(config: &Value, pointer: &str, value: Value) -> String {
    let mut config = config.clone();
    super::set(&mut config, pointer, value);
    let read = serde_json::from_value::<ExperimentConfig>(config);
    read.err().map_or(String::new(), |error| error.to_string())
}

/// What may stand where no table does.
fn leaf(config: &Value, pointer: &str) -> Value {
    let of_table = error(config, pointer, json!({ UNKNOWN: 1 }));
    let of_text = error(config, pointer, json!(UNKNOWN));
    if let Some(names) = offered(&of_text).filter(|names| !names.is_empty()) {
        let names = json!({ "enum": names });
        return match offered(&of_table) {
            // Some of the names may take values.
            Some(_) => json!({ "anyOf": [names, { "type": "object" }] }),
            None => names,
        };
    }
    let expected = |name: &str| of_table.contains(&format!("expected {name}"));
    if ["usize", "u64", "u32", "i32", "i64", "a count"].into_iter().any(expected) {
        json!({ "type": "integer" })
    } else if ["f64", "f32", "a length in meters"].into_iter().any(expected) {
        json!({ "type": "number" })
    } else if expected("a boolean") {
        json!({ "type": "boolean" })
    } else if ["a string", "path string"].into_iter().any(expected) {
        json!({ "type": "string" })
    } else if ["a sequence", "an array"].into_iter().any(expected) {
        json!({ "type": "array" })
    } else {
        json!({})
    }
}

fn table(fields: Map<String, Value>) -> Value {
    json!({ "type": "object", "properties": Value::Object(fields), "additionalProperties": false })
}

/// The schema of a table with what stands in it.
fn walked(config: &Value, pointer: &str) -> Value {
    let value = config.pointer(pointer).unwrap();
    let Some(names) = fields_of(config, pointer) else { return json!({}) };
    let mut fields = Map::new();
    for name in names {
        let at = format!("{pointer}/{name}");
        let schema = match value.get(&name) {
            Some(_) if name == "transforms" => transforms(),
            Some(Value::Object(_)) => walked(config, &at),
            Some(Value::Array(entries)) if entries.iter().any(Value::is_object) => {
                let each = (0..entries.len()).map(|i| walked(config, &format!("{at}/{i}")));
                json!({ "type": "array", "items": each.reduce(merged).unwrap() })
            }
            _ if ["type", "architecture"].contains(&&*name) => {
                json!({ "enum": names_of(config, &at) })
            }
            _ => leaf(config, &at),
        };
        fields.insert(name, schema);
    }
    match kind(value).map(str::to_owned) {
        Some(kind) => json!({ "kinds": { kind: table(fields) } }),
        None => table(fields),
    }
}

/// A preset, or steps with their fields.
fn transforms() -> Value {
    let step = |(name, fields): (String, Vec<String>)| {
        let fields = fields.into_iter().map(|field| (field, json!({})));
        let mut fields: Map<String, Value> = fields.collect();
        fields.insert("type".to_owned(), json!({ "const": name }));
        table(fields)
    };
    let steps: Vec<Value> = steps().into_iter().map(step).collect();
    json!({ "anyOf": [{ "type": "string" }, { "type": "array", "items": { "anyOf": steps } }] })
}

/// What either of two experiments shows of the same place.
fn merged(a: Value, b: Value) -> Value {
    let said = |schema: &Value| schema.as_object().is_some_and(|fields| !fields.is_empty());
    let parts = ["properties", "kinds"].map(|part| (part, a[part].clone(), b[part].clone()));
    for (part, first, second) in parts {
        if let (Value::Object(mut first), Value::Object(second)) = (first, second) {
            for (name, schema) in second {
                let joined = match first.remove(&name) {
                    Some(known) => merged(known, schema),
                    None => schema,
                };
                first.insert(name, joined);
            }
            let mut joined = a.clone();
            joined[part] = first.into();
            return joined;
        }
    }
    if a["items"].is_object() && b["items"].is_object() {
        return json!({ "type": "array", "items": merged(a["items"].clone(), b["items"].clone()) });
    }
    let is_rich = |schema: &Value| {
        ["properties", "kinds", "items"].iter().any(|part| schema[*part].is_object())
    };
    match () {
        () if a == b || !said(&b) || is_rich(&a) => a,
        () if !said(&a) || is_rich(&b) => b,
        () => json!({}),
    }
}

/// Kinds of tables as alternatives; of a kind that no experiment shows, the fields of one that shares them.
fn finished(schema: Value, base: &Value) -> Value {
    match schema {
        Value::Object(mut fields) => {
            if let Some(Value::Object(kinds)) = fields.remove("kinds") {
                let mut kinds: BTreeMap<String, Value> = kinds.into_iter().collect();
                if let Some(shared) = kinds.get("replica").cloned() {
                    for name in names_of(base, "/train/0/source/type") {
                        kinds.entry(name).or_insert_with(|| shared.clone());
                    }
                }
                let each = kinds.into_iter().map(|(kind, schema)| {
                    let mut schema = finished(schema, base);
                    let fields = schema["properties"].as_object_mut().unwrap();
                    for name in ["type", "architecture"] {
                        if fields.contains_key(name) {
                            fields.insert(name.to_owned(), json!({ "const": kind }));
                        }
                    }
                    schema
                });
                return json!({ "anyOf": each.collect::<Vec<_>>() });
            }
            let each = fields.into_iter().map(|(name, part)| (name, finished(part, base)));
            Value::Object(each.collect())
        }
        Value::Array(parts) => parts.into_iter().map(|part| finished(part, base)).collect(),
        other => other,
    }
}

#[test]
fn the_schema_is_what_the_program_takes() {
    let data = Data::new();
    let configs: Vec<Value> = bases::ALL.iter().map(|(name, _)| read(&data, name)).collect();
    assert!(configs.iter().any(|config| holds(config, "type", "replica")));
    let whole = configs.iter().map(|config| walked(config, "")).reduce(merged).unwrap();
    let mut schema = finished(whole, &configs[0]);
    schema["properties"]["extends"] = json!({ "type": "string" });
    schema["$schema"] = "http://json-schema.org/draft-07/schema#".into();
    schema["title"] = "An experiment of scenesplat train".into();
    let text = serde_json::to_string_pretty(&schema).unwrap() + "\n";
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/experiment/train.schema.json");
    if std::env::var_os("SCENESPLAT_WRITE_SCHEMA").is_some() {
        std::fs::write(path, &text).unwrap();
    }
    let stored = std::fs::read_to_string(path).unwrap();
    assert!(stored == text, "settings have changed: SCENESPLAT_WRITE_SCHEMA=1 writes the schema");
}

/// A TOML file as JSON.
fn file(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap();
    serde_json::to_value(text.parse::<toml::Table>().unwrap()).unwrap()
}

#[test]
fn every_file_of_the_project_fits_the_schema_and_a_misspelt_one_does_not() {
    let schema: Value = serde_json::from_str(SCHEMA).unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let mut folders = vec![root.clone()];
    let mut count = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !["pareto", "class_maps"].iter().any(|n| path.ends_with(n)) {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "toml") {
                let problems = schema_problems(&schema, &file(&path));
                assert!(problems.is_empty(), "{}: {problems:?}", path.display());
                count += 1;
            }
        }
    }
    assert!(count >= 79, "{count}");
    let good = file(&root.join("semantic_segmentation/synthetic_rooms.toml"));
    for (pointer, value) in [
        ("/trainer/epoch", json!(3)),
        ("/trainer/epochs", json!("many")),
        ("/task", json!("segmentation")),
        ("/train/0/source/cuont", json!(3)),
        ("/losses/0/type", json!("cross_entropie")),
        ("/model/architecture", json!("transformer")),
        ("/limits", json!({ "trian": 3 })),
    ] {
        let mut bad = good.clone();
        super::set(&mut bad, pointer, value);
        assert!(!schema_problems(&schema, &bad).is_empty(), "{pointer}");
    }
}

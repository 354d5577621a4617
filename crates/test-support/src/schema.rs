//! The part of JSON schemas that ours use.

use serde_json::Value;

/// Where a value does not fit a schema, and how.
///
/// Knows `type`, `properties` with `additionalProperties: false`, `items`, `enum`, `const`, `required` and `anyOf`.
pub fn schema_problems(schema: &Value, value: &Value) -> Vec<String> {
    let mut problems = Vec::new();
    check(schema, value, "", &mut problems);
    problems
}

fn check(schema: &Value, value: &Value, at: &str, problems: &mut Vec<String>) {
    let known = [
        "$schema",
        "title",
        "description",
        "type",
        "properties",
        "additionalProperties",
        "items",
        "enum",
        "const",
        "required",
        "anyOf",
    ];
    let fields = schema.as_object().unwrap();
    assert!(fields.keys().all(|key| known.contains(&&**key)), "{at}: {:?}", fields.keys());
    let fits = match schema["type"].as_str() {
        Some("object") => value.is_object(),
        Some("array") => value.is_array(),
        Some("string") => value.is_string(),
        Some("boolean") => value.is_boolean(),
        Some("integer") => value.is_i64() || value.is_u64(),
        Some("number") => value.is_number(),
        Some(other) => panic!("{at}: type {other}"),
        None => true,
    };
    let names = schema["enum"].as_array();
    let named = names.is_none_or(|names| names.contains(value));
    if !fits || !named || fields.get("const").is_some_and(|only| only != value) {
        problems.push(format!("{at}: {value} is none of {schema}"));
    }
    for name in schema["required"].as_array().into_iter().flatten() {
        if value.get(name.as_str().unwrap()).is_none() {
            problems.push(format!("{at}: no {name}"));
        }
    }
    if let (Some(inner), Some(table)) = (schema["properties"].as_object(), value.as_object()) {
        for (name, value) in table {
            match inner.get(name) {
                Some(schema) => check(schema, value, &format!("{at}/{name}"), problems),
                None if schema["additionalProperties"] == false => {
                    problems.push(format!("{at}: {name} is unknown"));
                }
                None => {}
            }
        }
    }
    if let (Some(_), Some(list)) = (fields.get("items"), value.as_array()) {
        for (i, entry) in list.iter().enumerate() {
            check(&schema["items"], entry, &format!("{at}/{i}"), problems);
        }
    }
    if let Some(choices) = schema["anyOf"].as_array() {
        let of = |choice| {
            let mut found = Vec::new();
            check(choice, value, at, &mut found);
            found
        };
        let all: Vec<Vec<String>> = choices.iter().map(of).collect();
        if !all.iter().any(Vec::is_empty) {
            problems.extend(all.into_iter().min_by_key(Vec::len).into_iter().flatten());
        }
    }
}

//! What a run is, setting by setting, so that a checkpoint can refuse to go on as another one.

use crate::TrainError;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// The settings that decide the bits of a run: names with their values as JSON text.
///
/// Names are those of a configuration file, nested ones joined by dots (`trainer.accumulate`), entries
/// of lists of tables by number (`losses[1].weight`). Lists of plain values are one setting.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Identity(BTreeMap<String, String>);

/// One setting that two runs do not share.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// Its name.
    pub setting: String,
    /// Its value in the checkpoint; "absent" if it has none there.
    pub was: String,
    /// Its value now.
    pub is: String,
}

impl Identity {
    /// Without any setting.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds every setting of a configuration, under `prefix` (none if empty).
    ///
    /// # Errors
    /// If it cannot be written as JSON.
    pub fn with_settings(
        mut self,
        prefix: &str,
        settings: &impl Serialize,
    ) -> Result<Self, TrainError> {
        let value = serde_json::to_value(settings).map_err(|e| TrainError::Unwritable {
            what: prefix.to_owned(),
            problem: e.to_string(),
        })?;
        self.insert(prefix, &value);
        Ok(self)
    }

    /// Adds one setting.
    #[must_use]
    pub fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.insert(name, &value.into());
        self
    }

    /// Leaves out settings, with everything inside them; `[*]` in a name stands for any number.
    #[must_use]
    pub fn without<'a>(mut self, names: impl IntoIterator<Item = &'a str>) -> Self {
        let names: Vec<&str> = names.into_iter().collect();
        self.0.retain(|name, _| !names.iter().any(|left_out| is_inside(name, left_out)));
        self
    }

    /// Adds the settings of another one.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.0.extend(other.0);
        self
    }

    /// Names and values, by name.
    pub fn settings(&self) -> &BTreeMap<String, String> {
        &self.0
    }

    /// SHA-256 of names and values, in hexadecimal digits.
    pub fn hash(&self) -> String {
        let mut hash = Sha256::new();
        for (name, value) in &self.0 {
            hash.update(name.as_bytes());
            hash.update([0]);
            hash.update(value.as_bytes());
            hash.update([0]);
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// What is another value in `now`, by name.
    pub fn changes(&self, now: &Self) -> Vec<Change> {
        let names: std::collections::BTreeSet<&String> =
            self.0.keys().chain(now.0.keys()).collect();
        let value = |of: &Self, name: &String| of.0.get(name).cloned().unwrap_or("absent".into());
        names
            .into_iter()
            .filter(|name| self.0.get(*name) != now.0.get(*name))
            .map(|name| Change {
                setting: name.clone(),
                was: value(self, name),
                is: value(now, name),
            })
            .collect()
    }

    fn insert(&mut self, name: &str, value: &Value) {
        match value {
            Value::Object(fields) => {
                let dot = if name.is_empty() { "" } else { "." };
                for (field, value) in fields {
                    self.insert(&format!("{name}{dot}{field}"), value);
                }
            }
            Value::Array(entries) if entries.iter().any(Value::is_object) => {
                for (i, value) in entries.iter().enumerate() {
                    self.insert(&format!("{name}[{i}]"), value);
                }
            }
            // An absent setting and one that says "none" are the same.
            Value::Null => {}
            plain => _ = self.0.insert(name.to_owned(), plain.to_string()),
        }
    }
}

/// Whether `name` is the setting `pattern` or inside it.
fn is_inside(name: &str, pattern: &str) -> bool {
    let mut rest = name;
    for (i, part) in pattern.split("[*]").enumerate() {
        if i > 0 {
            let Some(number) = rest.strip_prefix('[').and_then(|r| r.split_once(']')) else {
                return false;
            };
            if number.0.parse::<usize>().is_err() {
                return false;
            }
            rest = number.1;
        }
        let Some(after) = rest.strip_prefix(part) else { return false };
        rest = after;
    }
    rest.is_empty() || rest.starts_with(['.', '['])
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn identity(value: Value) -> Identity {
        Identity::new().with_settings("", &value).unwrap()
    }

    #[test]
    fn settings_have_the_names_of_a_file() {
        let found = identity(json!({
            "seed": 1, "model": { "depths": [1, 2], "head": null }, "losses": [{ "weight": 0.5 }, {}],
        }));
        let names: Vec<_> = found.settings().iter().map(|(n, v)| format!("{n}={v}")).collect();
        assert_eq!(names, ["losses[0].weight=0.5", "model.depths=[1,2]", "seed=1"]);
    }

    #[test]
    fn changes_are_named_with_both_values() {
        let (a, b) =
            (identity(json!({"x": 1, "y": [1]})), identity(json!({"y": [1, 2], "z": "t"})));
        let text: Vec<_> =
            a.changes(&b).iter().map(|c| format!("{} {} {}", c.setting, c.was, c.is)).collect();
        assert_eq!(text, ["x 1 absent", "y [1] [1,2]", "z absent \"t\""]);
        assert!(a.changes(&a).is_empty());
        assert_ne!(a.hash(), b.hash());
        assert_eq!(a.hash(), identity(json!({"y": [1], "x": 1})).hash());
        assert_eq!(a.hash().len(), 64);
    }

    #[test]
    fn patterns_leave_out_whole_settings_only() {
        let all = identity(json!({
            "log": 1, "log_every": 2, "train": [{ "root": "a", "seed": 1 }, { "root": "b", "seed": 2 }],
        }));
        let kept = all.clone().without(["log", "train[*].root"]);
        let names: Vec<_> = kept.settings().keys().cloned().collect();
        assert_eq!(names, ["log_every", "train[0].seed", "train[1].seed"]);
        assert_eq!(all.without(["train"]).settings().len(), 2);
    }
}

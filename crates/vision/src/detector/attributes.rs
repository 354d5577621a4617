//! What a node of a graph says about its layer.

use base64::Engine;
use serde_json::Value;
use std::collections::BTreeMap;

/// The attributes of a node.
pub(super) struct Attributes<'a>(pub(super) &'a BTreeMap<String, Value>);

impl Attributes<'_> {
    fn get(&self, name: &str, kind: &str) -> Option<&Value> {
        self.0.get(name)?.get(kind)
    }

    /// A text, which the file has as base64.
    pub(super) fn text(&self, name: &str) -> Option<String> {
        let text = self.get(name, "s")?.as_str()?;
        let bytes = base64::engine::general_purpose::STANDARD.decode(text).ok()?;
        String::from_utf8(bytes).ok()
    }

    pub(super) fn float(&self, name: &str) -> Option<f32> {
        Some(self.get(name, "f")?.as_f64()? as f32)
    }

    /// Whether it is true; `false` where it is missing, as in TensorFlow.
    pub(super) fn is(&self, name: &str) -> bool {
        self.get(name, "b").and_then(Value::as_bool).unwrap_or(false)
    }

    /// A whole number, which the file has as text.
    pub(super) fn number(&self, name: &str) -> Option<usize> {
        whole(self.get(name, "i")?)
    }

    /// Whole numbers.
    pub(super) fn sizes(&self, name: &str) -> Option<Vec<usize>> {
        self.get(name, "list")?.get("i")?.as_array()?.iter().map(whole).collect()
    }
}

fn whole(value: &Value) -> Option<usize> {
    match value {
        Value::String(text) => text.parse().ok(),
        other => usize::try_from(other.as_u64()?).ok(),
    }
}

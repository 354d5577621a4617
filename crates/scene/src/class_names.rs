//! Files of class names.

use crate::SceneError;
use crate::input_file::read_text_file;
use std::path::Path;

/// Reads class names: one a line (blank lines are skipped), or JSON: a list of strings, or an
/// object with such a list as `classes`, `labels` or `names`.
///
/// # Errors
/// If the file cannot be read, is no text, or is JSON of another form.
pub fn read_names(path: &Path) -> Result<Vec<String>, SceneError> {
    let text = read_text_file(path)?;
    // A byte order mark would become part of the first name.
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let names = if text.trim_start().starts_with(['[', '{']) {
        let json: serde_json::Value = serde_json::from_str(text)
            .map_err(|error| SceneError::format(path, format!("is not valid JSON: {error}"), ""))?;
        let list = match &json {
            serde_json::Value::Object(object) => {
                ["classes", "labels", "names"].iter().find_map(|key| object.get(*key))
            }
            other => Some(other),
        };
        let names = list.and_then(|list| serde_json::from_value::<Vec<String>>(list.clone()).ok());
        names.ok_or_else(|| {
            let help = "give a list of strings, or an object with one as `classes` or `labels`";
            SceneError::format(path, "holds no list of class names", help)
        })?
    } else {
        text.lines().map(str::trim).filter(|l| !l.is_empty()).map(str::to_owned).collect()
    };
    if names.is_empty() {
        return Err(SceneError::format(path, "holds no class name", "write one name a line"));
    }
    Ok(names)
}

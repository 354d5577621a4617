//! Values of a JSON file that know where they stand, so that an error can name the field.

use crate::SceneError;
use serde_json::Value;
use std::path::Path;

/// A value in a JSON file.
pub(super) struct Field<'a> {
    file: &'a Path,
    name: String,
    value: &'a Value,
}

impl<'a> Field<'a> {
    /// The whole file.
    pub(super) fn root(file: &'a Path, value: &'a Value) -> Self {
        Self { file, name: String::new(), value }
    }

    /// The member of that name; `null` counts as absent.
    pub(super) fn opt(&self, key: &str) -> Option<Field<'a>> {
        let value = self.value.get(key).filter(|v| !v.is_null())?;
        let name = if self.name.is_empty() { key.into() } else { format!("{}.{key}", self.name) };
        Some(Field { file: self.file, name, value })
    }

    /// The member of that name.
    pub(super) fn get(&self, key: &str) -> Result<Field<'a>, SceneError> {
        self.opt(key).ok_or_else(|| {
            let at = if self.name.is_empty() { "" } else { &format!(" in {}", self.name) };
            SceneError::format(self.file, format!("has no field {key}{at}"), MEND)
        })
    }

    /// The elements of an array, `null` included.
    pub(super) fn elements(&self) -> Result<Vec<Field<'a>>, SceneError> {
        let values = self.value.as_array().ok_or_else(|| self.bad("a list"))?;
        let element = |(i, value): (usize, &'a Value)| {
            let name = format!("{}[{i}]", self.name);
            Field { file: self.file, name, value }
        };
        Ok(values.iter().enumerate().map(element).collect())
    }

    /// The elements of an array of that many.
    pub(super) fn array<const N: usize>(&self) -> Result<[Field<'a>; N], SceneError> {
        let elements = self.elements()?;
        let found = elements.len();
        elements.try_into().map_err(|_| {
            let problem = format!("{} has {found} entries, not {N}", self.name);
            SceneError::format(self.file, problem, MEND)
        })
    }

    /// A list of that many numbers.
    pub(super) fn numbers<const N: usize>(&self) -> Result<[f64; N], SceneError> {
        let mut out = [0.0; N];
        for (out, field) in out.iter_mut().zip(&self.array::<N>()?) {
            *out = field.number()?;
        }
        Ok(out)
    }

    /// A finite number.
    pub(super) fn number(&self) -> Result<f64, SceneError> {
        self.value.as_f64().filter(|v| v.is_finite()).ok_or_else(|| self.bad("a number"))
    }

    /// A whole number, 0 or more.
    pub(super) fn count(&self) -> Result<usize, SceneError> {
        let count = self.value.as_u64().and_then(|v| usize::try_from(v).ok());
        count.ok_or_else(|| self.bad("a whole number of rows"))
    }

    /// A text.
    pub(super) fn text(&self) -> Result<&'a str, SceneError> {
        self.value.as_str().ok_or_else(|| self.bad("a text"))
    }

    /// Whether it is `null`.
    pub(super) fn is_true(&self) -> bool {
        self.value.as_bool() == Some(true)
    }

    pub(super) fn is_null(&self) -> bool {
        self.value.is_null()
    }

    /// The error that this is not what it should be.
    pub(super) fn bad(&self, expected: &str) -> SceneError {
        let mut shown = self.value.to_string();
        if shown.chars().count() > SHOWN {
            shown = shown.chars().take(SHOWN).chain("…".chars()).collect();
        }
        let problem = format!("{} is {shown}, not {expected}", self.name);
        SceneError::format(self.file, problem, MEND)
    }
}

/// Characters of a bad value that a message shows.
const SHOWN: usize = 60;
/// What to do about a field that is wrong.
const MEND: &str = "export the scene again";

//! Class names, and finding a class by what a user calls it.

use crate::SceneError;
pub use crate::class_names::read_names;
use crate::text_table::TextTable;
use std::path::Path;
use strsim::levenshtein;

/// How many similar names an error suggests.
const SUGGESTIONS: usize = 3;

/// The classes of a benchmark or of a user's list.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LabelSet {
    /// Names by class index.
    pub names: Vec<String>,
    /// Classes that count neither as prediction nor in averages, such as walls. Ascending.
    pub excluded: Vec<usize>,
    /// One text vector per class.
    pub text: Option<TextTable>,
}

impl LabelSet {
    /// Classes of these names, none excluded, without text vectors.
    ///
    /// # Errors
    /// If there is no name, or one is empty or there twice.
    pub fn new(names: Vec<String>) -> Result<Self, SceneError> {
        check_names(&names)?;
        Ok(Self { names, ..Self::default() })
    }

    /// The classes of a table of text vectors.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_text(text: TextTable) -> Result<Self, SceneError> {
        let set = Self::new(text.names.clone())?;
        Ok(Self { text: Some(text), ..set })
    }

    /// Reads a list of names, see [`read_names`].
    ///
    /// # Errors
    /// If the file cannot be read or is no list of names, or as [`new`](Self::new).
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        Self::new(read_names(path)?)
    }

    /// Excludes classes by name.
    ///
    /// # Errors
    /// If a name is not found, see [`index_of`](Self::index_of).
    pub fn exclude(mut self, names: &[&str]) -> Result<Self, SceneError> {
        for name in names {
            let index = self.index_of(name)?;
            if let Err(at) = self.excluded.binary_search(&index) {
                self.excluded.insert(at, index);
            }
        }
        Ok(self)
    }

    /// Number of classes.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there is no class.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// The index of a class, see [`find_name`].
    ///
    /// # Errors
    /// If no class, or more than one, fits the query.
    pub fn index_of(&self, query: &str) -> Result<usize, SceneError> {
        find_name(&self.names, query)
    }

    /// The `k` names most like the query, best first.
    pub fn nearest_names(&self, query: &str, k: usize) -> Vec<&str> {
        nearest_names(&self.names, query, k)
    }
}

/// The index of a name: exact, else regardless of case, else regardless of case, spaces,
/// punctuation and camel case (`ShowerCurtain` = `shower_curtain` = ` shower  curtain`).
///
/// # Errors
/// If no name, or more than one, fits equally well; similar names are suggested.
pub fn find_name(names: &[String], query: &str) -> Result<usize, SceneError> {
    if let Some(index) = names.iter().position(|n| n == query) {
        return Ok(index);
    }
    let lower = |text: &str| text.trim().to_lowercase();
    for form in [&lower as &dyn Fn(&str) -> String, &bare] {
        let wanted = form(query);
        let found: Vec<usize> =
            (0..names.len()).filter(|&i| !wanted.is_empty() && form(&names[i]) == wanted).collect();
        match found.as_slice() {
            [] => {}
            [index] => return Ok(*index),
            several => {
                return Err(SceneError::AmbiguousClass {
                    query: query.to_owned(),
                    candidates: several.iter().map(|&i| names[i].clone()).collect(),
                });
            }
        }
    }
    let nearest = nearest_names(names, query, SUGGESTIONS);
    Err(SceneError::UnknownClass {
        query: query.to_owned(),
        nearest: nearest.into_iter().map(str::to_owned).collect(),
    })
}

/// The `k` names with the fewest edits from the query, best first; ties in the order of `names`.
pub fn nearest_names<'a>(names: &'a [String], query: &str, k: usize) -> Vec<&'a str> {
    let query = bare(query);
    let mut ranked: Vec<&str> = names.iter().map(String::as_str).collect();
    ranked.sort_by_cached_key(|name| levenshtein(&query, &bare(name)));
    ranked.truncate(k);
    ranked
}

/// Letters and digits only, in lower case; without separators, camel case makes no difference.
fn bare(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Refuses lists that are empty, or hold an empty name or one twice.
pub(crate) fn check_names(names: &[String]) -> Result<(), SceneError> {
    let bad = |problem: String, help: &str| SceneError::Classes { problem, help: help.to_owned() };
    if names.is_empty() {
        return Err(bad("the list of classes is empty".to_owned(), "give at least one name"));
    }
    let mut seen = std::collections::HashMap::new();
    for (i, name) in names.iter().enumerate() {
        if name.trim().is_empty() {
            return Err(bad(format!("class {i} has no name"), ""));
        }
        if let Some(first) = seen.insert(name, i) {
            let problem = format!("classes {first} and {i} are both called {name:?}");
            return Err(bad(problem, "give every class its own name"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(names: &[&str]) -> LabelSet {
        LabelSet::new(names.iter().map(|&n| n.to_owned()).collect()).unwrap()
    }

    #[test]
    fn a_class_is_found_however_it_is_spelt() {
        let set = set(&["wall", "shower curtain", "TVCabinet", "night_stand"]);
        for (query, index) in [
            ("wall", 0),
            ("  WALL ", 0),
            ("ShowerCurtain", 1),
            ("shower_curtain", 1),
            ("tv cabinet", 2),
            ("TV-Cabinet", 2),
            ("NightStand", 3),
        ] {
            assert_eq!(set.index_of(query).unwrap(), index, "{query}");
        }
    }

    #[test]
    fn exact_names_win_and_ties_are_errors() {
        let set = set(&["TV", "tv", "Night Stand", "nightstand"]);
        assert_eq!(set.index_of("tv").unwrap(), 1);
        assert_eq!(set.index_of("NIGHTSTAND").unwrap(), 3, "case comes before separators");
        let error = set.index_of("Tv").unwrap_err();
        assert!(
            matches!(&error, SceneError::AmbiguousClass { candidates, .. } if candidates.len() == 2)
        );
        assert!(matches!(set.index_of("night_stand"), Err(SceneError::AmbiguousClass { .. })));
    }

    #[test]
    fn unknown_names_get_suggestions() {
        let set = set(&["wall", "floor", "refrigerator", "bathtub"]);
        let error = set.index_of("refridgerator").unwrap_err().to_string();
        assert!(
            error.contains("\"refridgerator\"") && error.contains("nearest: refrigerator"),
            "{error}"
        );
        assert_eq!(set.nearest_names("flor", 2), ["floor", "wall"]);
        assert!(set.index_of("").is_err());
        assert!(set.index_of("--").is_err());
    }

    #[test]
    fn classes_can_be_excluded_by_name() {
        let set = set(&["wall", "floor", "bed"]).exclude(&["Floor", "wall", "floor"]).unwrap();
        assert_eq!(set.excluded, [0, 1]);
        assert!(set.exclude(&["ceiling"]).is_err());
    }

    #[test]
    fn bad_lists_are_refused() {
        for names in [&[][..], &["a", " "], &["a", "b", "a"]] {
            let names: Vec<String> = names.iter().map(|&n| n.to_owned()).collect();
            assert!(LabelSet::new(names).is_err());
        }
    }

    #[test]
    fn name_files_may_be_lines_or_json() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("names");
        let expected = ["wall", "shower curtain"];
        for text in [
            "wall\n\n  shower curtain \r\n",
            "\u{feff}wall\nshower curtain",
            r#"["wall", "shower curtain"]"#,
            r#" {"classes": ["wall", "shower curtain"], "other": 1}"#,
            r#"{"labels": ["wall", "shower curtain"]}"#,
        ] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(read_names(&path).unwrap(), expected, "{text}");
        }
        for text in ["", "\n\n", "[1, 2]", "{\"a\": []}", "[\"a\"", "[]"] {
            std::fs::write(&path, text).unwrap();
            let error = read_names(&path).unwrap_err().to_string();
            assert!(error.contains("names"), "{error}");
        }
    }
}

//! From the class names of one data set to those of another.

use crate::SceneError;
use crate::input_file::read_text_file;
use crate::label_set::find_name;
use std::collections::BTreeMap;
use std::path::Path;

/// Which class of another list each class becomes; classes without an entry become none.
///
/// ```
/// use scenesplat_scene::ClassMap;
/// let map = ClassMap::from_pairs([("Bed", "bed"), ("TVCabinet", "cabinet")]);
/// let from = ["Ball", "Bed", "TVCabinet"].map(String::from);
/// let to = ["cabinet", "bed"].map(String::from);
/// assert_eq!(map.indices(&from, &to)?, [-1, 1, 0]);
/// # Ok::<(), scenesplat_scene::SceneError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ClassMap {
    /// Name there by name here.
    pub pairs: BTreeMap<String, String>,
}

impl ClassMap {
    /// A map of these pairs.
    pub fn from_pairs<A: Into<String>, B: Into<String>>(
        pairs: impl IntoIterator<Item = (A, B)>,
    ) -> Self {
        Self { pairs: pairs.into_iter().map(|(a, b)| (a.into(), b.into())).collect() }
    }

    /// Reads a table of names: JSON if it begins with a brace, else TOML (`Bed = "bed"`).
    ///
    /// # Errors
    /// If the file cannot be read or is no table of strings.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let text = read_text_file(path)?;
        let pairs: Result<BTreeMap<String, String>, String> = if text.trim_start().starts_with('{')
        {
            serde_json::from_str(&text).map_err(|error| error.to_string())
        } else {
            toml::from_str(&text).map_err(|error| error.to_string())
        };
        let pairs = pairs.map_err(|error| {
            let problem = format!("is no map of class names: {}", error.trim());
            SceneError::format(path, problem, "write one `\"name here\" = \"name there\"` a line")
        })?;
        Ok(Self { pairs })
    }

    /// For each name of `from` the index in `to`, -1 for none.
    ///
    /// # Errors
    /// If the map mentions a name that is in neither list, or names one class twice.
    pub fn indices(&self, from: &[String], to: &[String]) -> Result<Vec<i32>, SceneError> {
        let mut out = vec![-1; from.len()];
        for (here, there) in &self.pairs {
            let row = find_name(from, here)?;
            let index = find_name(to, there)?;
            if out[row] != -1 {
                return Err(SceneError::Classes {
                    problem: format!("the map of classes gives {:?} twice", from[row]),
                    help: "keep one of the entries".to_owned(),
                });
            }
            // A list of more than 2^31 names would not fit into memory.
            out[row] = index as i32;
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(names: &[&str]) -> Vec<String> {
        names.iter().map(|&n| n.to_owned()).collect()
    }

    #[test]
    fn toml_and_json_say_the_same() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("map");
        let expected = ClassMap::from_pairs([("Bed", "bed"), ("Coffee Table", "table")]);
        for text in [
            "Bed = \"bed\"\n\"Coffee Table\" = \"table\"\n",
            "{\"Bed\": \"bed\", \"Coffee Table\": \"table\"}",
        ] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(ClassMap::read(&path).unwrap(), expected);
        }
        for text in ["Bed = 3", "{\"Bed\": 3}", "{\"Bed\"", "Bed"] {
            std::fs::write(&path, text).unwrap();
            assert!(ClassMap::read(&path).is_err(), "{text}");
        }
    }

    #[test]
    fn names_are_looked_up_on_both_sides() {
        let map = ClassMap::from_pairs([("bed", "Bed"), ("coffee_table", "TABLE")]);
        let (from, to) = (list(&["Sofa", "CoffeeTable", "Bed"]), list(&["bed", "table"]));
        assert_eq!(map.indices(&from, &to).unwrap(), [-1, 1, 0]);
    }

    #[test]
    fn unknown_and_double_names_are_errors() {
        let (from, to) = (list(&["Bed"]), list(&["bed"]));
        for pairs in [[("Bet", "bed"), ("Bet", "bed")], [("Bed", "bet"), ("Bed", "bet")]] {
            let error = ClassMap::from_pairs(pairs).indices(&from, &to).unwrap_err();
            assert!(matches!(error, SceneError::UnknownClass { .. }));
        }
        let map = ClassMap::from_pairs([("Bed", "bed"), ("bed", "bed")]);
        assert!(matches!(map.indices(&from, &to), Err(SceneError::Classes { .. })));
    }
}

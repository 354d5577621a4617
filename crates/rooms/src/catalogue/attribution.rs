//! Who made the models.

use super::split::FurnitureSplit;
use super::{Catalogue, Entry};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// What a library says of itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct License {
    /// Of the whole library.
    pub(super) name: String,
    /// Where its text is.
    pub(super) link: String,
}

impl License {
    /// From the header of the properties and the license's text: the first address in it.
    pub(super) fn of(values: &BTreeMap<String, String>, text: Option<&str>) -> Self {
        let link = text.and_then(|text| {
            let start = text.find("http")?;
            let end = text[start..].find(|c: char| c.is_whitespace() || c == ')' || c == '"');
            Some(text[start..end.map_or(text.len(), |end| start + end)].to_owned())
        });
        let link = link.unwrap_or_default();
        let said = values.get("license").map(|name| name.trim().to_owned());
        let name = said.filter(|name| !name.is_empty()).unwrap_or_else(|| {
            if link.contains("/licenses/by/3.0") {
                "Creative Commons Attribution 3.0".to_owned()
            } else {
                "see the library".to_owned()
            }
        });
        Self { name, link }
    }
}

/// The models that furniture may have been drawn from, with their makers: what goes with weights that were
/// trained with them. As text a table in Markdown, which can be read again.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Attribution {
    /// Lines of the table: library, model, name, creator, license, link.
    lines: BTreeSet<String>,
}

const HEAD: &str = "\
# Furniture models

Rooms were furnished with shapes and colours of these models; none of the models is part of these files.

| library | model | name | creator | licence | link |
|---|---|---|---|---|---|
";

impl Attribution {
    /// Of all models that a part of the catalogue has.
    pub(super) fn of(catalogue: &Catalogue, split: &FurnitureSplit) -> Self {
        let clean = |text: &String| text.replace('|', "/").replace(['\n', '\r'], " ");
        let line = |entry: &Entry| {
            let License { name, link } = catalogue.license(&entry.library);
            let Entry { library, id, name: called, creator, .. } = entry;
            let cells = [library, id, called, creator, &name, &link].map(clean);
            format!("| {} |", cells.join(" | "))
        };
        Self { lines: catalogue.drawn(split).map(line).collect() }
    }

    /// The lines of a text that has been written from one.
    pub fn parse(text: &str) -> Self {
        let lines = text.lines().filter(|line| line.starts_with("| "));
        let lines = lines.filter(|line| !line.starts_with("| library |"));
        Self { lines: lines.map(|line| line.trim_end().to_owned()).collect() }
    }

    /// Adds the models of another list.
    pub fn add(&mut self, other: Self) {
        self.lines.extend(other.lines);
    }

    /// Number of models.
    pub fn len(&self) -> usize {
        self.lines.len()
    }

    /// Whether no model was used.
    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }
}

impl fmt::Display for Attribution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(HEAD)?;
        self.lines.iter().try_for_each(|line| writeln!(f, "{line}"))
    }
}

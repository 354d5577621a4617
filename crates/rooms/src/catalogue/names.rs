//! What names of furniture mean.

use crate::classes::{CLASSES, ClassId};
use crate::vocabulary::Vocabulary;
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// What a name of a model means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Meaning {
    /// An object of this class.
    Class(ClassId),
    /// Some other object: it has a name, but no class.
    Other,
    /// Nothing that stands in a furnished room by itself: never drawn.
    Outdoors,
}

/// Read by hand, one name at a time: 483 names of the indoor models of Debian's `sweethome3d-furniture`.
const TABLE: &str = include_str!("names.tsv");

static BY_NAME: LazyLock<BTreeMap<&str, Meaning>> = LazyLock::new(|| {
    let lines = TABLE.lines().filter(|line| !line.starts_with('#'));
    lines.filter_map(|line| line.split_once('\t')).map(|(name, what)| (name, read(what))).collect()
});

fn read(what: &str) -> Meaning {
    match what {
        "outdoors" => Meaning::Outdoors,
        what => {
            let class = CLASSES.iter().position(|class| class.name == what);
            class.map_or(Meaning::Other, |row| Meaning::Class(ClassId::ALL[row]))
        }
    }
}

impl Meaning {
    /// By the table; a name that it does not have by the words of the classes, else no class.
    pub fn of(name: &str) -> Self {
        if let Some(&known) = BY_NAME.get(name) {
            return known;
        }
        let lower = name.to_lowercase();
        let found = Vocabulary::class_phrases().find(|(phrase, _)| *phrase == lower);
        found.map_or(Self::Other, |(_, class)| Self::Class(class))
    }

    /// The class, if it has one.
    pub fn class(self) -> Option<ClassId> {
        match self {
            Self::Class(class) => Some(class),
            Self::Other | Self::Outdoors => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_a_name_and_what_it_means() {
        let mut names = Vec::new();
        for line in TABLE.lines().filter(|line| !line.starts_with('#')) {
            let (name, what) = line.split_once('\t').unwrap();
            let known =
                ["none", "outdoors"].contains(&what) || CLASSES.iter().any(|c| c.name == what);
            assert!(known && !name.is_empty(), "{line}");
            names.push(name);
        }
        let mut sorted = names.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert_eq!((sorted.len(), names.len()), (483, 483));
        assert_eq!(Meaning::of("Corner sofa"), Meaning::Class(ClassId::Sofa));
        assert_eq!(Meaning::of("Keyboard"), Meaning::Other, "that of a piano");
        assert_eq!(Meaning::of("Street light"), Meaning::Outdoors);
        // Names of other catalogues.
        assert_eq!(Meaning::of("Couches"), Meaning::Other);
        assert_eq!(Meaning::of("Trash bin").class(), Some(ClassId::TrashCan));
        assert_eq!(Meaning::of("zither"), Meaning::Other);
    }
}

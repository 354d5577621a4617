//! Which models a room may draw: those for training, those held out, those of a library.

use super::Entry;
use crate::dice::finished;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// Part of a catalogue. As text `all`, `train`, `held_out`, `without:LIBRARY` or `only:LIBRARY`.
///
/// One model in five is held out, by a hash of its id: of names that three models or more have, a fifth of
/// the models and one at least; of rarer names each model by itself, so that whole names are held out too.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum FurnitureSplit {
    /// Every model.
    #[default]
    All,
    /// All but those held out.
    Train,
    /// Those that `train` lacks.
    HeldOut,
    /// All but those of a library.
    Without(String),
    /// Those of a library.
    Only(String),
}

impl fmt::Display for FurnitureSplit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Train => f.write_str("train"),
            Self::HeldOut => f.write_str("held_out"),
            Self::Without(library) => write!(f, "without:{library}"),
            Self::Only(library) => write!(f, "only:{library}"),
        }
    }
}

impl FromStr for FurnitureSplit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.split_once(':')) {
            ("all", _) => Ok(Self::All),
            ("train", _) => Ok(Self::Train),
            ("held_out", _) => Ok(Self::HeldOut),
            (_, Some(("without", library))) if !library.is_empty() => {
                Ok(Self::Without(library.to_owned()))
            }
            (_, Some(("only", library))) if !library.is_empty() => {
                Ok(Self::Only(library.to_owned()))
            }
            _ => Err(format!(
                "{text:?} is no part of a catalogue: write all, train, held_out, without:LIBRARY or \
                 only:LIBRARY"
            )),
        }
    }
}

impl TryFrom<String> for FurnitureSplit {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<FurnitureSplit> for String {
    fn from(split: FurnitureSplit) -> Self {
        split.to_string()
    }
}

impl FurnitureSplit {
    /// The library that it names.
    pub(super) fn library(&self) -> Option<&str> {
        match self {
            Self::Without(library) | Self::Only(library) => Some(library),
            _ => None,
        }
    }

    /// Whether a model is in this part.
    pub(super) fn has(&self, entry: &Entry, is_held_out: bool) -> bool {
        match self {
            Self::All => true,
            Self::Train => !is_held_out,
            Self::HeldOut => is_held_out,
            Self::Without(library) => entry.library != *library,
            Self::Only(library) => entry.library == *library,
        }
    }
}

/// Names that fewer models than this have are not divided: each model goes by its own hash.
const COMMON: usize = 3;

/// Of each entry, whether it is held out.
pub(super) fn held_out(entries: &[Entry]) -> Vec<bool> {
    let mut by_name: BTreeMap<&str, Vec<(u64, usize)>> = BTreeMap::new();
    for (index, entry) in entries.iter().enumerate() {
        by_name.entry(&entry.name).or_default().push((hash(&entry.id), index));
    }
    let mut held = vec![false; entries.len()];
    for models in by_name.values_mut() {
        if models.len() < COMMON {
            models.iter().for_each(|&(hash, index)| held[index] = hash % 5 == 0);
            continue;
        }
        models.sort_unstable();
        let count = ((models.len() as f64 / 5.0).round() as usize).max(1);
        models.iter().take(count).for_each(|&(_, index)| held[index] = true);
    }
    held
}

/// FNV-1a, then the finisher of splitmix64: the last letters of ids, often digits, must not decide.
pub(super) fn hash(id: &str) -> u64 {
    finished(id.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_splits() {
        for text in ["all", "train", "held_out", "without:Scopia", "only:Kator Legaz"] {
            assert_eq!(text.parse::<FurnitureSplit>().unwrap().to_string(), text);
        }
        for text in ["", "test", "only:", "without", "train:Scopia", "heldout"] {
            let error = text.parse::<FurnitureSplit>().unwrap_err();
            assert!(error.contains("held_out"), "{error}");
        }
    }
}

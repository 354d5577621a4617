//! Which labels a part of a phrase names.

use super::foreign::class_of;
use crate::phrases::bases;
use scenesplat_rooms::{ClassId, Vocabulary};
use scenesplat_scene::label_set::find_name;

/// What separates the names of a list.
const SEPARATORS: &[&str] = &["and", "or", "und", "oder", "et", "ou"];

/// Why words name no label.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum NoLabel {
    /// They name a color.
    Color,
    /// None of the labels is their name, or they name several without "and".
    Unknown(String),
}

/// The labels that a list of names means, sorted: "walls and floor". A group means its members.
pub(super) fn labels_of(words: &[String], labels: &[String]) -> Result<Vec<usize>, NoLabel> {
    if let Some(label) = label_of(words, labels) {
        return Ok(vec![label]);
    }
    let is_separator = |word: &String| SEPARATORS.contains(&word.as_str());
    let mut found = Vec::new();
    for name in words.split(is_separator).filter(|name| !name.is_empty()) {
        found.extend(one_name(name, labels)?);
    }
    if found.is_empty() {
        return Err(NoLabel::Unknown(words.join(" ")));
    }
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// The labels of one name: itself, or those of the classes that it means to the vocabulary.
fn one_name(words: &[String], labels: &[String]) -> Result<Vec<usize>, NoLabel> {
    if let Some(label) = label_of(words, labels) {
        return Ok(vec![label]);
    }
    let unknown = || NoLabel::Unknown(words.join(" "));
    let classes = match Vocabulary::named(&words.join(" ")) {
        Ok(named) if !named.colors.is_empty() => return Err(NoLabel::Color),
        Ok(named) => match <[Vec<ClassId>; 1]>::try_from(named.nouns) {
            Ok([classes]) => classes,
            Err(_) => return Err(unknown()),
        },
        Err(_) => vec![class_of(words).ok_or_else(unknown)?],
    };
    let label = |class: ClassId| find_name(labels, class.about().name).ok();
    let found: Vec<usize> = classes.into_iter().filter_map(label).collect();
    if found.is_empty() { Err(unknown()) } else { Ok(found) }
}

/// The label of a name, in the singular or plural.
pub(super) fn label_of(words: &[String], labels: &[String]) -> Option<usize> {
    let (last, head) = words.split_last()?;
    let head = head.concat();
    std::iter::once(last.clone())
        .chain(bases(last))
        .find_map(|last| find(&format!("{head}{last}"), labels))
}

/// The label with these letters, unless several have them. [`find_name`] would look for the nearest name of each part of
/// a phrase that is none.
fn find(letters: &str, labels: &[String]) -> Option<usize> {
    let has = |label: &String| {
        let bare = label.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase);
        bare.eq(letters.chars())
    };
    let mut found = (0..labels.len()).filter(|&at| has(&labels[at]));
    found.next().filter(|_| found.next().is_none())
}

/// Whether words name one label, or one class or group of the vocabulary.
pub(super) fn is_name(words: &[String], labels: &[String]) -> bool {
    let is_noun = |text: &str| Vocabulary::named(text).is_ok_and(|named| named.nouns.len() == 1);
    label_of(words, labels).is_some() || is_noun(&words.join(" ")) || class_of(words).is_some()
}

//! The words that are known, and how texts are read.

use crate::classes::{ClassId, Group};
use crate::material::ColorName;
use std::cmp::Reverse;

/// What a word stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Concept {
    Class(ClassId),
    Group(Group),
    Color(ColorName),
}

/// Words that say nothing about what is meant.
const IGNORED: &[&str] = &[
    "a", "an", "the", "this", "that", "is", "are", "some", "any", "all", "of", "with", "in", "and",
    "or",
];

/// What is meant, and the phrases for it.
type Words<T> = &'static [(T, &'static [&'static str])];

/// Every phrase of a list, with what it means.
fn each<T: Copy>(words: Words<T>) -> impl Iterator<Item = (&'static str, T)> {
    words.iter().flat_map(|&(meant, phrases)| phrases.iter().map(move |&phrase| (phrase, meant)))
}

/// Other names of classes; those of ScanNet's benchmarks where they mean the same.
const SYNONYMS: Words<ClassId> = &[
    (ClassId::Chair, &["armchair", "office chair", "dining chair"]),
    (ClassId::Stool, &["footstool", "ottoman"]),
    (ClassId::Sofa, &["couch", "settee"]),
    (ClassId::Table, &["dining table", "kitchen table"]),
    (ClassId::Desk, &["office desk", "reading desk", "writing desk"]),
    (
        ClassId::Cabinet,
        &[
            "dresser",
            "sideboard",
            "chest of drawers",
            "cupboard",
            "file cabinet",
            "bathroom cabinet",
        ],
    ),
    (ClassId::KitchenCabinet, &["counter", "kitchen counter"]),
    (ClassId::Wardrobe, &["closet", "armoire"]),
    (ClassId::Bookshelf, &["bookcase", "shelf", "rack"]),
    (ClassId::Nightstand, &["night stand", "bedside table"]),
    (ClassId::TvStand, &["tv cabinet", "television stand"]),
    (ClassId::Tv, &["television"]),
    (ClassId::Monitor, &["computer monitor", "computer screen", "display"]),
    (ClassId::Laptop, &["notebook computer"]),
    (
        ClassId::Lamp,
        &["light", "ceiling light", "ceiling lamp", "chandelier", "floor lamp", "table lamp"],
    ),
    (ClassId::Plant, &["potted plant", "house plant"]),
    (ClassId::Picture, &["painting", "portrait", "poster", "photo"]),
    (ClassId::Curtain, &["drapes", "drape"]),
    (ClassId::Rug, &["carpet", "mat"]),
    (ClassId::Pillow, &["cushion"]),
    (ClassId::Box, &["carton", "cardboard box", "crate"]),
    (
        ClassId::TrashCan,
        &[
            "bin",
            "trash bin",
            "trash",
            "garbage bin",
            "garbage can",
            "recycling bin",
            "wastebasket",
        ],
    ),
    (ClassId::Mug, &["cup", "coffee mug"]),
    (ClassId::Clock, &["alarm clock"]),
    (ClassId::Radiator, &["heater"]),
    (ClassId::Sink, &["basin", "washbasin"]),
    (ClassId::Bathtub, &["tub", "bath"]),
    (ClassId::Refrigerator, &["fridge", "mini fridge"]),
    (ClassId::Stove, &["oven", "cooker"]),
    (ClassId::RangeHood, &["extractor hood", "cooker hood"]),
];

const GROUP_WORDS: Words<Group> = &[
    (Group::Structure, &["structure", "building"]),
    (Group::Furniture, &["furniture"]),
    (Group::Seat, &["seat", "seating"]),
    (Group::Surface, &["work surface", "surface"]),
    (Group::Storage, &["storage"]),
    (Group::Electronics, &["electronics", "electronic device", "device"]),
    (Group::Appliance, &["appliance", "machine"]),
    (Group::Bathroom, &["bathroom", "sanitary ware"]),
    (Group::Kitchen, &["kitchen"]),
    (Group::Decoration, &["decoration", "decor"]),
    (Group::Textile, &["textile", "cloth"]),
    (Group::Object, &["small object", "object", "thing"]),
];

/// The word for a group.
#[cfg(test)]
pub(super) fn group_word(group: Group) -> &'static str {
    each(GROUP_WORDS).find(|w| w.1 == group).map_or("", |w| w.0)
}

/// Names of the classes, then their synonyms.
pub(super) fn class_phrases() -> impl Iterator<Item = (&'static str, ClassId)> {
    let names = ClassId::ALL.iter().map(|&c| (c.about().name, c));
    names.chain(each(SYNONYMS))
}

/// The color words of a text, each once, and its other words.
pub(super) fn split_colors(text: &str) -> (Vec<ColorName>, String) {
    let lower = text.to_lowercase();
    let (mut colors, mut rest) = (Vec::new(), Vec::new());
    // An apostrophe is inside a word: "child's".
    let inside = |c: char| c.is_alphanumeric() || matches!(c, '\'' | '’');
    for word in lower.split(|c: char| !inside(c)).filter(|w| !w.is_empty()) {
        let named = |c: &ColorName| c.word() == word;
        let gray = (word == "gray").then_some(ColorName::Grey);
        match ColorName::ALL.into_iter().find(named).or(gray) {
            Some(color) if colors.contains(&color) => {}
            Some(color) => colors.push(color),
            None => rest.push(word),
        }
    }
    (colors, rest.join(" "))
}

/// Every known phrase with its concept.
fn phrases() -> impl Iterator<Item = (&'static str, Concept)> {
    let classes = class_phrases().map(|(word, c)| (word, Concept::Class(c)));
    let groups = each(GROUP_WORDS).map(|(word, g)| (word, Concept::Group(g)));
    let colors = ColorName::ALL.iter().map(|&c| (c.word(), Concept::Color(c)));
    let gray = std::iter::once(("gray", Concept::Color(ColorName::Grey)));
    classes.chain(groups).chain(colors).chain(gray)
}

/// The concepts of a text, each once, in its order.
///
/// # Errors
/// The first word that is not known.
pub(super) fn parse(text: &str) -> Result<Vec<Concept>, String> {
    let lower = text.to_lowercase();
    let words: Vec<&str> = lower
        .split(|c: char| !c.is_alphanumeric())
        .filter(|w| !w.is_empty() && !IGNORED.contains(w))
        .collect();
    let mut found = Vec::new();
    let mut at = 0;
    while at < words.len() {
        // The longest phrase wins: "kitchen cabinet" is no cabinet in a kitchen.
        let longest = phrases()
            .filter_map(|(phrase, concept)| Some((phrase_length(phrase, &words[at..])?, concept)))
            // The first of equals.
            .min_by_key(|&(length, _)| Reverse(length));
        let Some((length, concept)) = longest else { return Err(words[at].to_owned()) };
        if !found.contains(&concept) {
            found.push(concept);
        }
        at += length;
    }
    Ok(found)
}

/// Number of words that a phrase takes at the start of `words`; `None` if it is not there.
fn phrase_length(phrase: &str, words: &[&str]) -> Option<usize> {
    let mut length = 0;
    for part in phrase.split(' ').filter(|p| !IGNORED.contains(p)) {
        if !is_form_of(words.get(length)?, part) {
            return None;
        }
        length += 1;
    }
    Some(length)
}

/// Whether a word is another in the singular or plural.
fn is_form_of(word: &str, base: &str) -> bool {
    let strip = |end| word.strip_suffix(end);
    word == base
        || strip("s") == Some(base)
        || strip("es") == Some(base)
        || strip("ies").is_some_and(|stem| base.strip_suffix('y') == Some(stem))
        || strip("ves").is_some_and(|stem| base.strip_suffix('f') == Some(stem))
}

/// The three known phrases that are spelt most like a word.
pub(super) fn nearest(word: &str) -> Vec<&'static str> {
    // Longer ones are like no known word; their distances would only take time.
    let word: Vec<char> = word.chars().take(40).collect();
    let mut all: Vec<_> = phrases().map(|(phrase, _)| (distance(&word, phrase), phrase)).collect();
    all.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.cmp(b.1)));
    all.dedup();
    all.into_iter().take(3).map(|(_, phrase)| phrase).collect()
}

/// Letters to change, add, drop or swap with their neighbor.
fn distance(a: &[char], b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut rows = vec![(0..=b.len()).collect::<Vec<usize>>()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let change = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = change.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(rows[i - 2][j - 2] + 1);
            }
            row.push(best);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CLASSES;

    #[test]
    fn phrases_are_unique_and_lower_case() {
        let mut all: Vec<_> = phrases().map(|p| p.0).collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), count);
        assert!(all.iter().all(|p| p.to_lowercase() == *p));
        assert!(CLASSES.iter().all(|c| all.contains(&c.name)));
    }

    #[test]
    fn distances_count_letters() {
        let chars = |w: &str| w.chars().collect::<Vec<_>>();
        assert_eq!(distance(&chars("chiar"), "chair"), 1);
        assert_eq!(distance(&chars(""), "bed"), 3);
        assert_eq!(distance(&chars("sofa"), "sofa"), 0);
    }

    #[test]
    fn the_longest_phrase_wins() {
        assert_eq!(parse("kitchen cabinets"), Ok(vec![Concept::Class(ClassId::KitchenCabinet)]));
        assert_eq!(
            parse("kitchen lamp"),
            Ok(vec![Concept::Group(Group::Kitchen), Concept::Class(ClassId::Lamp)])
        );
        assert_eq!(parse("chest of drawers"), Ok(vec![Concept::Class(ClassId::Cabinet)]));
    }
}

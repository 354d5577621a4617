//! Words that deny, and what they deny.

use super::tokens::starts_with;
use crate::phrases::distance;

/// Words that deny what follows; the longest at a place counts.
pub(super) const DENIALS: &[&str] = &[
    "not",
    "no",
    "non",
    "without",
    "except",
    "excepting",
    "excepted",
    "exclude",
    "excluding",
    "but",
    "but not",
    "and not",
    "but no",
    "and no",
    "with no",
    "with exception of",
    "other than",
    "rather than",
    "different than",
    "different from",
    "unlike",
    "apart from",
    "aside from",
    "instead of",
    "save for",
    "besides",
    "minus",
    "never",
    "none",
    "nothing",
    "nobody",
    "neither",
    "nor",
    "cannot",
    // German and French, whose class names are known.
    "nicht",
    "nichts",
    "kein",
    "keine",
    "keinen",
    "keinem",
    "keiner",
    "weder",
    "ohne",
    "außer",
    "ausser",
    "pas",
    "sans",
    "sauf",
    "hormis",
    "excepté",
    "aucun",
    "aucune",
    "ni",
    "jamais",
];

/// Denials that no English word is one letter from: so misspelled they still deny.
const MISSPELLED: &[&str] = &["without", "except", "excluding"];

/// Names for everything, and words around them: "show me everything in the room".
const EVERYTHING: &[&str] = &[
    "everything",
    "every",
    "anything",
    "something",
    "all",
    "thing",
    "things",
    "object",
    "objects",
    "item",
    "items",
    "stuff",
    "what",
    "whatever",
    "rest",
    "room",
    "scene",
    "show",
    "me",
    "find",
    "select",
    "give",
    "keep",
    "i",
    "want",
    "see",
    "look",
    "for",
    "in",
    "of",
    "with",
    "and",
    "or",
    "but",
    "just",
    "only",
    "alles",
    "alle",
    "tout",
    "tous",
    "toutes",
];

/// "Not all of them" is no denial of a class.
const SOME: &[&str] =
    &["all", "every", "each", "both", "only", "just", "always", "quite", "exactly", "alle", "tous"];

/// A denial in a phrase.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Denial<'a> {
    /// The words before it.
    pub before: &'a [String],
    /// The words that deny.
    pub word: &'a [String],
    /// The words after it.
    pub after: &'a [String],
}

/// The denials in a phrase, from left to right.
pub(super) fn denials(words: &[String]) -> Vec<Denial<'_>> {
    let (mut found, mut at) = (Vec::new(), 0);
    while at < words.len() {
        match length(&words[at..]) {
            Some(length) => {
                let (before, rest) = words.split_at(at);
                let (word, after) = rest.split_at(length);
                found.push(Denial { before, word, after });
                at += length;
            }
            None => at += 1,
        }
    }
    found
}

/// How many words at the start deny.
fn length(words: &[String]) -> Option<usize> {
    let listed = DENIALS.iter().filter_map(|text| starts_with(words, text)).max();
    listed.or_else(|| {
        let letters: Vec<char> = words.first()?.chars().take(20).collect();
        let near = |word: &&str| distance(&letters, &word.chars().collect::<Vec<_>>()) == 1;
        MISSPELLED.iter().any(near).then_some(1)
    })
}

impl Denial<'_> {
    /// What it is taken from, in words; `None` for everything.
    pub fn all(&self) -> Option<String> {
        let words = self.before;
        if words.iter().all(|word| EVERYTHING.contains(&word.as_str())) {
            return None;
        }
        let is_list = |word: &&String| matches!(word.as_str(), "and" | "or" | "with");
        let end = words.len() - words.iter().rev().take_while(is_list).count();
        let is_all = |word: &&String| matches!(word.as_str(), "all" | "every" | "each" | "and");
        let start = words.iter().take_while(is_all).count();
        Some(words[start.min(end)..end].join(" "))
    }

    /// What it denies, without "the … one"; may be empty.
    pub fn but(&self) -> &[String] {
        let lead = |word: &&String| {
            matches!(word.as_str(), "for" | "from" | "of" | "than" | "as" | "de")
                || (!self.is_not() && SOME.contains(&word.as_str()))
        };
        let start = self.after.iter().take_while(lead).count();
        let is_one = |word: &&String| matches!(word.as_str(), "one" | "ones");
        let end = self.after.len() - self.after.iter().rev().take_while(is_one).count();
        &self.after[start.min(end)..end]
    }

    /// Whether it denies that something is all of them, or only that: "not all chairs".
    pub fn is_partial(&self) -> bool {
        self.is_not() && self.after.first().is_some_and(|word| SOME.contains(&word.as_str()))
    }

    /// Whether it denies the next word alone: "non-red chair".
    pub fn is_prefix(&self) -> bool {
        self.word == ["non"]
    }

    fn is_not(&self) -> bool {
        self.word
            .last()
            .is_some_and(|word| matches!(word.as_str(), "not" | "nicht" | "pas" | "never"))
    }
}

/// Whether words before a place name everything: "everything on the desk".
pub(super) fn is_everything(words: &[String]) -> bool {
    words.iter().all(|word| EVERYTHING.contains(&word.as_str()))
}

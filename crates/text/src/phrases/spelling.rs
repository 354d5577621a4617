//! The words of a table, and which of them a misspelt one is.

use super::words::{bases, is_filling};
use std::collections::BTreeMap;

/// Shorter words and parts of words are not corrected: too many are one letter apart.
const SHORTEST: usize = 4;
/// Words from this length on may have two wrong letters.
const LONG: usize = 8;
/// Longer ones are no words.
const LONGEST: usize = 32;

/// The words of a list of phrases, with the number of phrases that have them.
#[derive(Debug)]
pub(super) struct KnownWords(BTreeMap<String, u32>);

impl KnownWords {
    pub fn of(phrases: &[String]) -> Self {
        let mut words = BTreeMap::new();
        for word in phrases.iter().flat_map(|p| p.split(' ')) {
            match words.get_mut(word) {
                Some(count) => *count += 1,
                None => _ = words.insert(word.to_owned(), 1),
            }
        }
        Self(words)
    }

    /// Whether a word, or one that it is a form of, is in a phrase.
    pub fn has(&self, word: &str) -> bool {
        self.0.contains_key(word)
            || is_filling(word)
            || bases(word).any(|b| self.0.contains_key(&b))
    }

    /// What a word that is not known was meant to be: with one letter changed, added, dropped or swapped with its
    /// neighbor (it, or what it may be a form of); else two known words in one ("houseplant"); else, from eight letters
    /// on, with two wrong letters.
    pub fn correction(&self, word: &str) -> Option<String> {
        let nearest = |errors: usize| {
            let mut forms = std::iter::once(word.to_owned()).chain(bases(word));
            forms.find_map(|form| self.nearest(&form, errors)).map(str::to_owned)
        };
        nearest(1).or_else(|| self.halves(word)).or_else(|| nearest(2))
    }

    /// Of several words the one with the fewest errors counts, then one of the same letters, then one that begins alike,
    /// then the one in most phrases, then by the alphabet.
    fn nearest(&self, word: &str, errors: usize) -> Option<&str> {
        let letters: Vec<char> = word.chars().collect();
        let length = letters.len();
        if !(SHORTEST..=LONGEST).contains(&length) || !letters.iter().all(|c| c.is_alphabetic()) {
            return None;
        }
        let bound = errors.min(if length < LONG { 1 } else { 2 });
        let sorted = |letters: &[char]| {
            let mut letters = letters.to_vec();
            letters.sort_unstable();
            letters
        };
        let near = self.0.iter().filter_map(|(known, count)| {
            let count_letters = known.chars().count();
            if count_letters < SHORTEST - 1 || count_letters.abs_diff(length) > bound {
                return None;
            }
            let other: Vec<char> = known.chars().collect();
            let distance = distance(&letters, &other);
            if distance > bound {
                return None;
            }
            let others = sorted(&letters) != sorted(&other);
            let start = letters.first() != other.first();
            Some((distance, others, start, u32::MAX - count, known.as_str()))
        });
        near.min().map(|(.., known)| known)
    }

    /// A word as two that are known; of several, the halves that differ least in length.
    fn halves(&self, word: &str) -> Option<String> {
        let halves = word.char_indices().map(|(at, _)| word.split_at(at));
        let known = |half: &str| half.len() >= SHORTEST && self.0.contains_key(half);
        let found = halves.filter(|(a, b)| word.len() <= LONGEST && known(a) && known(b));
        let best = found.min_by_key(|(a, b)| a.len().abs_diff(b.len()));
        best.map(|(a, b)| format!("{a} {b}"))
    }
}

/// Letters to change, add, drop or swap with their neighbor.
pub(crate) fn distance(a: &[char], b: &[char]) -> usize {
    let mut before = vec![0; b.len() + 1];
    let mut last: Vec<usize> = (0..=b.len()).collect();
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let change = last[j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut best = change.min(last[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                best = best.min(before[j - 2] + 1);
            }
            row.push(best);
        }
        before = std::mem::replace(&mut last, row);
    }
    last[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_bounded_and_settled() {
        let list = ["armchair", "chain", "chair", "office chair", "refrigerator", "sofa", "tea"];
        let words = KnownWords::of(&list.map(str::to_owned));
        let right = |word: &str| words.correction(word).unwrap_or_default();
        assert_eq!(right("chiar"), "chair");
        assert_eq!(right("chai"), "chair", "in more phrases than chain");
        assert_eq!(right("refridgeratr"), "refrigerator", "two of twelve");
        assert_eq!(right("sofsas"), "sofa", "a form of a misspelt word");
        assert_eq!(right("officesofa"), "office sofa");
        assert_eq!(right("sofachair"), "sofa chair");
        let long = "sofa".repeat(100_000);
        for word in ["sfoo", "soba1", "te", "xyzzy", "", "\u{e9}\u{e9}sofa", "chaaair", &long] {
            assert_eq!(words.correction(word), None, "{}", &word[..word.len().min(20)]);
        }
        assert!(words.has("sofas") && words.has("something") && !words.has("chiar"));
    }
}

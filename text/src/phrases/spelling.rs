//! The words of a table, and which of them a misspelt one is.

use super::words::{bases, is_filling};
use std::collections::BTreeMap;

/// Shorter words are not corrected: too many are one letter apart.
const SHORTEST: usize = 4;
/// Shorter parts of a word are none: every word begins with some.
const SHORTEST_HALF: usize = 3;
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

    /// A word that is not known as two that are: "houseplant". Of several, the halves that differ least in length.
    pub fn halves(&self, word: &str) -> Option<String> {
        let halves = word.char_indices().map(|(at, _)| word.split_at(at));
        let known = |half: &str| half.len() >= SHORTEST_HALF && self.0.contains_key(half);
        let found = halves.filter(|(a, b)| word.len() <= LONGEST && known(a) && known(b));
        let best = found.min_by_key(|(a, b)| a.len().abs_diff(b.len()));
        best.map(|(a, b)| format!("{a} {b}"))
    }

    /// What a word that is not known was meant to be: one letter changed, added, dropped or swapped with its
    /// neighbour, from eight letters on two. Of several the one with the fewest errors counts, then one that begins
    /// alike, then the one in most phrases, then by the alphabet.
    pub fn correction(&self, word: &str) -> Option<&str> {
        let letters: Vec<char> = word.chars().collect();
        if !(SHORTEST..=LONGEST).contains(&letters.len())
            || !letters.iter().all(|c| c.is_alphabetic())
        {
            return None;
        }
        let bound = if letters.len() < LONG { 1 } else { 2 };
        let near = self.0.iter().filter_map(|(known, count)| {
            let other: Vec<char> = known.chars().collect();
            if other.len() < SHORTEST - 1 || other.len().abs_diff(letters.len()) > bound {
                return None;
            }
            let distance = distance(&letters, &other);
            let other_start = letters.first() != other.first();
            (distance <= bound).then_some((distance, other_start, u32::MAX - count, known.as_str()))
        });
        near.min().map(|(.., known)| known)
    }
}

/// Letters to change, add, drop or swap with their neighbour.
fn distance(a: &[char], b: &[char]) -> usize {
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
        assert_eq!(words.correction("chiar"), Some("chair"));
        assert_eq!(words.correction("chai"), Some("chair"), "in more phrases than chain");
        assert_eq!(words.correction("refridgeratr"), Some("refrigerator"), "two of twelve");
        assert_eq!(words.correction("refrdgeratr"), Some("refrigerator"));
        for word in ["sfoo", "soba1", "te", "xyzzy", "", "chaaair", &"x".repeat(100_000)] {
            assert_eq!(words.correction(word), None, "{}", &word[..word.len().min(20)]);
        }
        assert_eq!(words.halves("officesofa").as_deref(), Some("office sofa"));
        assert_eq!(words.halves("sofachair").as_deref(), Some("sofa chair"));
        for word in ["sofaz", "chair", "", "\u{e9}sofa", &"sofa".repeat(100_000)] {
            assert_eq!(words.halves(word), None, "{}", &word[..word.len().min(20)]);
        }
        assert!(words.has("sofas") && words.has("something") && !words.has("chiar"));
    }
}

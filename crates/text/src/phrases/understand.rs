//! What a table makes of a phrase.

use super::words::{is_filling, is_preposition, normalized_words};
use super::{KEPT, PhraseTable};
use crate::PhraseError;
use crate::error::shortened;
use scenesplat_kernels::normalize::normalize_rows;
use std::fmt;

/// The most words of a part that is looked for as one.
const LONGEST_PART: usize = 5;
/// Weight of parts behind a preposition, which say more about what stands before.
const BEHIND_PREPOSITION: f32 = 0.5;
/// The most entries of a list in a message.
const MOST_TOLD: usize = 8;
/// The most words of a phrase that are read.
const MOST_WORDS: usize = 256;

/// A phrase as a table understood it. As text: all that was changed, made up or not known; empty where nothing was.
#[derive(Debug, Clone, PartialEq)]
pub struct Understood {
    /// Unit vector in the space of the table.
    pub row: Vec<f32>,
    /// The phrases of the table that it was taken for: one, or the parts that were put together.
    pub parts: Vec<String>,
    /// Misspelt words, and what they were taken for.
    pub corrected: Vec<(String, String)>,
    /// Words that are not known and were left out.
    pub unknown: Vec<String>,
    /// Whether the table has it as a whole.
    pub whole: bool,
    /// Words that were not read because the phrase is too long.
    pub unread: usize,
}

/// The first of a list in words, and how many more there are; `None` of an empty one.
pub(crate) fn told<T>(list: &[T], between: &str, word: impl Fn(&T) -> String) -> Option<String> {
    let first: Vec<String> = list.iter().take(MOST_TOLD).map(word).collect();
    let text = first.join(between);
    match list.len().checked_sub(MOST_TOLD) {
        _ if list.is_empty() => None,
        Some(more @ 1..) => Some(format!("{text} and {more} more")),
        _ => Some(text),
    }
}

/// What a misspelt or another name was read as.
pub(crate) fn took(typed: &str, word: &str) -> String {
    format!("took {typed:?} as {word:?}")
}

impl fmt::Display for Understood {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut texts = Vec::new();
        texts.extend(told(&self.corrected, "; ", |(typed, word)| took(typed, word)));
        if !self.whole {
            let parts = told(&self.parts, " + ", |part| format!("{part:?}")).unwrap_or_default();
            texts.push(format!("not in the phrase table, made up of {parts}"));
        }
        if let Some(words) = told(&self.unknown, ", ", |word| format!("{:?}", shortened(word))) {
            texts.push(format!("not known and left out: {words}"));
        }
        if self.unread > 0 {
            texts.push(format!("only the first {MOST_WORDS} words were read"));
        }
        f.write_str(&texts.join("; "))
    }
}

impl PhraseTable {
    /// A text with its misspelt words corrected, and which they were.
    pub fn corrected(&self, text: &str) -> (String, Vec<(String, String)>) {
        let mut words = normalized_words(text);
        words.truncate(MOST_WORDS);
        let (words, corrected) = self.correct(&words);
        (words.join(" "), corrected)
    }

    /// Whether every word of a text, or one that it is a form of, is in a phrase.
    pub(crate) fn has_words(&self, text: &str) -> bool {
        normalized_words(text).iter().all(|word| self.words.has(word))
    }

    fn correct(&self, words: &[String]) -> (Vec<String>, Vec<(String, String)>) {
        let (mut right, mut corrected) = (Vec::with_capacity(words.len()), Vec::new());
        for word in words {
            let other = (!self.words.has(word)).then(|| self.words.correction(word)).flatten();
            match other {
                Some(other) => {
                    right.extend(other.split(' ').map(str::to_owned));
                    corrected.push((word.clone(), other));
                }
                None => right.push(word.clone()),
            }
        }
        (right, corrected)
    }

    /// The vector of any phrase: its own if the table has it (articles, case and plurals do not matter), else, with
    /// misspelt words corrected, the mean of its longest known parts.
    ///
    /// # Errors
    /// If it has no word, or none that is known.
    pub fn understand(&self, text: &str) -> Result<Understood, PhraseError> {
        let mut words = normalized_words(text);
        if words.is_empty() {
            return Err(PhraseError::no_word(text));
        }
        let unread = words.len().saturating_sub(MOST_WORDS);
        words.truncate(MOST_WORDS);
        let mut corrected = Vec::new();
        if self.find(&words).is_none() {
            (words, corrected) = self.correct(&words);
        }
        if let Some(index) = self.find(&words) {
            let (row, parts) = (self.unit_row(index), vec![self.phrases[index].clone()]);
            return Ok(Understood {
                row,
                parts,
                corrected,
                unknown: Vec::new(),
                whole: true,
                unread,
            });
        }
        let (mut found, mut unknown) = self.parts(&words, true);
        if found.is_empty() {
            (found, unknown) = self.parts(&words, false);
        }
        if found.is_empty() {
            return Err(PhraseError::Unknown { text: shortened(text), known: self.len() });
        }
        let mut row = vec![0.0; KEPT];
        for &(index, weight) in &found {
            row.iter_mut().zip(self.unit_row(index)).for_each(|(sum, v)| *sum += weight * v);
        }
        normalize_rows(&mut row, KEPT);
        let parts = found.iter().map(|&(index, _)| self.phrases[index].clone()).collect();
        Ok(Understood { row, parts, corrected, unknown, whole: false, unread })
    }

    /// The longest known parts from left to right with their weights, and words in none; `skip`: words that say
    /// little are no parts. A part of two words says twice as much as one, and one behind a preposition half.
    fn parts(&self, words: &[String], skip: bool) -> (Vec<(usize, f32)>, Vec<String>) {
        let (mut found, mut unknown, mut weight) = (Vec::new(), Vec::new(), 1.0);
        let mut at = 0;
        while at < words.len() {
            let longest = (words.len() - at).min(LONGEST_PART);
            let part = (1..=longest).rev().find_map(|length| {
                let part = &words[at..at + length];
                let is_empty = skip && part.iter().all(|w| is_filling(w));
                if is_empty { None } else { Some((self.find(part)?, length)) }
            });
            match part {
                Some((index, length)) => {
                    found.push((index, length as f32 * weight));
                    at += length;
                }
                None => {
                    if is_preposition(&words[at]) {
                        weight = BEHIND_PREPOSITION;
                    } else if !is_filling(&words[at]) {
                        unknown.push(words[at].clone());
                    }
                    at += 1;
                }
            }
        }
        (found, unknown)
    }
}

//! A phrase as the words that its grammar is read from.

/// Words that say nothing about what is meant: articles, and what joins a denial to its noun ("that is not").
const SILENT: &[&str] = &[
    "a", "an", "the", "this", "that", "these", "those", "some", "any", "my", "your", "his", "her",
    "its", "our", "their", "please", "is", "are", "am", "be", "was", "were", "which", "who", "it",
    "there", "do", "does", "did",
];

/// "Not" in one word with another, without its apostrophe.
const JOINED_NOT: &[&str] =
    &["isnt", "arent", "wasnt", "werent", "dont", "doesnt", "didnt", "cant", "wont", "aint"];

/// What comes before an apostrophe in French: "l'armoire".
const ELIDED: &[&str] = &["l", "d", "j", "c", "qu", "s"];

/// The words of a phrase in lower case, without silent ones; commas and the like are "and", an operator that denies
/// ("!bed", "-bed") is "not".
pub(super) fn words(text: &str) -> Vec<String> {
    let text = text.to_lowercase().replace(['\u{2019}', '\u{2018}', '`'], "'");
    let mut found: Vec<String> = Vec::new();
    for part in text.split_whitespace().map(|part| if part == "w/o" { "without" } else { part }) {
        let rest = part.trim_start_matches(['!', '-', '\u{2212}', '\u{ac}', '~']);
        if rest.len() < part.len() && rest.starts_with(char::is_alphanumeric) {
            found.push("not".to_owned());
        }
        let mut word = String::new();
        for c in rest.chars().chain([' ']) {
            if c.is_alphanumeric() || c == '\'' {
                word.push(c);
                continue;
            }
            push(&mut found, &word);
            word.clear();
            if matches!(c, ',' | ';' | '&' | '+' | '/') {
                found.push("and".to_owned());
            }
        }
    }
    found.retain(|word| !SILENT.contains(&word.as_str()));
    found
}

/// Adds a word, or the two that it is with an apostrophe.
fn push(found: &mut Vec<String>, word: &str) {
    let word = word.trim_matches('\'');
    if word.ends_with("n't") || JOINED_NOT.contains(&word) {
        found.push("not".to_owned());
        return;
    }
    let word = word.strip_suffix("'s").unwrap_or(word);
    let word = match word.split_once('\'') {
        Some((before, rest)) if ELIDED.contains(&before) => rest.to_owned(),
        _ => word.replace('\'', ""),
    };
    if !word.is_empty() {
        found.push(word);
    }
}

/// How many words at the start of `words` a text takes; `None` if it is not there.
pub(super) fn starts_with(words: &[String], text: &str) -> Option<usize> {
    let mut length = 0;
    for part in text.split(' ') {
        if words.get(length)? != part {
            return None;
        }
        length += 1;
    }
    Some(length)
}

//! Texts as the words that a table is searched by.

/// Words that change nothing about what is meant.
const DROPPED: &[&str] = &[
    "a", "an", "the", "this", "that", "these", "those", "some", "any", "my", "your", "his", "her",
    "its", "our", "their", "please", "is", "are", "am",
];

/// Words that phrases are full of and that say little alone: parts of a phrase are not made of them.
const FILLING: &[&str] = &[
    "about", "after", "against", "all", "and", "around", "as", "at", "be", "been", "before",
    "behind", "below", "beside", "by", "can", "could", "do", "does", "for", "from", "front",
    "goes", "has", "have", "i", "in", "inside", "into", "it", "kind", "like", "made", "me", "near",
    "next", "not", "of", "off", "on", "one", "onto", "or", "out", "outside", "over", "piece",
    "place", "put", "so", "sort", "than", "then", "there", "thing", "things", "to", "under", "up",
    "used", "very", "was", "what", "when", "where", "which", "while", "who", "will", "with",
    "would",
];

/// What follows them says more about what stands before: "a table in front of the sofa" is a table.
const PREPOSITIONS: &[&str] = &[
    "about", "above", "against", "around", "at", "behind", "below", "beneath", "beside", "between",
    "by", "for", "from", "front", "in", "inside", "into", "near", "next", "on", "onto", "outside",
    "over", "under", "with", "without",
];

/// Words that count as another.
const SAME: &[(&str, &str)] = &[
    ("we", "i"),
    ("you", "i"),
    ("he", "i"),
    ("she", "i"),
    ("they", "i"),
    ("people", "i"),
    ("somewhere", "place"),
    ("anywhere", "place"),
    ("anything", "something"),
    ("stuff", "something"),
];

/// Plurals that no ending tells.
const IRREGULAR: &[(&str, &str)] = &[
    ("men", "man"),
    ("women", "woman"),
    ("children", "child"),
    ("people", "person"),
    ("feet", "foot"),
    ("teeth", "tooth"),
    ("geese", "goose"),
    ("mice", "mouse"),
    ("knives", "knife"),
    ("lives", "life"),
    ("wives", "wife"),
    ("dice", "die"),
    ("matrices", "matrix"),
];

/// A text as a table is searched for it: lower case, words apart by one space, without punctuation, articles and the
/// like; "a place we sleep" and "somewhere you sleep" are the same.
pub fn normalized(text: &str) -> String {
    normalized_words(text).join(" ")
}

pub(crate) fn normalized_words(text: &str) -> Vec<String> {
    // An apostrophe joins, but for the one of a possessive.
    let text = text.to_lowercase().replace(['\u{2019}', '\u{2018}', '`'], "'");
    let words = text.split(|c: char| !c.is_alphanumeric() && c != '\'').map(|word| {
        let word = word.trim_matches('\'');
        word.strip_suffix("'s").unwrap_or(word).replace('\'', "")
    });
    let words = words.filter(|w| !w.is_empty() && !DROPPED.contains(&w.as_str()));
    let same = |word: String| match SAME.iter().find(|(other, _)| *other == word) {
        Some((_, word)) => (*word).to_owned(),
        None => word,
    };
    let mut words: Vec<String> = words.map(same).collect();
    // "Thing to sit on" and "something to sit on".
    if let [first, second, ..] = &mut words[..]
        && matches!(first.as_str(), "thing" | "things" | "object" | "item")
        && second == "to"
    {
        *first = "something".to_owned();
    }
    words
}

/// Whether a word says little alone.
pub(super) fn is_filling(word: &str) -> bool {
    word == "something" || FILLING.contains(&word)
}

/// Whether what follows a word says more about what stands before it.
pub(super) fn is_preposition(word: &str) -> bool {
    PREPOSITIONS.contains(&word)
}

/// What a word may be a form of, without itself: a plural, or a verb in -ing or -ed.
pub(crate) fn bases(word: &str) -> impl Iterator<Item = String> + '_ {
    let irregular = IRREGULAR.iter().filter(move |(form, _)| *form == word).map(|(_, base)| *base);
    let endings = [("s", ""), ("es", ""), ("ies", "y"), ("ves", "f"), ("ves", "fe")];
    let regular = endings.into_iter().filter_map(move |(end, base)| {
        let stem = word.strip_suffix(end)?;
        // "Glass" and "bus" are no plurals.
        let is_form = stem.chars().count() >= 2 && !(end == "s" && stem.ends_with(['s', 'u', 'i']));
        is_form.then(|| format!("{stem}{base}"))
    });
    let verbs = ["ing", "ed"].into_iter().flat_map(move |end| verb_bases(word, end));
    irregular.map(str::to_owned).chain(regular).chain(verbs)
}

/// What a verb with this ending is a form of: "sitting", "moving", "framed".
fn verb_bases(word: &str, end: &str) -> Vec<String> {
    let Some(stem) = word.strip_suffix(end).filter(|stem| stem.chars().count() >= 3) else {
        return Vec::new();
    };
    let mut letters = stem.chars().rev();
    let (last, before) = (letters.next(), letters.next());
    let mut found = vec![stem.to_owned(), format!("{stem}e")];
    if let Some(last) = last.filter(|_| last == before) {
        found.push(stem.trim_end_matches(last).to_owned() + &last.to_string());
    }
    found
}

/// The spellings under which a table may hold these words: as they are, the last one singular, all of them
/// singular, the last one plural.
pub(super) fn spellings(words: &[String]) -> impl Iterator<Item = String> {
    let last = words.last().map_or("", String::as_str);
    let head = words[..words.len().saturating_sub(1)].join(" ");
    let with = move |end: &str| match head.as_str() {
        "" => end.to_owned(),
        head => format!("{head} {end}"),
    };
    let singular = |word: &String| bases(word).next().unwrap_or_else(|| word.clone());
    let all_singular = words.iter().map(singular).collect::<Vec<_>>().join(" ");
    let mut found = vec![words.join(" ")];
    found.extend(bases(last).map(|base| with(&base)));
    found.extend([all_singular, with(&format!("{last}s"))]);
    found.into_iter().filter(|_| !words.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_that_mean_the_same_are_the_same() {
        for (text, form) in [
            ("A place to sleep", "place to sleep"),
            ("somewhere to sleep!", "place to sleep"),
            ("Thing to sit on", "something to sit on"),
            ("where you wash your hands", "where i wash hands"),
            ("the children's beds", "children beds"),
            ("TV-stand", "tv stand"),
            ("o'clock", "oclock"),
            ("\u{0} … !", ""),
            ("Stra\u{df}e \u{1f6cb}", "stra\u{df}e"),
        ] {
            assert_eq!(normalized(text), form, "{text}");
            assert_eq!(normalized(form), form, "{text}");
        }
    }

    #[test]
    fn forms_have_their_word() {
        let found = |word: &str| bases(word).collect::<Vec<_>>();
        for (plural, singular) in [
            ("chairs", "chair"),
            ("boxes", "box"),
            ("shelves", "shelf"),
            ("knives", "knife"),
            ("berries", "berry"),
            ("children", "child"),
            ("sitting", "sit"),
            ("framed", "frame"),
            ("frying", "fry"),
            ("washed", "wash"),
        ] {
            assert!(found(plural).iter().any(|b| b == singular), "{plural}");
        }
        for word in ["glass", "bus", "s", "is", "sofa", "bed", "king", ""] {
            assert!(found(word).is_empty(), "{word}: {:?}", found(word));
        }
    }
}

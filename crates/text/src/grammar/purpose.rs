//! What a thing is for: "something to sit on", "where I wash my hands".

use crate::phrases::{bases, normalized_words};

/// What no class serves.
const NONE: &str = "";

/// What serves a purpose, as a text of the vocabulary, with the purposes. Articles and "my" are left out; words with "|"
/// between them may stand for each other, "_" is none. After "@" only of a place ("somewhere to eat", not "something to
/// eat"), after "#" only of a thing ("something to read", not "somewhere to read").
pub(super) const PURPOSES: &[(&str, &[&str])] = &[
    ("seat", &["sit|seated down|_ in|on|upon|_", "take|have seat"]),
    (
        "bed",
        &[
            "sleep in|on|_",
            "lie|lying|lay down|_ on|in|_",
            "take|have|_ nap in|on|_",
            "spend night in|on|_",
        ],
    ),
    (
        "table",
        &[
            "@ eat|dine",
            "eat|dine at|on",
            "@ eat|have breakfast|lunch|dinner|meal",
            "eat|have breakfast|lunch|dinner|meal at|on",
        ],
    ),
    (
        "desk",
        &[
            "@ work|study|write",
            "work|study|write at",
            "work on",
            "@ do homework|paperwork",
            "do homework|paperwork at|on",
        ],
    ),
    (
        "surface",
        &[
            "put|place|set|lay thing|something|object|item on",
            "put|place|set drink|cup|plate|coffee on",
            "@ put|place|set drink|cup|plate|coffee",
            "sit at",
        ],
    ),
    (
        "storage",
        &[
            "put|keep|store|stow thing|something|object|item in|away",
            "store|stow thing|something|object|item",
        ],
    ),
    (
        "wardrobe",
        &[
            "put|keep|store|hang clothes|clothing in|up|_",
            "clothes|clothing go|belong in|_",
            "for clothes|clothing",
        ],
    ),
    ("bookshelf", &["put|keep|store book in|on|_", "book go|belong|stand in|on|_", "for book"]),
    (
        "tv stand",
        &["put|place|stand tv|television|telly on|_", "tv|television|telly stand|go|sit on|_"],
    ),
    ("stool", &["put|rest foot|leg on|up"]),
    ("tv", &["# watch", "watch tv|television|telly|film|movie|news|show on|_"]),
    ("keyboard", &["type on|with"]),
    (
        "lamp",
        &[
            "light|illuminate|brighten up|_ room|house",
            "light room up",
            "give|make|produce light in|to|for|_ room|_",
        ],
    ),
    ("plant", &["# water"]),
    ("picture", &["hang on wall", "decorate wall with|_"]),
    (
        "mirror",
        &[
            "see|look|admire at|_ myself|yourself|oneself in|_",
            "see|check|look|do at|_ reflection|face|hair|makeup in|_",
        ],
    ),
    (
        "curtain",
        &[
            "block|keep|shut out|_ sun|light|daylight|sunlight out|_",
            "darken room",
            "cover|hide window with|_",
        ],
    ),
    ("rug", &["cover floor with|_"]),
    ("pillow", &["rest|lay|put head on", "@ rest|lay|put head"]),
    ("book", &["# read"]),
    ("box", &["pack thing|something|_ in|into", "move|moving house with|in|_"]),
    (
        "trash can",
        &[
            "@ throw|toss away|out|_ rubbish|trash|garbage|waste|litter|thing|something|_ away|out|_",
            "throw|toss rubbish|trash|garbage|waste|litter|thing|something in|into|away",
            "put rubbish|trash|garbage|waste|litter in|into|_",
            "rubbish|trash|garbage|waste|litter go|belong in|_",
            "for rubbish|trash|garbage|waste|litter",
        ],
    ),
    ("mug", &["drink coffee|tea|_ out|_ of|from|in"]),
    ("clock", &["tell|know|see|read|check|show|measure time on|from|with|_", "wake i|me up|_"]),
    ("radiator", &["heat|warm room|house up|_", "keep room|house warm", "give|make heat"]),
    (
        "toilet",
        &[
            "pee|poo|poop|wee|urinate in|_",
            "go to|_ toilet",
            "relieve myself|yourself|oneself in|_",
        ],
    ),
    (
        "sink",
        &[
            "wash hand|face|dish|plate|cup in|_",
            "@ wash up|_",
            "wash up|_ in",
            "do dish|washing in|up|_",
            "brush|clean tooth at|in|_",
        ],
    ),
    (
        "bathtub",
        &["bathe|soak in|_", "take|have bath|soak in|_", "bathe|wash myself|yourself|oneself in|_"],
    ),
    (
        "refrigerator",
        &[
            "keep|store food|milk|beer|drink|meat|butter cold|cool|fresh|chilled in|_",
            "cool|chill food|milk|beer|drink in|_",
            "keep|store|put milk|meat|butter in|_",
            "food|milk|beer|drink stay|keep cold|cool|fresh in|_",
        ],
    ),
    (
        "stove",
        &[
            "cook|bake|fry|roast|boil on",
            "@ cook|bake|fry|roast",
            "cook|bake|fry|roast|boil food|dinner|meal|egg|bread|cake|meat|potato on|in",
            "@ cook|bake|fry|roast|boil food|dinner|meal|egg|bread|cake|meat|potato",
        ],
    ),
    (
        "range hood",
        &[
            "remove|extract|suck away|up|out|in|_ cooking|bad|_ smell|steam|smoke|fume|odor away|out|_",
        ],
    ),
    (
        "window",
        &[
            "look|see out|outside of|from|through|_",
            "let in|_ fresh|_ light|air|sun|sunlight|daylight in|_",
        ],
    ),
    ("door", &["go|walk|come|pass in|out|through|inside|outside", "enter|leave|exit room|house|_"]),
    ("floor", &["walk on"]),
    (NONE, &["# eat|drink|wear", "wash|clean|dry|iron clothes|clothing|laundry in|with|on|_"]),
];

/// Words before a purpose: a thing or a place without a name, and who uses it.
const LEADING: &[&str] = &[
    "something",
    "thing",
    "object",
    "item",
    "furniture",
    "piece",
    "of",
    "place",
    "spot",
    "area",
    "room",
    "one",
    "what",
    "where",
    "which",
    "to",
    "for",
    "used",
    "use",
    "i",
    "child",
    "kid",
    "guest",
    "person",
    "can",
    "could",
    "may",
    "might",
    "do",
    "does",
    "will",
    "would",
    "should",
    "usually",
    "normally",
    "always",
    "often",
    "want",
    "need",
    "in",
    "on",
    "comfortable",
    "comfy",
    "nice",
    "good",
    "it",
    "be",
    "go",
    "show",
    "me",
    "find",
];
/// One of these is among them: "bed sleeps" says no purpose.
const OPENING: &[&str] = &[
    "something",
    "thing",
    "object",
    "item",
    "furniture",
    "place",
    "spot",
    "what",
    "where",
    "to",
    "for",
];
/// Longer phrases say more than a purpose.
const MOST_WORDS: usize = 16;

/// Words for a place, and for a thing, before a purpose.
const PLACES: &[&str] = &["place", "where", "spot", "area", "room"];
const THINGS: &[&str] = &["something", "thing", "object", "item", "what", "which"];

/// What serves the purpose that a phrase names, as a text of the vocabulary, empty if no class does; `None` if it names
/// something else.
pub(crate) fn serving(text: &str) -> Option<&'static str> {
    let words = normalized_words(text);
    if words.len() > MOST_WORDS {
        return None;
    }
    let lead = words.iter().take_while(|word| is_any(word, LEADING)).count();
    let opening = words[..lead].iter().position(|word| is_any(word, OPENING))?;
    // What may lead may also be what is done: "where I go out".
    (opening + 1..=lead).rev().find_map(|at| {
        let (before, rest) = words.split_at(at);
        let named = |pattern: &str| {
            let (kind, pattern) = match pattern.split_once(' ') {
                Some(("@", pattern)) => (Some(PLACES), pattern),
                Some(("#", pattern)) => (Some(THINGS), pattern),
                _ => (None, pattern),
            };
            let is_kind = kind.is_none_or(|kind| before.iter().any(|word| is_any(word, kind)));
            is_kind && fits(rest, &pattern.split(' ').collect::<Vec<_>>())
        };
        let found = PURPOSES.iter().find(|(_, purposes)| purposes.iter().any(|p| named(p)));
        found.map(|(text, _)| *text)
    })
}

/// Whether words fill all slots of a purpose.
fn fits(words: &[String], slots: &[&str]) -> bool {
    let Some((slot, slots)) = slots.split_first() else { return words.is_empty() };
    slot.split('|').any(|own| match words {
        _ if own == "_" => fits(words, slots),
        [word, words @ ..] => is_form(word, own) && fits(words, slots),
        [] => false,
    })
}

fn is_any(word: &str, bases: &[&str]) -> bool {
    bases.iter().any(|base| is_form(word, base))
}

fn is_form(word: &str, base: &str) -> bool {
    word == base || bases(word).any(|other| other == base)
}

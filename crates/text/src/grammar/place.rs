//! Words that say where a thing stands.

use super::tokens::starts_with;
use scenesplat_objects::relations::Relation;

/// Words for places, and the relation of boxes that they are; the longest at a place counts.
pub(super) const PLACES: &[(&str, Option<Relation>)] = &[
    ("on", Some(Relation::On)),
    ("on top of", Some(Relation::On)),
    ("onto", Some(Relation::On)),
    ("upon", Some(Relation::On)),
    ("atop", Some(Relation::On)),
    ("auf", Some(Relation::On)),
    ("sur", Some(Relation::On)),
    ("above", Some(Relation::Above)),
    ("over", Some(Relation::Above)),
    ("über", Some(Relation::Above)),
    ("au dessus de", Some(Relation::Above)),
    ("under", Some(Relation::Under)),
    ("underneath", Some(Relation::Under)),
    ("beneath", Some(Relation::Under)),
    ("below", Some(Relation::Under)),
    ("unter", Some(Relation::Under)),
    ("sous", Some(Relation::Under)),
    ("in", Some(Relation::In)),
    ("inside", Some(Relation::In)),
    ("inside of", Some(Relation::In)),
    ("within", Some(Relation::In)),
    ("into", Some(Relation::In)),
    ("im", Some(Relation::In)),
    ("dans", Some(Relation::In)),
    ("near", Some(Relation::Near)),
    ("near to", Some(Relation::Near)),
    ("nearby", Some(Relation::Near)),
    ("next to", Some(Relation::Near)),
    ("close to", Some(Relation::Near)),
    ("beside", Some(Relation::Near)),
    ("adjacent to", Some(Relation::Near)),
    ("alongside", Some(Relation::Near)),
    ("by", Some(Relation::Near)),
    ("neben", Some(Relation::Near)),
    ("bei", Some(Relation::Near)),
    ("près de", Some(Relation::Near)),
    ("près du", Some(Relation::Near)),
    ("à côté de", Some(Relation::Near)),
    ("à côté du", Some(Relation::Near)),
    // What boxes do not tell.
    ("left of", None),
    ("to left of", None),
    ("on left of", None),
    ("right of", None),
    ("to right of", None),
    ("on right of", None),
    ("in front of", None),
    ("in back of", None),
    ("in middle of", None),
    ("in center of", None),
    ("on side of", None),
    ("front of", None),
    ("behind", None),
    ("between", None),
    ("among", None),
    ("opposite", None),
    ("opposite of", None),
    ("across from", None),
    ("facing", None),
    ("against", None),
    ("along", None),
    ("around", None),
    ("at", None),
    ("outside", None),
    ("outside of", None),
    ("beyond", None),
    ("touching", None),
    ("attached to", None),
    ("connected to", None),
    ("far from", None),
    ("away from", None),
    ("closest to", None),
    ("nearest to", None),
    ("nearest", None),
    ("farthest from", None),
    ("furthest from", None),
    ("with", None),
    ("hinter", None),
    ("vor", None),
    ("zwischen", None),
    ("links von", None),
    ("rechts von", None),
    ("mit", None),
    ("derrière", None),
    ("devant", None),
    ("entre", None),
    ("avec", None),
    ("à gauche de", None),
    ("à droite de", None),
];

/// Words before a place that say nothing: "standing on", "right next to".
const HOLDING: &[&str] = &[
    "standing", "lying", "sitting", "hanging", "placed", "resting", "leaning", "mounted",
    "located", "put", "right", "directly", "just", "down",
];

/// The most words of a phrase that are searched for places.
const MOST_WORDS: usize = 256;
/// So many words after those of a place are searched for a name.
const REACH: usize = 6;

/// A place in a phrase.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Found<'a> {
    /// What is looked for.
    pub what: &'a [String],
    /// The words of the place.
    pub word: String,
    /// What it is among boxes.
    pub relation: Option<Relation>,
    /// What the place is by.
    pub to: &'a [String],
}

/// The first words of a place with a name behind them.
pub(super) fn place<'a>(
    words: &'a [String],
    is_name: &dyn Fn(&[String]) -> bool,
) -> Option<Found<'a>> {
    let holds_name = |words: &[String]| {
        let words = &words[..words.len().min(REACH)];
        (0..words.len()).any(|from| (from + 1..=words.len()).any(|to| is_name(&words[from..to])))
    };
    (0..words.len().min(MOST_WORDS)).find_map(|at| {
        let here =
            PLACES.iter().filter_map(|place| Some((starts_with(&words[at..], place.0)?, place)));
        let (length, (word, relation)) = here.max_by_key(|(length, _)| *length)?;
        let to = &words[at + length..];
        let holding = |word: &&String| HOLDING.contains(&word.as_str());
        let end = at - words[..at].iter().rev().take_while(holding).count();
        let found =
            Found { what: &words[..end], word: (*word).to_owned(), relation: *relation, to };
        holds_name(to).then_some(found)
    })
}

//! What a phrase says about the names in it: that they are meant, that they are not, or where they stand.
//!
//! `query`, `objects` and `text` read phrases by [`Phrase::parse`] before anything looks for what they name. A phrase
//! that denies must never be taken for what it denies, so what cannot be read for certain is an error.

mod denial;
mod everyday;
mod foreign;
mod names;
mod place;
mod purpose;
mod tokens;

use crate::error::shortened;
use crate::{PhraseError, PhraseTable};
use denial::{Denial, denials, is_everything};
use names::{NoLabel, is_name, label_of, labels_of};
pub(crate) use purpose::serving;
use scenesplat_objects::relations::Relation;
use scenesplat_rooms::{ClassId, Vocabulary};
use std::fmt;

/// A phrase by its grammar.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Phrase {
    /// It names what is looked for: "red chair", "a place to sleep".
    Plain,
    /// It names what is not looked for: "everything except the walls".
    Denied(Denied),
    /// It says where the thing stands: "the lamp on the desk".
    Placed(Placed),
}

/// All but some things.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Denied {
    /// The phrase.
    pub text: String,
    /// What they are taken from, in lower case; `None`: everything.
    pub all: Option<String>,
    /// What is denied, in lower case: "walls and floor".
    pub but: String,
}

/// Things where they stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placed {
    /// The phrase.
    pub text: String,
    /// What is looked for, in lower case; `None`: everything there.
    pub what: Option<String>,
    /// How it stands to the other; `None` if boxes do not tell ("left of").
    pub relation: Option<Relation>,
    /// The words for it: "next to".
    pub word: String,
    /// The other, in lower case.
    pub to: String,
}

/// The labels that a phrase leaves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Remaining {
    /// What is looked for, sorted, at least one.
    pub chosen: Vec<usize>,
    /// The names of those that are denied, at least one.
    pub denied: Vec<String>,
    /// How the phrase was read: "all that has a label other than bed".
    pub reading: String,
}

impl Phrase {
    /// Reads a phrase. A phrase that is one of `labels` is plain, whatever words it has ("no parking sign"), and a
    /// place counts if what it is by is one of them or known to the vocabulary ("something soft under my head" is plain).
    ///
    /// # Errors
    /// If it denies nothing ("not"), twice ("no chair but the table"), some of a class ("not all chairs"), or beside a
    /// place.
    pub fn parse(text: &str, labels: &[String]) -> Result<Self, PhraseError> {
        let words = tokens::words(text);
        if label_of(&words, labels).is_some() {
            return Ok(Self::Plain);
        }
        let is_name = |words: &[String]| is_name(words, labels);
        if let Some(color) = words.iter().find(|word| foreign::is_color(word)) {
            return refused(
                text,
                format!("names a color in another language: say {color:?} in English"),
            );
        }
        let place = |words| place::place(words, &is_name);
        match &denials(&words)[..] {
            [] => Ok(match place(&words).filter(|_| !is_whole(text) && serving(text).is_none()) {
                Some(place) => Self::Placed(placed(text, place)),
                None => Self::Plain,
            }),
            [denial] if place(denial.before).or(place(denial.after)).is_some() => {
                refused(text, "denies something and says where: ask for one of the two")
            }
            [denial] => denied(text, denial, &is_name).map(Self::Denied),
            _ => refused(
                text,
                "denies more than once: deny once, such as \"everything except the chairs and the table\"",
            ),
        }
    }
}

/// What the words of a place say.
fn placed(text: &str, place: place::Found<'_>) -> Placed {
    Placed {
        text: text.to_owned(),
        what: (!is_everything(place.what)).then(|| place.what.join(" ")),
        // Whether a thing is in a room is no question of boxes.
        relation: place.relation.filter(|_| !is_room(place.to)),
        word: place.word,
        to: place.to.join(" "),
    }
}

/// Whether the phrase table has it as one: "something to hang on the wall".
fn is_whole(text: &str) -> bool {
    PhraseTable::embedded().is_ok_and(|table| table.row(text).is_some())
}

fn is_room(words: &[String]) -> bool {
    matches!(words, [room] if room == "kitchen" || room == "bathroom")
}

fn refused<T>(text: &str, problem: impl Into<String>) -> Result<T, PhraseError> {
    Err(PhraseError::Meaning { text: shortened(text), problem: problem.into() })
}

/// What one denial says.
fn denied(
    text: &str,
    denial: &Denial<'_>,
    is_name: &dyn Fn(&[String]) -> bool,
) -> Result<Denied, PhraseError> {
    let mut but = denial.but();
    if but.is_empty() || is_everything(but) {
        return refused(
            text,
            "denies, but not what: name it, such as \"everything except the walls\"",
        );
    }
    if denial.is_partial() {
        return refused(text, "denies some of a class: which ones, labels do not tell");
    }
    let mut all = denial.all();
    // "Non-bed furniture" denies one word, "non-red chair" a color of what follows.
    if denial.is_prefix() && but.len() > 1 && !is_name(but) {
        let rest = but[1..].join(" ");
        all = Some(all.map_or(rest.clone(), |all| format!("{all} {rest}")));
        but = &but[..1];
    }
    Ok(Denied { text: text.to_owned(), all, but: but.join(" ") })
}

impl Denied {
    /// The labels that are left, and those that are denied. A label is a class name, a synonym, a group of the
    /// vocabulary or a name in German or French; nothing is guessed by similarity here.
    ///
    /// # Errors
    /// If what is denied is no label, is told by a color, or is not among what it is taken from; if nothing is left.
    pub fn labels(&self, labels: &[String]) -> Result<Remaining, PhraseError> {
        let all = match &self.all {
            Some(all) => self.named(all, labels)?,
            None => (0..labels.len()).collect(),
        };
        let denied = self.named(&self.but, labels)?;
        let names = |of: &[usize]| -> Vec<String> {
            of.iter().map(|&label| labels[label].clone()).collect()
        };
        let chosen: Vec<usize> =
            all.iter().copied().filter(|label| !denied.contains(label)).collect();
        if let (Some(text), true) = (&self.all, chosen.len() == all.len()) {
            let text = shortened(text);
            return refused(
                &self.text,
                format!(
                    "takes {:?} from {text:?}, where they are not: ask for {text:?} alone",
                    shortened(&self.but)
                ),
            );
        }
        if chosen.is_empty() {
            return refused(&self.text, "leaves nothing to look for");
        }
        let reading = match &self.all {
            Some(_) => format!("what is labeled {}", names(&chosen).join(", ")),
            None => format!("all that has a label other than {}", names(&denied).join(", ")),
        };
        Ok(Remaining { chosen, denied: names(&denied), reading })
    }

    fn named(&self, part: &str, labels: &[String]) -> Result<Vec<usize>, PhraseError> {
        let words: Vec<String> = part.split(' ').map(str::to_owned).collect();
        labels_of(&words, labels).or_else(|no| {
            let problem = match no {
                NoLabel::Color => format!(
                    "denies by a color ({:?}), and only what is looked for is told by its color: ask for {} and \
                     take it from the rest",
                    shortened(part),
                    self.in_color(part)
                ),
                NoLabel::Unknown(name) => format!(
                    "denies by labels, and {:?} is the name of none: name a class, such as \"everything except the \
                     walls\"",
                    shortened(&name)
                ),
            };
            refused(&self.text, problem)
        })
    }

    /// What to ask for in place of a denied color: "all chairs except the red one" by "red chairs".
    fn in_color(&self, part: &str) -> String {
        let has_noun = Vocabulary::named(part).is_ok_and(|named| !named.nouns.is_empty());
        match &self.all {
            Some(all) if !has_noun && part == self.but => {
                format!("{:?}", shortened(&format!("{part} {all}")))
            }
            _ => format!("{:?}", shortened(part)),
        }
    }
}

/// Which labels a plain name is, sorted: a label in the singular or plural, or what the vocabulary takes for classes
/// that are among the labels ("couch", "seat", "Stuhl"). `None` if it names none, or a color.
pub fn named_labels(name: &str, labels: &[String]) -> Option<Vec<usize>> {
    labels_of(&tokens::words(name), labels).ok()
}

/// The words that deny what follows them, for readers of phrases that do not run here.
pub fn denial_words() -> &'static [&'static str] {
    denial::DENIALS
}

/// The words for places, with the relation that they are where boxes tell it, for readers of phrases that do not run here.
pub fn place_words() -> &'static [(&'static str, Option<Relation>)] {
    place::PLACES
}

/// Articles, and names of classes in German, French and everyday English, in every spelling that is read, for readers of
/// phrases that do not run here.
pub fn foreign_names() -> (&'static [&'static str], &'static [(String, ClassId)]) {
    foreign::spellings()
}

/// The class whose name in German or French, or in everyday English, a phrase is.
pub(crate) fn foreign_class(text: &str) -> Option<ClassId> {
    foreign::class_of(&tokens::words(text))
}

/// The class whose English name of everyday use a phrase is, a name that means nothing else at home.
pub(crate) fn everyday_class(text: &str) -> Option<ClassId> {
    everyday::class_of(&tokens::words(text))
}

/// What serves purposes, as texts of the vocabulary (empty: none of the classes), with patterns of the purposes, for readers
/// of phrases that do not run here. In a pattern "|" separates words that may stand for each other, "_" is none; "@" before
/// it: of places only, "#": of things only.
pub fn purposes() -> &'static [(&'static str, &'static [&'static str])] {
    purpose::PURPOSES
}

/// Whether a phrase is a thing of homes that is none of the classes: a kettle.
pub fn is_other_thing(text: &str) -> bool {
    everyday::is_other(&tokens::words(text))
}

/// The name of these that a phrase of unknown words is a letter from, or ends with in one word.
pub(crate) fn similar_name(text: &str) -> Option<(String, ClassId)> {
    let words = tokens::words(text);
    foreign::misspelt(&words).or_else(|| foreign::compound(&words))
}

/// What the place is: "where it stands (next to bed)".
impl fmt::Display for Placed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.word, shortened(&self.to))
    }
}

//! What a phrase asks a network for that was trained with the vocabulary of synthetic rooms.

use crate::error::shortened;
use crate::grammar::{everyday_class, foreign_class};
use crate::phrases::{told, took};
use crate::{Phrase, PhraseError, PhraseReader, Placed, Query, Reading, Verdict};
use scenesplat_rooms::Vocabulary;
use scenesplat_rooms::vocabulary::{Named, VocabularyError};
use scenesplat_scene::SceneError;

/// Why a phrase asks for nothing.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AskError {
    /// It has no vector, or denies what cannot be denied.
    #[error(transparent)]
    Phrase(#[from] PhraseError),
    /// It has no word, or the vocabulary is broken.
    #[error(transparent)]
    Vocabulary(#[from] VocabularyError),
    /// The vectors of the vocabulary are broken.
    #[error(transparent)]
    Texts(#[from] SceneError),
    /// No class is like it.
    #[error(
        "nothing in this vocabulary is like {:?}: {reading} (ask for one of these classes by its name to see it \
         all the same)",
        shortened(&reading.text)
    )]
    NothingAlike {
        /// What it was compared with.
        reading: Box<Reading>,
    },
    /// It asks for a thing by its place.
    #[error(
        "{:?} says where a thing stands ({placed}), which features of Gaussians do not tell: ask for {:?} alone",
        shortened(&placed.text),
        shortened(placed.what.as_deref().unwrap_or(&placed.to))
    )]
    Placed {
        /// What it says.
        placed: Box<Placed>,
    },
}

/// What is asked for, and how it was understood.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    /// What to look for.
    pub query: Query,
    /// The text of the vocabulary that it is, where that is not the phrase itself: "red chair".
    pub taken_for: Option<String>,
    /// How the phrase was read, if it is no text of the vocabulary.
    pub reading: Option<Reading>,
    /// What was changed about it before, or how a denial was read, in words; may be empty.
    pub remark: String,
    /// Classes that the phrase denies: "everything except the walls". Empty if it denies none.
    pub denied: Vec<String>,
}

/// A text of the vocabulary for a phrase that is plain.
#[derive(Debug, Clone, PartialEq)]
pub struct Known {
    /// The text, such as "red chair": the phrase itself if the vocabulary knows it.
    pub text: String,
    /// How the phrase was read, if it is no text of the vocabulary.
    pub reading: Option<Reading>,
    /// What was changed about it, in words; may be empty.
    pub remark: String,
}

/// Words that join two names: "box of books" names both.
const JOINING: &[&str] = &["and", "or", "of", "with", "in"];

/// The class that two names side by side are, in their colors: a "desk chair" is a chair.
fn compound_head(text: &str, named: &Named) -> Option<String> {
    let [first, head] = &named.nouns[..] else { return None };
    let (&[_], &[head]) = (&first[..], &head[..]) else { return None };
    let is_joined = text.chars().any(|c| !c.is_alphanumeric() && !matches!(c, ' ' | '-'))
        || text.to_lowercase().split(' ').any(|word| JOINING.contains(&word));
    let colors = named.colors.iter().map(|color| color.word());
    let words: Vec<&str> = colors.chain([head.about().name]).collect();
    (!is_joined).then(|| words.join(" "))
}

impl PhraseReader<'_> {
    /// What to look for in the features of a network that was trained with this vocabulary: what the vocabulary knows is
    /// looked for as it is; a misspelt text of the vocabulary as what was meant; anything else as the nearest class. What
    /// a phrase denies is what the classes that are looked for have to beat.
    ///
    /// # Errors
    /// If the phrase has no known word, or no class is like it; if it denies what cannot be denied, or asks for a place.
    pub fn ask(&self, vocabulary: &Vocabulary, text: &str) -> Result<Asked, AskError> {
        match Phrase::parse(text, &[])? {
            Phrase::Plain => {
                let Known { text: known, reading, remark } = self.known(text)?;
                let query = Query::of_vocabulary(vocabulary, &known)?;
                let query = Query { text: text.to_owned(), ..query };
                let taken_for = (known != text).then_some(known);
                Ok(Asked { query, taken_for, reading, remark, denied: Vec::new() })
            }
            Phrase::Denied(denied) => {
                let classes = vocabulary.class_table();
                let left = denied.labels(&classes.names)?;
                let query = Query::of_rows(&classes, text, &left.chosen)?;
                Ok(Asked {
                    query,
                    taken_for: Some(left.reading),
                    reading: None,
                    remark: String::new(),
                    denied: left.denied,
                })
            }
            Phrase::Placed(placed) => Err(AskError::Placed { placed: Box::new(placed) }),
        }
    }

    /// The text of the vocabulary that a plain phrase is taken for.
    ///
    /// # Errors
    /// If it has no known word, or no class is like it.
    pub fn known(&self, text: &str) -> Result<Known, AskError> {
        match Vocabulary::named(text) {
            // "Kitchen cupboard" is more than a cupboard.
            Ok(_) if everyday_class(text).is_some() => {}
            Ok(named) => {
                let head = compound_head(text, &named);
                let remark = head.as_ref().map_or(String::new(), |head| took(text, head));
                let text = head.unwrap_or_else(|| text.to_owned());
                return Ok(Known { text, reading: None, remark });
            }
            Err(VocabularyError::UnknownWord { .. }) => {}
            // Its own message would repeat a long text.
            Err(VocabularyError::NoWord { .. }) => return Err(PhraseError::no_word(text).into()),
            Err(error) => return Err(error.into()),
        }
        let (other, corrected) = self.table.corrected(text);
        let is_foreign = foreign_class(&Vocabulary::split_colors(text).1).is_some();
        if !corrected.is_empty() && !is_foreign && Vocabulary::named(&other).is_ok() {
            let remark = told(&corrected, "; ", |(typed, word)| took(typed, word));
            let remark = remark.unwrap_or_default();
            return Ok(Known { text: other, reading: None, remark });
        }
        let reading = self.read(text)?;
        if reading.verdict == Verdict::NothingAlike {
            return Err(AskError::NothingAlike { reading: Box::new(reading) });
        }
        let remark = reading.remark.clone();
        Ok(Known { text: reading.known_text(), reading: Some(reading), remark })
    }
}

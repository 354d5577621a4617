//! Any phrase, as one of the classes that the network inside the program knows.
//!
//! A phrase gets a vector, from the phrase table that the library carries or from a sentence encoder; what it is
//! nearest to among the names and synonyms of the classes is what it is taken for, and how near says whether to
//! believe it. That is a judgement about words: whether a scene has such a thing is another question.
//! `docs/text.md` has the figures.

use crate::grammar::{everyday_class, foreign_class, is_other_thing, serving, similar_name};
use crate::phrases::{told, took};
use crate::{PhraseError, PhraseTable, TextEncoder, dot};
use scenesplat_rooms::{ClassId, ColorName, Vocabulary};
use std::fmt;

/// From this similarity on, and with [`LEAD`], the nearest class is what was meant. Measured, see `docs/text.md`.
pub const SURE: f32 = 0.55;
/// How much more alike than every other class the one that was meant is; classes that are nearer than this to the first
/// may be meant as well. Measured, see `docs/text.md`.
pub const LEAD: f32 = 0.05;
/// Below this similarity, nothing among the classes is like the phrase.
pub const ALIKE: f32 = 0.40;

/// The most classes that a reading lists beside the one that is taken.
const MOST_NEAR: usize = 4;
/// Names and purposes are looked for in phrases of at most so many bytes.
const LONGEST_NAMED: usize = 200;

/// Phrases whose vectors an encoder has to give as the table has them, and the least cosine of the two.
const SAME_ENCODER: ([&str; 3], f32) = (["chair", "refrigerator", "place to sleep"], 0.98);

/// Whether the class that is nearest to a phrase is what was meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It is.
    Sure,
    /// It may be.
    NotSure,
    /// No class is.
    NothingAlike,
}

impl Verdict {
    /// By the similarity of the nearest classes, the nearest first.
    fn of(nearest: &[NearClass]) -> Self {
        let at = |i: usize| nearest.get(i).map_or(-1.0, |n| n.similarity);
        match at(0) {
            best if best >= SURE && best - at(1) >= LEAD => Self::Sure,
            best if best >= ALIKE => Self::NotSure,
            _ => Self::NothingAlike,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sure => "sure",
            Self::NotSure => "not sure",
            Self::NothingAlike => "nothing in this vocabulary is like it",
        })
    }
}

/// A class and how much it is like a phrase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearClass {
    /// Which class.
    pub class: ClassId,
    /// Cosine, about the middle of all phrases, with the nearest of its names, -1..=1.
    pub similarity: f32,
    /// That name.
    pub name: &'static str,
}

/// What a phrase was taken for.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The phrase.
    pub text: String,
    /// Colors that it names.
    pub colors: Vec<ColorName>,
    /// Every class, the nearest first; those that serve the purpose of the phrase before all others.
    pub nearest: Vec<NearClass>,
    /// What serves the purpose that the phrase names, as a text of the vocabulary: "seat" for "something to sit on". All
    /// its classes are meant.
    pub purpose: Option<&'static str>,
    /// Whether to believe the first of them.
    pub verdict: Verdict,
    /// What was corrected, put together, left out or not read; empty if the phrase was read as it is.
    pub remark: String,
}

impl Reading {
    /// The nearest class, or what serves the purpose, in the colors of the phrase: a text that the vocabulary knows.
    pub fn known_text(&self) -> String {
        let class = self.purpose.or(self.nearest.first().map(|n| n.class.about().name));
        self.in_colors(class)
    }

    /// The first classes that are as [`near`](Self::near) and like the phrase, in its colors: texts that the vocabulary knows.
    pub fn near_texts(&self) -> Vec<String> {
        let alike = self.near().filter(|near| near.similarity >= ALIKE).take(MOST_NEAR);
        alike.map(|near| self.in_colors(Some(near.class.about().name))).collect()
    }

    fn in_colors(&self, class: Option<&str>) -> String {
        let words: Vec<&str> = self.colors.iter().map(|c| c.word()).chain(class).collect();
        words.join(" ")
    }

    /// Classes that are less than [`LEAD`] behind the one that the phrase is taken for: they may be meant as well.
    pub fn near(&self) -> impl Iterator<Item = &NearClass> {
        let best = self.nearest.first().map_or(0.0, |first| first.similarity);
        let is_near = move |n: &&NearClass| best - n.similarity < LEAD && self.purpose.is_none();
        self.nearest.iter().skip(1).filter(is_near)
    }

    /// The class that the phrase is taken for and those that are as near, or what serves its purpose.
    fn taken(&self) -> String {
        if let Some(purpose) = self.purpose {
            let members: Vec<&str> = serving_classes(purpose).map(|c| c.about().name).collect();
            return match &members[..] {
                [class] => format!("{class} serves this purpose"),
                members => format!("all of {} serve this purpose", members.join(", ")),
            };
        }
        let first = self.nearest.first().map(NearClass::to_string).unwrap_or_default();
        let near: Vec<String> = self.near().take(MOST_NEAR).map(NearClass::to_string).collect();
        if near.is_empty() { first } else { format!("{first}; near: {}", near.join(", ")) }
    }
}

/// The classes of a text of the vocabulary that serves a purpose.
fn serving_classes(purpose: &str) -> impl Iterator<Item = ClassId> {
    Vocabulary::named(purpose).map(|named| named.classes()).unwrap_or_default().into_iter()
}

/// "chair 0.58", with the name that is so near if it is another: "chair 0.58 (as \"armchair\")".
impl fmt::Display for NearClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (class, similarity) = (self.class.about().name, self.similarity);
        write!(f, "{class} {similarity:.2}")?;
        if self.name == class { Ok(()) } else { write!(f, " (as {:?})", self.name) }
    }
}

/// The nearest class and those as near with their similarities, the verdict, and remarks: one line.
impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let colors = self.colors.iter().map(|c| format!("in {}", c.word()));
        let remark = Some(self.remark.clone()).filter(|r| !r.is_empty());
        let verdict = std::iter::once(self.verdict.to_string());
        let parts = std::iter::once(self.taken()).chain(colors).chain(verdict).chain(remark);
        f.write_str(&parts.collect::<Vec<_>>().join("; "))
    }
}

/// A phrase that has a class by a name that the phrase table does not have, or not as this class.
struct OtherName {
    text: String,
    remark: String,
    is_certain: bool,
}

/// Reads phrases.
#[derive(Debug)]
pub struct PhraseReader<'a> {
    pub(crate) table: &'static PhraseTable,
    encoder: Option<&'a TextEncoder>,
    /// Names of classes with their vectors.
    anchors: Vec<(&'static str, ClassId, Vec<f32>)>,
    /// Classes that are there, if that is known.
    there: Option<Vec<ClassId>>,
}

impl<'a> PhraseReader<'a> {
    /// With the phrase table alone, or with an encoder for what the table is made of.
    ///
    /// # Errors
    /// If the encoder is not the one that the table was made with, or the table does not hold the classes.
    pub fn new(encoder: Option<&'a TextEncoder>) -> Result<Self, PhraseError> {
        let table = PhraseTable::embedded()?;
        let anchor = |(name, class): (&'static str, ClassId)| {
            let row = table.row(name).ok_or_else(|| PhraseError::Table {
                problem: format!("lacks {name:?}, a name of the vocabulary: build it again"),
            })?;
            Ok((name, class, row))
        };
        let anchors =
            Vocabulary::class_phrases().map(anchor).collect::<Result<_, PhraseError>>()?;
        if let Some(encoder) = encoder {
            let (asked, has) = (table.encoder_dim(), encoder.dim());
            if asked != has {
                let folder = encoder.folder().display();
                let problem = format!(
                    "was made with all-MiniLM-L6-v2, {asked} numbers a phrase; the encoder in {folder} gives {has}"
                );
                return Err(PhraseError::Table { problem });
            }
            let (phrases, least) = SAME_ENCODER;
            let encoded = encoder.encode(&phrases)?;
            for (phrase, vector) in phrases.iter().zip(encoded.values.chunks_exact(encoded.dim)) {
                let row = table.row(phrase).unwrap_or_default();
                let cosine = dot(&table.project(vector)?, &row);
                if cosine < least {
                    let folder = encoder.folder().display();
                    let problem = format!(
                        "was made with all-MiniLM-L6-v2, and the encoder in {folder} reads {phrase:?} \
                         otherwise (cosine {cosine:.2}): its similarities mean nothing here"
                    );
                    return Err(PhraseError::Table { problem });
                }
            }
        }
        Ok(Self { table, encoder, anchors, there: None })
    }

    /// With the classes that are there: of classes that are as near to a phrase, one of these is taken, and that is said.
    #[must_use]
    pub fn among(mut self, there: &[ClassId]) -> Self {
        self.there = Some(there.to_vec());
        self
    }

    /// What a phrase is taken for, all its words taken as names: [`Phrase`](crate::Phrase) says first whether it denies
    /// them. Color words are taken out first, unless the table has them in a phrase ("red wine").
    ///
    /// # Errors
    /// If it has no word, or none that is known.
    pub fn read(&self, text: &str) -> Result<Reading, PhraseError> {
        let (mut colors, mut rest) = Vocabulary::split_colors(text);
        if colors.is_empty() || rest.is_empty() || self.table.row(text).is_some() {
            (colors, rest) = (Vec::new(), text.to_owned());
        }
        let purpose = self.purpose(&rest);
        let other = self.other_name(&rest).filter(|_| purpose.is_none());
        let mut remarks: Vec<String> = other.iter().map(|other| other.remark.clone()).collect();
        let mut is_certain = other.as_ref().is_none_or(|other| other.is_certain);
        let none = match &purpose {
            Some((served, _)) => served.is_empty().then_some("no class serves this purpose"),
            None => is_other_thing(&rest).then_some("it is another thing of homes"),
        };
        let purpose = purpose.filter(|(served, _)| !served.is_empty());
        rest = other.map_or(rest, |other| other.text);
        let (mut nearest, mut remark) = match self.encoder {
            None => {
                let understood = self.table.understand(&rest)?;
                // A word that is left out, or was meant as it stands, may be what changes the meaning.
                is_certain &= understood.unknown.is_empty() && understood.corrected.is_empty();
                (self.nearest(&understood.row), understood.to_string())
            }
            Some(encoder) => self.encoded(encoder, &rest)?,
        };
        if let Some((served, corrected)) = &purpose {
            let classes: Vec<ClassId> = serving_classes(served).collect();
            // Stable: the nearest first among both parts.
            nearest.sort_by_key(|near| !classes.contains(&near.class));
            remark = corrected.clone();
            is_certain = corrected.is_empty();
        } else if none.is_none() {
            remarks.extend(self.prefer_there(&mut nearest));
        }
        remarks.extend(
            Some(remark).into_iter().chain(none.map(str::to_owned)).filter(|r| !r.is_empty()),
        );
        let verdict = match Verdict::of(&nearest) {
            _ if none.is_some() => Verdict::NothingAlike,
            Verdict::Sure if !is_certain => Verdict::NotSure,
            _ if purpose.is_some() && is_certain => Verdict::Sure,
            _ if purpose.is_some() => Verdict::NotSure,
            verdict => verdict,
        };
        let (purpose, remark) = (purpose.map(|(served, _)| served), remarks.join("; "));
        Ok(Reading { text: text.to_owned(), colors, nearest, purpose, verdict, remark })
    }

    /// What serves the purpose that a phrase names, and which words were corrected to find it.
    fn purpose(&self, text: &str) -> Option<(&'static str, String)> {
        if text.len() > LONGEST_NAMED {
            return None;
        }
        if let Some(served) = serving(text) {
            return Some((served, String::new()));
        }
        let (other, corrected) = self.table.corrected(text);
        let remark = told(&corrected, "; ", |(typed, word)| took(typed, word))?;
        Some((serving(&other)?, remark))
    }

    /// A phrase with the name of a class for one of everyday use or another language; `None` if it has no such name.
    fn other_name(&self, text: &str) -> Option<OtherName> {
        if text.len() > LONGEST_NAMED {
            return None;
        }
        let of = |typed: &str, name: &str, class: ClassId, is_certain: bool| {
            let class = class.about().name;
            let text = text.strip_suffix(typed).map(|head| format!("{head}{class}"))?;
            let other = if name == typed { String::new() } else { format!(", {class:?}") };
            let remark = took(typed, if name == typed { class } else { name }) + &other;
            Some(OtherName { text, remark, is_certain })
        };
        if let Some(class) = everyday_class(text) {
            return of(text, text, class, true);
        }
        let is_whole = self.table.row(text).is_some();
        if let Some(class) = foreign_class(text) {
            // A word that English has too may not be meant as that of another language.
            return of(text, text, class, !is_whole);
        }
        if is_whole {
            return None;
        }
        // "Old telly": the longest name at the end.
        let mut tails = text.match_indices(' ').map(|(at, _)| &text[at + 1..]);
        if let Some((tail, class)) = tails.find_map(|tail| Some((tail, everyday_class(tail)?))) {
            return of(tail, tail, class, true);
        }
        if self.table.has_words(text) {
            return None;
        }
        let (name, class) = similar_name(text)?;
        of(text, &name, class, false)
    }

    /// Puts a class that is there before one that is as near and is not; says so.
    fn prefer_there(&self, nearest: &mut [NearClass]) -> Option<String> {
        let there = self.there.as_ref()?;
        let first = *nearest.first()?;
        let is_as_near = |n: &NearClass| {
            first.similarity - n.similarity < LEAD
                && n.similarity >= ALIKE
                && there.contains(&n.class)
        };
        let at = nearest.iter().position(is_as_near).filter(|at| *at > 0)?;
        // Nearer classes that are not there stay in their order behind it.
        nearest[..=at].rotate_right(1);
        Some(format!("{} is as near, but is not there", first.class.about().name))
    }

    /// As the encoder reads it; with misspelt words corrected only where that is more like a class.
    fn encoded(
        &self,
        encoder: &TextEncoder,
        text: &str,
    ) -> Result<(Vec<NearClass>, String), PhraseError> {
        let (other, corrected) = self.table.corrected(text);
        let mut texts = vec![text];
        if !corrected.is_empty() {
            texts.push(&other);
        }
        let encoded = encoder.encode(&texts)?;
        let rows = encoded.values.chunks_exact(encoded.dim).map(|v| self.table.project(v));
        let rows = rows.collect::<Result<Vec<_>, _>>()?;
        let mut remarks = Vec::new();
        if let Some(cut) = encoded.truncated.first() {
            remarks.push(format!(
                "only the first {} of its {} tokens were read",
                cut.read, cut.tokens
            ));
        }
        let mut nearest = self.nearest(&rows[0]);
        if let Some(row) = rows.get(1) {
            let best = |near: &[NearClass]| near.first().map_or(-1.0, |n| n.similarity);
            let other = self.nearest(row);
            if best(&other) > best(&nearest) {
                nearest = other;
                remarks.extend(
                    corrected.iter().map(|(typed, word)| format!("took {typed:?} as {word:?}")),
                );
            }
        }
        Ok((nearest, remarks.join("; ")))
    }

    /// All classes by the nearest of their names, the most alike first. `row`: unit vector in the table's space.
    pub fn nearest(&self, row: &[f32]) -> Vec<NearClass> {
        let mut best: Vec<Option<NearClass>> = vec![None; ClassId::ALL.len()];
        for (name, class, anchor) in &self.anchors {
            let similarity = dot(row, anchor);
            let best = &mut best[class.index()];
            if best.is_none_or(|b| similarity > b.similarity) {
                *best = Some(NearClass { class: *class, similarity, name });
            }
        }
        let mut found: Vec<NearClass> = best.into_iter().flatten().collect();
        found.sort_by(|a, b| b.similarity.total_cmp(&a.similarity).then(a.class.cmp(&b.class)));
        found
    }
}

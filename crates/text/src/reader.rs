//! Any phrase, as one of the classes that the network inside the program knows.
//!
//! A phrase gets a vector, from the phrase table that the library carries or from a sentence encoder; what it is
//! nearest to among the names and synonyms of the classes is what it is taken for, and how near says whether to
//! believe it. That is a judgement about words: whether a scene has such a thing is another question.
//! `docs/text.md` has the figures.

use crate::grammar::foreign_class;
use crate::{PhraseError, PhraseTable, TextEncoder, dot};
use scenesplat_rooms::{ClassId, ColorName, Vocabulary};
use std::fmt;

/// From this similarity on, and with [`LEAD`], the nearest class is what was meant. Measured, see `docs/text.md`.
pub const SURE: f32 = 0.55;
/// How much more alike than every other class the one that was meant is.
pub const LEAD: f32 = 0.05;
/// Below this similarity, nothing among the classes is like the phrase.
pub const ALIKE: f32 = 0.40;

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
    /// Every class, the nearest first.
    pub nearest: Vec<NearClass>,
    /// Whether to believe the first of them.
    pub verdict: Verdict,
    /// What was corrected, put together, left out or not read; empty if the phrase was read as it is.
    pub remark: String,
}

impl Reading {
    /// The nearest class in the colors of the phrase: a text that the vocabulary knows.
    pub fn known_text(&self) -> String {
        let class = self.nearest.first().map(|n| n.class.about().name);
        let words: Vec<&str> = self.colors.iter().map(|c| c.word()).chain(class).collect();
        words.join(" ")
    }
}

/// The nearest classes with their similarities, the verdict, and remarks: one line.
impl fmt::Display for Reading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let near = self.nearest.iter().take(3).map(|n| {
            let (class, similarity) = (n.class.about().name, n.similarity);
            if n.name == class {
                format!("{class} {similarity:.2}")
            } else {
                format!("{class} {similarity:.2} (as {:?})", n.name)
            }
        });
        let colors = self.colors.iter().map(|c| format!("in {}", c.word()));
        let remark = Some(self.remark.clone()).filter(|r| !r.is_empty());
        let verdict = std::iter::once(self.verdict.to_string());
        let parts = [near.collect::<Vec<_>>().join(", ")].into_iter().chain(colors);
        f.write_str(&parts.chain(verdict).chain(remark).collect::<Vec<_>>().join("; "))
    }
}

/// Reads phrases.
#[derive(Debug)]
pub struct PhraseReader<'a> {
    pub(crate) table: &'static PhraseTable,
    encoder: Option<&'a TextEncoder>,
    /// Names of classes with their vectors.
    anchors: Vec<(&'static str, ClassId, Vec<f32>)>,
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
        Ok(Self { table, encoder, anchors })
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
        let mut remarks = Vec::new();
        // A word that English has too may not be meant as that of another language.
        let mut is_certain = true;
        if let Some(class) = foreign_class(&rest) {
            is_certain = self.table.row(&rest).is_none();
            remarks.push(format!("took {rest:?} as {:?}", class.about().name));
            rest = class.about().name.to_owned();
        }
        let (nearest, remark) = match self.encoder {
            None => {
                let understood = self.table.understand(&rest)?;
                // A word that is left out, or was meant as it stands, may be what changes the meaning.
                is_certain &= understood.unknown.is_empty() && understood.corrected.is_empty();
                (self.nearest(&understood.row), understood.to_string())
            }
            Some(encoder) => self.encoded(encoder, &rest)?,
        };
        remarks.extend(Some(remark).filter(|remark| !remark.is_empty()));
        let verdict = match Verdict::of(&nearest) {
            Verdict::Sure if !is_certain => Verdict::NotSure,
            verdict => verdict,
        };
        let remark = remarks.join("; ");
        Ok(Reading { text: text.to_owned(), colors, nearest, verdict, remark })
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

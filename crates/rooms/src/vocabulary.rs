//! The text side of networks that are trained on synthetic rooms: vectors of known words.
//!
//! This is **not** a text encoder. It knows the names of the classes, their groups, basic colors
//! and common synonyms, and refuses every other word by naming those it knows. The vectors say
//! nothing about language; they are fixed directions that compose: what "red chair" means is the
//! sum of what "chair" and "red" mean.
//!
//! Each class, group and color has a concept, a unit vector nearly at right angles to all others.
//! The target of a class is its concept plus those of its groups, so that a query for a group finds
//! its members; the target of an object adds its color.

mod concepts;
mod words;

use crate::classes::{CLASSES, ClassId, Group};
use crate::material::ColorName;
use crate::{SyntheticObject, SyntheticRoom};
use concepts::{add_times, directions, unit_f32};
use scenesplat_scene::TextTable;
use words::{Concept, nearest, parse};

/// Smallest length of vectors: below, concepts cannot be told apart.
pub const MIN_DIM: usize = 32;

/// Largest length of vectors, many times that of any text encoder.
pub const MAX_DIM: usize = 1 << 14;

/// The row number of Gaussians without a target: floaters.
pub const NO_TARGET: u32 = u32::MAX;

/// Weight of a class's first group beside its own concept.
const FIRST_GROUP: f64 = 0.6;
/// Weight of each further group.
const OTHER_GROUP: f64 = 0.45;
/// Weight of the color in an object's target, and of a color word beside a noun.
const COLOR: f64 = 0.4;

/// Why a text has no vector.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum VocabularyError {
    /// A word that is not known.
    #[error(
        "the built-in vocabulary does not know {word:?}; the nearest words it knows are {} (it is a \
         list of words, not a text encoder: give text vectors of your own for other words)",
        nearest.join(", ")
    )]
    UnknownWord {
        /// The word.
        word: String,
        /// Known words that are spelt most alike, nearest first.
        nearest: Vec<&'static str>,
    },
    /// A text without any word.
    #[error("the query {text:?} has no word; say what to look for, such as \"red chair\"")]
    NoWord {
        /// The text.
        text: String,
    },
    /// Vectors too short to tell concepts apart, or longer than anything can use.
    #[error("vectors of length {dim} are not possible; use {MIN_DIM} to {MAX_DIM}")]
    Dim {
        /// The length asked for.
        dim: usize,
    },
}

/// What a text names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Named {
    /// Of each noun its classes: one, or the members of a group.
    pub nouns: Vec<Vec<ClassId>>,
    /// The colors, each once.
    pub colors: Vec<ColorName>,
}

impl Named {
    /// The classes that are meant, each once: those with names of their own, or without any the members of the groups.
    /// "Kitchen lamp" means lamps; the group only says which.
    pub fn classes(&self) -> Vec<ClassId> {
        let own = self.nouns.iter().filter(|noun| noun.len() == 1);
        let own: Vec<ClassId> = own.flatten().copied().collect();
        let mut all = if own.is_empty() { self.nouns.concat() } else { own };
        all.sort_unstable();
        all.dedup();
        all
    }
}

/// What every Gaussian of a room should be like.
#[derive(Debug, Clone, PartialEq)]
pub struct Targets {
    /// Unit vectors, each once. `[R, dim]`
    pub table: Vec<f32>,
    /// Length of a vector.
    pub dim: usize,
    /// Row of the table for every Gaussian; [`NO_TARGET`] for floaters. `[N]`
    pub index: Vec<u32>,
}

/// The concepts of a text, at least one.
fn concepts_of(text: &str) -> Result<Vec<Concept>, VocabularyError> {
    let found = parse(text).map_err(|word| {
        let nearest = nearest(&word);
        VocabularyError::UnknownWord { word, nearest }
    })?;
    if found.is_empty() {
        return Err(VocabularyError::NoWord { text: text.to_owned() });
    }
    Ok(found)
}

/// Vectors of the known words.
///
/// ```
/// use scenesplat_rooms::{ClassId, ColorName, Vocabulary};
///
/// let vocabulary = Vocabulary::new(64)?;
/// let query = vocabulary.embed("red chairs")?;
/// let score = |target: Vec<f32>| query.iter().zip(target).map(|(q, t)| q * t).sum::<f32>();
/// let red = score(vocabulary.object_target(ClassId::Chair, ColorName::Red));
/// let blue = score(vocabulary.object_target(ClassId::Chair, ColorName::Blue));
/// let table = score(vocabulary.object_target(ClassId::Table, ColorName::Red));
/// assert!(red > blue && blue > table);
/// # Ok::<(), scenesplat_rooms::vocabulary::VocabularyError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Vocabulary {
    dim: usize,
    /// Unit vectors of classes, then groups, then colors.
    concepts: Vec<Vec<f64>>,
}

impl Vocabulary {
    /// The vocabulary with vectors of length `dim`; the same on any machine.
    ///
    /// # Errors
    /// If `dim` is not in [`MIN_DIM`] to [`MAX_DIM`].
    pub fn new(dim: usize) -> Result<Self, VocabularyError> {
        if !(MIN_DIM..=MAX_DIM).contains(&dim) {
            return Err(VocabularyError::Dim { dim });
        }
        let count = CLASSES.len() + Group::ALL.len() + ColorName::ALL.len();
        Ok(Self { dim, concepts: directions(count, dim) })
    }

    /// Length of the vectors.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// The unit vector of a text such as `"red chair"`, `"furniture"`, `"couches"`.
    ///
    /// Case, punctuation, articles and plurals do not matter.
    ///
    /// # Errors
    /// If a word is not known or there is none.
    pub fn embed(&self, text: &str) -> Result<Vec<f32>, VocabularyError> {
        Ok(self.join(&concepts_of(text)?))
    }

    fn empty_table(&self) -> TextTable {
        TextTable { names: Vec::new(), dim: self.dim, values: Vec::new() }
    }

    /// The unit vector of concepts together.
    fn join(&self, concepts: &[Concept]) -> Vec<f32> {
        let has_noun = concepts.iter().any(|c| !matches!(c, Concept::Color(_)));
        let mut sum = vec![0.0; self.dim];
        for concept in concepts {
            match *concept {
                Concept::Class(class) => add_times(&mut sum, &self.class_vector(class), 1.0),
                Concept::Group(group) => add_times(&mut sum, self.group(group), 1.0),
                Concept::Color(color) => {
                    let weight = if has_noun { COLOR } else { 1.0 };
                    add_times(&mut sum, self.color(color), weight);
                }
            }
        }
        unit_f32(&sum)
    }

    /// The names of the classes, then their synonyms, each with its class.
    pub fn class_phrases() -> impl Iterator<Item = (&'static str, ClassId)> {
        words::class_phrases()
    }

    /// The color words of a text, and the text without them.
    pub fn split_colors(text: &str) -> (Vec<ColorName>, String) {
        words::split_colors(text)
    }

    /// The nouns and colors of a text: "red chair" is one noun, "kitchen lamp" and "chair and table" are two.
    ///
    /// # Errors
    /// As [`embed`](Self::embed).
    pub fn named(text: &str) -> Result<Named, VocabularyError> {
        let (mut nouns, mut colors) = (Vec::new(), Vec::new());
        for concept in concepts_of(text)? {
            match concept {
                Concept::Class(class) => nouns.push(vec![class]),
                Concept::Group(group) => {
                    let is_member = |c: &ClassId| c.about().groups.contains(&group);
                    nouns.push(ClassId::ALL.iter().copied().filter(is_member).collect());
                }
                Concept::Color(color) => colors.push(color),
            }
        }
        Ok(Named { nouns, colors })
    }

    /// What a text has to beat where Gaussians are selected by it: the classes it does not mean, and,
    /// if it names a color, itself in every other color.
    ///
    /// # Errors
    /// As [`embed`](Self::embed).
    pub fn rivals(&self, text: &str) -> Result<TextTable, VocabularyError> {
        let (colors, nouns): (Vec<Concept>, Vec<Concept>) =
            concepts_of(text)?.into_iter().partition(|c| matches!(c, Concept::Color(_)));
        let meant = |class: ClassId| {
            nouns.iter().any(|concept| match concept {
                Concept::Group(group) => class.about().groups.contains(group),
                concept => *concept == Concept::Class(class),
            })
        };
        let mut table = self.empty_table();
        let mut push = |name: String, row: Vec<f32>| {
            table.names.push(name);
            table.values.extend(row);
        };
        if !nouns.is_empty() {
            for &class in ClassId::ALL.iter().filter(|&&class| !meant(class)) {
                push(class.about().name.to_owned(), self.class_target(class));
            }
        }
        if !colors.is_empty() {
            for other in ColorName::ALL {
                let color = Concept::Color(other);
                if !colors.contains(&color) {
                    let row = self.join(&[&nouns[..], &[color]].concat());
                    push(format!("in {}", other.word()), row);
                }
            }
        }
        Ok(table)
    }

    /// The members of the groups that a text names ("seat": chair, sofa, stool), in the colors that it
    /// names; without any row if it names no group.
    ///
    /// # Errors
    /// As [`embed`](Self::embed).
    pub fn members(&self, text: &str) -> Result<TextTable, VocabularyError> {
        let (colors, nouns): (Vec<Concept>, Vec<Concept>) =
            concepts_of(text)?.into_iter().partition(|c| matches!(c, Concept::Color(_)));
        let mut table = self.empty_table();
        // "kitchen chair" means chairs; the group only says which.
        if nouns.iter().any(|c| matches!(c, Concept::Class(_))) {
            return Ok(table);
        }
        for &class in ClassId::ALL {
            let groups = class.about().groups;
            if nouns.iter().any(|c| matches!(c, Concept::Group(g) if groups.contains(g))) {
                table.names.push(class.about().name.to_owned());
                table.values.extend(self.join(&[&[Concept::Class(class)], &colors[..]].concat()));
            }
        }
        Ok(table)
    }

    /// The unit target of a class: its concept and its groups'.
    pub fn class_target(&self, class: ClassId) -> Vec<f32> {
        unit_f32(&self.class_vector(class))
    }

    /// The unit target of an object: its class, its groups and its color.
    pub fn object_target(&self, class: ClassId, color: ColorName) -> Vec<f32> {
        let mut sum = self.class_vector(class);
        add_times(&mut sum, self.color(color), COLOR);
        unit_f32(&sum)
    }

    /// The targets of all classes with their names, in the order of [`CLASSES`].
    pub fn class_table(&self) -> TextTable {
        TextTable {
            names: CLASSES.iter().map(|c| c.name.to_owned()).collect(),
            dim: self.dim,
            values: ClassId::ALL.iter().flat_map(|&c| self.class_target(c)).collect(),
        }
    }

    /// Targets of a room's Gaussians: class, groups and color of the object that each is part of.
    pub fn targets(&self, room: &SyntheticRoom) -> Targets {
        self.targets_by(room, |o| Some((o.class?, Some(o.color))))
    }

    /// As [`targets`](Self::targets), without colors: one row per class that is there.
    pub fn class_targets(&self, room: &SyntheticRoom) -> Targets {
        self.targets_by(room, |o| Some((o.class?, None)))
    }

    fn targets_by(
        &self,
        room: &SyntheticRoom,
        key: impl Fn(&SyntheticObject) -> Option<(ClassId, Option<ColorName>)>,
    ) -> Targets {
        let keys: Vec<_> = room.objects.iter().map(key).collect();
        let mut rows: Vec<_> = keys.iter().copied().flatten().collect();
        rows.sort_unstable();
        rows.dedup();
        let target = |&(class, color): &(ClassId, Option<ColorName>)| match color {
            Some(color) => self.object_target(class, color),
            None => self.class_target(class),
        };
        let table = rows.iter().flat_map(target).collect();
        // Every key is among the rows; objects without a class have none.
        let row = |key: &(ClassId, Option<ColorName>)| rows.binary_search(key).ok();
        let row_of_object: Vec<u32> = (keys.iter())
            .map(|key| key.as_ref().and_then(row).map_or(NO_TARGET, |row| row as u32))
            .collect();
        let instance = room.scene.instance.as_deref().unwrap_or(&[]);
        let row = |&i: &i32| {
            usize::try_from(i).ok().and_then(|i| row_of_object.get(i).copied()).unwrap_or(NO_TARGET)
        };
        Targets { table, dim: self.dim, index: instance.iter().map(row).collect() }
    }

    fn class_vector(&self, class: ClassId) -> Vec<f64> {
        let mut sum = self.concepts[class.index()].clone();
        for (i, &group) in class.about().groups.iter().enumerate() {
            add_times(&mut sum, self.group(group), if i == 0 { FIRST_GROUP } else { OTHER_GROUP });
        }
        sum
    }

    fn group(&self, group: Group) -> &[f64] {
        &self.concepts[CLASSES.len() + group as usize]
    }

    fn color(&self, color: ColorName) -> &[f64] {
        &self.concepts[CLASSES.len() + Group::ALL.len() + color as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SyntheticRoomSettings, generate};

    fn dot(a: &[f32], b: &[f32]) -> f64 {
        a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
    }

    /// Lowest score of those that should come first, highest of the others.
    fn margin(scores: &[(f64, bool)]) -> f64 {
        let low = scores.iter().filter(|s| s.1).map(|s| s.0).fold(f64::INFINITY, f64::min);
        low - scores.iter().filter(|s| !s.1).map(|s| s.0).fold(f64::NEG_INFINITY, f64::max)
    }

    #[test]
    fn groups_rank_their_members_first() {
        for dim in [64, 128, 768] {
            let vocabulary = Vocabulary::new(dim).unwrap();
            for group in Group::ALL {
                let query = vocabulary.embed(words::group_word(group)).unwrap();
                let by_class: Vec<_> = (ClassId::ALL.iter())
                    .map(|&c| {
                        let is_in = c.about().groups.contains(&group);
                        (dot(&query, &vocabulary.class_target(c)), is_in)
                    })
                    .collect();
                assert!(margin(&by_class) > 0.1, "{dim} {group:?} {}", margin(&by_class));
                let by_object: Vec<_> = (ClassId::ALL.iter())
                    .flat_map(|&c| ColorName::ALL.map(|color| (c, color)))
                    .map(|(c, color)| {
                        let is_in = c.about().groups.contains(&group);
                        (dot(&query, &vocabulary.object_target(c, color)), is_in)
                    })
                    .collect();
                assert!(margin(&by_object) > 0.05, "{dim} {group:?} {}", margin(&by_object));
            }
        }
    }

    #[test]
    fn exactly_what_is_meant_beats_the_rivals() {
        let vocabulary = Vocabulary::new(96).unwrap();
        let selects = |text: &str, class: ClassId, color: ColorName| {
            let target = vocabulary.object_target(class, color);
            let score = dot(&vocabulary.embed(text).unwrap(), &target);
            let rivals = vocabulary.rivals(text).unwrap();
            rivals.values.chunks_exact(96).all(|row| score > dot(row, &target))
        };
        for &class in ClassId::ALL {
            for color in ColorName::ALL {
                assert_eq!(
                    selects("red chair", class, color),
                    class == ClassId::Chair && color == ColorName::Red,
                    "{class:?} {color:?}"
                );
                assert_eq!(selects("sofas", class, color), class == ClassId::Sofa, "{class:?}");
                let furniture = class.about().groups.contains(&Group::Furniture);
                assert_eq!(selects("furniture", class, color), furniture, "{class:?} {color:?}");
            }
        }
        assert!(vocabulary.rivals("chiar").is_err());
    }

    #[test]
    fn nouns_are_told_from_colors() {
        let red_chair = Named { nouns: vec![vec![ClassId::Chair]], colors: vec![ColorName::Red] };
        assert_eq!(Vocabulary::named("the Red chairs"), Ok(red_chair));
        let seats = vec![ClassId::Chair, ClassId::Stool, ClassId::Sofa];
        assert_eq!(Vocabulary::named("seats").unwrap().nouns, [seats]);
        let classes = |text: &str| Vocabulary::named(text).unwrap().classes();
        assert_eq!(classes("box of books"), [ClassId::Book, ClassId::Box]);
        assert_eq!(classes("kitchen lamp"), [ClassId::Lamp]);
        assert_eq!(classes("red"), []);
        assert!(Vocabulary::named("chiar").is_err() && Vocabulary::named("the").is_err());
    }

    #[test]
    fn a_color_and_a_noun_rank_in_three_steps() {
        for dim in [MIN_DIM, 64, 256] {
            let vocabulary = Vocabulary::new(dim).unwrap();
            for class in ClassId::ALL {
                for color in ColorName::ALL {
                    let text = format!("a {} {}", color.word(), class.about().name);
                    let query = vocabulary.embed(&text).unwrap();
                    let score = |c, k| dot(&query, &vocabulary.object_target(c, k));
                    let right = score(*class, color);
                    let others = ColorName::ALL.map(|k| (k, score(*class, k)));
                    let others = others.iter().filter(|(k, _)| *k != color).map(|(_, s)| *s);
                    let best = others.clone().fold(f64::NEG_INFINITY, f64::max);
                    let worst = others.fold(f64::INFINITY, f64::min);
                    assert!(right > best + 0.02, "{text}");
                    for other in ClassId::ALL.iter().filter(|c| *c != class) {
                        assert!(worst > score(*other, color) + 0.02, "{dim} {text} {other:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn each_class_is_nearest_to_its_own_target() {
        for dim in [MIN_DIM, 64] {
            let vocabulary = Vocabulary::new(dim).unwrap();
            let table = vocabulary.class_table();
            assert_eq!(table.len(), CLASSES.len());
            for (i, class) in ClassId::ALL.iter().enumerate() {
                let query = vocabulary.embed(class.about().name).unwrap();
                for j in 0..CLASSES.len() {
                    let score = dot(&query, table.row(j).unwrap());
                    assert!(if i == j { score > 0.9999 } else { score < 0.75 }, "{i} {j} {score}");
                }
            }
        }
    }

    #[test]
    fn plurals_synonyms_and_unknown_words() {
        let vocabulary = Vocabulary::new(64).unwrap();
        let same = |a: &str, b: &str| {
            assert_eq!(vocabulary.embed(a).unwrap(), vocabulary.embed(b).unwrap(), "{a} {b}");
        };
        same("Couches", "sofa");
        same("the red CHAIRS!", "red chair");
        same("bookcases", "bookshelf");
        same("shelves", "bookshelf");
        same("trash bin", "trash can");
        same("television", "tv");
        same("a seat", "seats");
        same("mugs", "cup");
        same("grey gray", "grey");
        same("this is a kitchen counter", "kitchen cabinet");
        let error = vocabulary.embed("red chiar").unwrap_err();
        let VocabularyError::UnknownWord { word, nearest } = &error else { panic!("{error}") };
        assert_eq!((word.as_str(), nearest[0]), ("chiar", "chair"));
        assert!(error.to_string().contains("chair"));
        for text in ["", "  the !", "\u{0}"] {
            let error = vocabulary.embed(text).unwrap_err();
            assert!(matches!(error, VocabularyError::NoWord { .. }), "{error}");
        }
        let long = "x".repeat(100_000);
        assert!(vocabulary.embed(&long).is_err());
        assert_eq!(Vocabulary::new(8), Err(VocabularyError::Dim { dim: 8 }));
    }

    #[test]
    fn colors_are_split_off() {
        let split = Vocabulary::split_colors;
        assert_eq!(
            split("a RED, gray recliner"),
            (vec![ColorName::Red, ColorName::Grey], "a recliner".into())
        );
        assert_eq!(split("reddish chair"), (vec![], "reddish chair".into()));
        assert_eq!(split("red red"), (vec![ColorName::Red], String::new()));
        let phrases: Vec<_> = Vocabulary::class_phrases().collect();
        assert_eq!(phrases[0], ("wall", ClassId::Wall));
        assert!(phrases.len() > CLASSES.len() && phrases.contains(&("couch", ClassId::Sofa)));
    }

    #[test]
    fn every_scannet_name_of_a_class_is_known() {
        let vocabulary = Vocabulary::new(64).unwrap();
        for class in CLASSES {
            let query = vocabulary.embed(class.scannet200_name).unwrap();
            assert_eq!(query, vocabulary.embed(class.name).unwrap(), "{}", class.scannet200_name);
        }
    }

    #[test]
    fn targets_are_shared_rows() {
        let settings = SyntheticRoomSettings { num_gaussians: Some(4000), ..Default::default() };
        let room = generate(&settings).unwrap();
        let vocabulary = Vocabulary::new(64).unwrap();
        let segment = room.scene.segment.as_deref().unwrap();
        let instance = room.scene.instance.as_deref().unwrap();
        for (targets, by_color) in
            [(vocabulary.targets(&room), true), (vocabulary.class_targets(&room), false)]
        {
            assert_eq!(targets.index.len(), 4000);
            assert!(targets.table.len() <= 64 * room.objects.len());
            for (i, &row) in targets.index.iter().enumerate() {
                if segment[i] < 0 {
                    assert_eq!(row, NO_TARGET);
                    continue;
                }
                let found = &targets.table[row as usize * 64..][..64];
                let class = ClassId::ALL[segment[i] as usize];
                let color = room.objects[instance[i] as usize].color;
                let expected = match by_color {
                    true => vocabulary.object_target(class, color),
                    false => vocabulary.class_target(class),
                };
                assert_eq!(found, expected);
            }
        }
    }
}

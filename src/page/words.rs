//! What the page knows of words: phrases with the classes that they are near to, groups, colors.

use super::PageError;
use rayon::prelude::*;
use scenesplat_rooms::Group;
use scenesplat_rooms::{CLASSES, ColorName, Vocabulary};
use scenesplat_scene::Asset;
use scenesplat_text::{PhraseTable, foreign_names, is_other_thing, purposes};
use serde_json::{Value, json};

/// Classes that are noted of a phrase.
const NEAR: usize = 4;
/// A class has one byte, and 0 is none.
const MOST_CLASSES: usize = 255;

/// `near` of the network's own classes, where the vectors of the phrases are not there: in a browser.
static NEAR_CLASSES: Asset = Asset::new("classes near phrases", None);

/// What a browser's library has to be given before it packs a page.
pub fn near_classes() -> &'static Asset {
    &NEAR_CLASSES
}

/// What [`near_classes`] is given.
///
/// # Errors
/// If the phrase table is broken.
pub fn classes_near_phrases() -> Result<Vec<u8>, PageError> {
    let table = PhraseTable::embedded()?;
    let mut near = near_of(CLASSES.len(), &class_anchors(table))?;
    // A kettle is like a stove in words alone.
    for (phrase, near) in table.phrases().iter().zip(near.chunks_exact_mut(2 * NEAR)) {
        if is_other_thing(phrase) {
            near.fill(0);
        }
    }
    Ok(near)
}

/// Names and synonyms of the vocabulary with their classes.
fn class_anchors(table: &PhraseTable) -> Vec<(usize, Vec<f32>)> {
    Vocabulary::class_phrases()
        .filter_map(|(phrase, class)| Some((class.index(), table.row(phrase)?)))
        .collect()
}

/// Of each phrase of the table the classes that it is nearest to, see [`Words::near`].
fn near_of(classes: usize, anchors: &[(usize, Vec<f32>)]) -> Result<Vec<u8>, PageError> {
    let table = PhraseTable::embedded()?;
    let near = table.phrases().par_iter().map(|phrase| {
        let mut best = vec![0f32; classes];
        if let Some(row) = table.row(phrase) {
            for (class, anchor) in anchors {
                let dot: f32 = row.iter().zip(anchor).map(|(a, b)| a * b).sum();
                best[*class] = best[*class].max(dot);
            }
        }
        let mut order: Vec<usize> = (0..best.len()).collect();
        order.sort_by(|&a, &b| best[b].total_cmp(&best[a]).then(a.cmp(&b)));
        let mut out = [0u8; 2 * NEAR];
        for (place, &class) in order.iter().take(NEAR).enumerate().filter(|(_, c)| best[**c] > 0.0)
        {
            out[2 * place] = class as u8 + 1;
            out[2 * place + 1] = (best[class].min(1.0) * 255.0).round() as u8;
        }
        out
    });
    Ok(near.collect::<Vec<_>>().into_iter().flatten().collect())
}

/// Words of a page.
#[derive(Default)]
pub(super) struct Words {
    /// One a line.
    pub(super) phrases: &'static str,
    /// Of each phrase four times: class + 1, similarity · 255.
    pub(super) near: Vec<u8>,
    /// Name and members of each group of classes, and what each group or class is for.
    pub(super) groups: Vec<Value>,
    /// Words for colors that can stand before a class.
    pub(super) colors: Vec<&'static str>,
    /// Articles, and names with their classes, in German and French.
    pub(super) foreign: (Vec<&'static str>, Vec<(String, usize)>),
}

impl Words {
    /// Of these classes; without any, or with too many for a byte, no phrase.
    pub(super) fn of(names: &[String], vocabulary: Option<&Vocabulary>) -> Result<Self, PageError> {
        if names.is_empty() || names.len() > MOST_CLASSES {
            return Ok(Self::default());
        }
        let near = match (vocabulary.is_some(), NEAR_CLASSES.bytes()) {
            (true, Ok(known)) => known.to_vec(),
            (true, Err(_)) => classes_near_phrases()?,
            (false, _) => {
                let table = PhraseTable::embedded()?;
                // A name of unknown words is near to nothing.
                let anchor = |name: &String| table.understand(name).ok().map(|u| u.row);
                let anchors = names.iter().enumerate();
                let anchors: Vec<_> =
                    anchors.filter_map(|(class, name)| Some((class, anchor(name)?))).collect();
                near_of(names.len(), &anchors)?
            }
        };
        let (mut groups, mut colors) = (Vec::new(), Vec::new());
        let mut foreign = Default::default();
        if vocabulary.is_some() {
            for group in Group::ALL {
                let members: Vec<usize> =
                    (0..CLASSES.len()).filter(|&c| CLASSES[c].groups.contains(&group)).collect();
                groups.push(
                    json!({ "name": format!("{group:?}").to_lowercase(), "members": members }),
                );
            }
            for (text, patterns) in purposes() {
                // An empty text: no class serves these.
                let members: Vec<usize> = match Vocabulary::named(text) {
                    Ok(named) => named.classes().into_iter().map(|class| class.index()).collect(),
                    Err(_) => Vec::new(),
                };
                groups.push(json!({ "name": text, "members": members, "purposes": patterns }));
            }
            colors = ColorName::ALL.iter().map(|c| c.word()).collect();
            let (articles, named) = foreign_names();
            let named = named.iter().map(|(name, class)| (name.clone(), class.index()));
            foreign = (articles.to_vec(), named.collect());
        }
        Ok(Self { phrases: PhraseTable::embedded_phrases(), near, groups, colors, foreign })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_other_languages_have_the_number_of_their_class() {
        let names: Vec<String> = CLASSES.iter().map(|c| c.name.to_owned()).collect();
        let words = Words::of(&names, Some(&Vocabulary::new(64).unwrap())).unwrap();
        for (name, class) in [("stühle", "chair"), ("stuehle", "chair"), ("fenetre", "window")] {
            let found = words.foreign.1.iter().find(|(own, _)| own == name).unwrap();
            assert_eq!(names[found.1], class, "{name}");
        }
        assert!(words.foreign.0.contains(&"der"));
        let sit = words
            .groups
            .iter()
            .find(|g| g["purposes"][0].as_str().is_some_and(|p| p.starts_with("sit")));
        let sit = sit.unwrap()["members"].as_array().unwrap().iter();
        let seats: Vec<&str> = sit.map(|m| names[m.as_u64().unwrap() as usize].as_str()).collect();
        assert_eq!(seats, ["chair", "stool", "sofa"]);
        let kettle = words.phrases.lines().position(|phrase| phrase == "kettle").unwrap();
        assert_eq!(words.near[2 * NEAR * kettle..][..2 * NEAR], [0; 2 * NEAR]);
        // Classes of somebody else have no names but their own.
        let other = Words::of(&names, None).unwrap();
        assert!(other.foreign.1.is_empty());
    }
}

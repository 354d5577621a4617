//! The objects that a phrase means.

use super::phrase::{ask_error, phrase_error, relations, tell_denied, tell_taken};
use crate::error::{WrongUse, refuse};
use crate::session::Session;
use anyhow::Result;
use scenesplat::objects::Catalogue;
use scenesplat::objects::relations::related;
use scenesplat::phrases::{Phrase, PhraseReader, Placed, named_labels, shortened};
use scenesplat::rooms::{CLASSES, ClassId, Vocabulary};
use scenesplat::scene::label_set::nearest_names;
use scenesplat::scene::printable_text;

/// Class names that a message lists.
const MOST_LISTED: usize = 60;

/// The objects of a scene, asked for by phrases.
pub struct Asking<'a> {
    /// Says and notes how phrases are read.
    pub session: &'a Session<'a>,
    /// The objects.
    pub found: &'a Catalogue,
    /// Names of all labels that they could have.
    pub labels: &'a [String],
}

impl Asking<'_> {
    /// Places in the catalogue of the objects that a phrase means, none if there are none; for a relation the best first.
    pub fn meant(&self, phrase: &str) -> Result<Vec<usize>> {
        match Phrase::parse(phrase, self.labels).map_err(phrase_error)? {
            Phrase::Plain => Ok(self.with_labels(&self.labels_of(phrase)?)),
            Phrase::Denied(denied) => {
                let left = denied.labels(self.labels).map_err(phrase_error)?;
                tell_denied(self.session, phrase, &left.reading, &left.denied);
                Ok(self.with_labels(&left.chosen))
            }
            Phrase::Placed(placed) => self.placed(&placed),
        }
    }

    fn placed(&self, placed: &Placed) -> Result<Vec<usize>> {
        let Placed { text, what, relation, to, .. } = placed;
        let Some(relation) = *relation else {
            refuse!(
                "{:?}: the boxes of objects do not tell {:?}; they tell {}",
                shortened(text),
                shortened(&placed.to_string()),
                relations()
            );
        };
        let what = what.as_deref().map(|what| self.labels_of(what)).transpose()?;
        let to = self.labels_of(to)?;
        let name = what.as_ref().map_or("anything".to_owned(), |what| self.names(what));
        let why =
            format!("{:?} is read as: {name} {relation} {}", shortened(text), self.names(&to));
        self.session.receipt.setting("relation", relation, &why);
        let is_what = |label| what.as_ref().is_none_or(|what| what.contains(&label));
        Ok(related(self.found, |o| is_what(o.label), relation, |o| to.contains(&o.label)))
    }

    /// The labels of a plain name: as it is, else, where the labels are those of the network inside the program, as `query`
    /// reads it.
    fn labels_of(&self, name: &str) -> Result<Vec<usize>> {
        if let Some(labels) = named_labels(name, self.labels) {
            return Ok(labels);
        }
        if !self.labels.iter().map(String::as_str).eq(CLASSES.iter().map(|class| class.name)) {
            return self.none(name);
        }
        let there = self.found.objects.iter().filter_map(|o| ClassId::ALL.get(o.label).copied());
        let reader = PhraseReader::new(None)?.among(&there.collect::<Vec<_>>());
        let known = reader.known(name).map_err(ask_error)?;
        let named = Vocabulary::named(&known.text)?;
        if !named.colors.is_empty() {
            refuse!(
                "{:?}: objects are not told by color; leave it out, or `query {:?}` selects its Gaussians",
                shortened(name),
                known.text
            );
        }
        if known.text != name {
            let how = (known.reading.as_ref(), known.remark.as_str());
            tell_taken(self.session, name, &known.text, how, "phrase table");
        }
        Ok(named.classes().into_iter().map(|class| class.index()).collect())
    }

    fn with_labels(&self, labels: &[usize]) -> Vec<usize> {
        let all = &self.found.objects;
        (0..all.len()).filter(|&i| labels.contains(&all[i].label)).collect()
    }

    fn names(&self, labels: &[usize]) -> String {
        let names: Vec<&str> = labels.iter().map(|&label| self.labels[label].as_str()).collect();
        names.join(", ")
    }

    /// No class has this name.
    fn none<T>(&self, name: &str) -> Result<T> {
        let near = nearest_names(self.labels, name, 1);
        let near = near.first().map_or(String::new(), |near| format!("did you mean {near:?}? "));
        let name = shortened(name);
        Err(WrongUse(format!("no object can be a {name:?}; {near}{}", self.there_are())).into())
    }

    /// The classes of the objects.
    pub fn there_are(&self) -> String {
        let mut known: Vec<&str> = self.found.objects.iter().map(|o| o.class.as_str()).collect();
        known.dedup();
        let all = known[..known.len().min(MOST_LISTED)].join(", ");
        format!("there are: {}", printable_text(&all))
    }
}

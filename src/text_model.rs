//! Models that read texts, told apart by what their folders hold.

use scenesplat_kernels::Precision;
use scenesplat_scene::input_file::read_text_file;
use scenesplat_scene::{SceneError, TextTable};
use scenesplat_text::{PhraseError, TextEncoder};
use scenesplat_vision::{SiglipTextEncoder, VisionError};
use std::path::Path;

/// What SigLIP reads a name in by default. The released text tables were made with it.
pub const TEMPLATE: &str = "this is a {}";

/// Where the name stands in a template.
const PLACE: &str = "{}";

/// A network that gives texts vectors.
#[derive(Debug)]
#[non_exhaustive]
pub enum TextModel {
    /// A sentence encoder: its vectors compare with each other.
    Sentence(Box<TextEncoder>),
    /// The text tower of SigLIP or SigLIP 2: its vectors compare with those of pictures, and of networks trained with them.
    Siglip(Box<SiglipTexts>),
}

/// SigLIP's text tower, with the sentences that it reads names in.
#[derive(Debug)]
pub struct SiglipTexts {
    encoder: SiglipTextEncoder,
    templates: Vec<String>,
}

/// Why a text model cannot be read, or cannot read a text.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TextModelError {
    /// A sentence encoder, or one of its phrases.
    #[error(transparent)]
    Phrase(#[from] PhraseError),
    /// A text tower, or one of its texts.
    #[error(transparent)]
    Vision(#[from] VisionError),
    /// A file that cannot be read, or vectors that are no table.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A name without a vector.
    #[error("text {name:?} {problem}")]
    Name {
        /// The name.
        name: String,
        /// Why it has none.
        problem: &'static str,
    },
    /// A template that no name can be written into, or that nothing reads.
    #[error("template {template:?} {problem}")]
    Template {
        /// The template.
        template: String,
        /// What is wrong with it, and what to do.
        problem: &'static str,
    },
}

/// Vectors of texts.
#[derive(Debug, Clone, PartialEq)]
pub struct TextVectors {
    /// Of unit length. `[texts, dim]`
    pub values: Vec<f32>,
    /// Length of a vector.
    pub dim: usize,
    /// Texts of which the model read only the beginning, by number.
    pub cut: Vec<usize>,
}

impl TextModel {
    /// Reads the folder of a sentence encoder ([`TextEncoder::open`]) or of SigLIP ([`SiglipTextEncoder::load`]); its
    /// `config.json` says which.
    ///
    /// `templates`: what SigLIP reads names in, with `{}` for the name; several are averaged; none is [`TEMPLATE`].
    ///
    /// # Errors
    /// If the folder is of no model that is known, or is damaged; if a template has no `{}`, or the model is a sentence
    /// encoder, which reads names as they are.
    pub fn open(folder: &Path, templates: &[String]) -> Result<Self, TextModelError> {
        let wrong = |template: &String, problem| {
            Err(TextModelError::Template { template: template.clone(), problem })
        };
        if !is_siglip(folder)? {
            if let Some(template) = templates.first() {
                return wrong(
                    template,
                    "is for SigLIP: a sentence encoder reads names as they are; leave it out",
                );
            }
            return Ok(Self::Sentence(Box::new(TextEncoder::open(folder)?)));
        }
        if let Some(template) = templates.iter().find(|t| !t.contains(PLACE)) {
            return wrong(template, "has no {} where the name is to stand, as in \"this is a {}\"");
        }
        let templates =
            if templates.is_empty() { vec![TEMPLATE.to_owned()] } else { templates.to_vec() };
        let encoder = SiglipTextEncoder::load(folder, Precision::F32)?;
        Ok(Self::Siglip(Box::new(SiglipTexts { encoder, templates })))
    }

    /// The vectors of names.
    ///
    /// # Errors
    /// If a name says nothing, or the weights give it no direction.
    pub fn encode(&self, names: &[String]) -> Result<TextVectors, TextModelError> {
        match self {
            Self::Siglip(texts) => texts.encode(names),
            Self::Sentence(encoder) => {
                let found = encoder.encode(names)?;
                let cut = found.truncated.iter().map(|cut| cut.phrase).collect();
                Ok(TextVectors { values: found.values, dim: found.dim, cut })
            }
        }
    }

    /// Names and their vectors, and which names were cut.
    ///
    /// # Errors
    /// As [`encode`](Self::encode).
    pub fn table(&self, names: Vec<String>) -> Result<(TextTable, Vec<usize>), TextModelError> {
        let TextVectors { values, dim, cut } = self.encode(&names)?;
        Ok((TextTable::from_rows(names, values, dim)?, cut))
    }
}

impl SiglipTexts {
    /// The vectors of names: each of unit length, the direction of the mean over all templates.
    ///
    /// # Errors
    /// If a name says nothing, or the weights give it no direction.
    pub fn encode(&self, names: &[String]) -> Result<TextVectors, TextModelError> {
        let dim = self.encoder.width();
        let wrong =
            |name: &String, problem| Err(TextModelError::Name { name: name.clone(), problem });
        let (mut values, mut cut) = (vec![0f32; names.len() * dim], Vec::new());
        for template in &self.templates {
            let texts: Vec<String> =
                names.iter().map(|name| template.replace(PLACE, name)).collect();
            for (i, name) in names.iter().enumerate() {
                if name.trim().is_empty() {
                    return wrong(name, "says nothing");
                }
                if self.encoder.is_cut(&texts[i])? && !cut.contains(&i) {
                    cut.push(i);
                }
            }
            let rows = self.encoder.encode(&texts)?;
            values.iter_mut().zip(rows).for_each(|(sum, v)| *sum += v);
        }
        // One template's rows have unit length to the bit that they were given.
        if self.templates.len() > 1 {
            for (row, name) in values.chunks_exact_mut(dim).zip(names) {
                let norm = row.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
                if !(norm > 0.0 && norm.is_finite()) {
                    return wrong(name, "has vectors in the templates that add up to nothing");
                }
                row.iter_mut().for_each(|v| *v = (f64::from(*v) / norm) as f32);
            }
        }
        Ok(TextVectors { values, dim, cut })
    }
}

/// Whether a folder holds SigLIP: its `config.json` says so, or, where it names no model, has a part for texts.
fn is_siglip(folder: &Path) -> Result<bool, TextModelError> {
    let path = folder.join("config.json");
    let text = read_text_file(&path)?;
    // What is no JSON is named by the reader of sentence encoders.
    let config: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    Ok(match config["model_type"].as_str() {
        Some(name) => name.starts_with("siglip"),
        None => config["text_config"].is_object(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenesplat_test_support::{SmallEncoder, small_siglip};

    fn names(list: &[&str]) -> Vec<String> {
        list.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn folders_are_told_apart_and_templates_are_for_siglip() {
        let (sentence, siglip) = (SmallEncoder::new(3).write(), small_siglip(24));
        assert!(matches!(TextModel::open(sentence.path(), &[]), Ok(TextModel::Sentence(_))));
        assert!(matches!(TextModel::open(siglip.path(), &[]), Ok(TextModel::Siglip(_))));
        let refused = |folder: &Path, template: &str| {
            TextModel::open(folder, &names(&[template])).unwrap_err().to_string()
        };
        assert!(refused(sentence.path(), "a {}").contains("sentence encoder"));
        assert!(refused(siglip.path(), "a chair").contains("has no {}"));
        // Without a name of the model its parts tell.
        let path = siglip.path().join("config.json");
        let config = std::fs::read_to_string(&path).unwrap();
        let mut config: serde_json::Value = serde_json::from_str(&config).unwrap();
        config.as_object_mut().unwrap().remove("model_type");
        std::fs::write(&path, config.to_string()).unwrap();
        assert!(matches!(TextModel::open(siglip.path(), &[]), Ok(TextModel::Siglip(_))));
        std::fs::remove_file(&path).unwrap();
        let error = TextModel::open(siglip.path(), &[]).unwrap_err().to_string();
        assert!(error.contains("config.json"), "{error}");
    }

    #[test]
    fn names_are_read_in_their_templates_and_averaged() {
        let folder = small_siglip(24);
        let tower = SiglipTextEncoder::load(folder.path(), Precision::F32).unwrap();
        let open = |templates: &[&str]| TextModel::open(folder.path(), &names(templates)).unwrap();
        let all = names(&["chair", "red chair"]);
        let found = open(&[]).encode(&all).unwrap();
        let texts = ["this is a chair", "this is a red chair"];
        assert_eq!(found.values, tower.encode(&texts).unwrap(), "the bits of the tower");
        assert!(found.dim == tower.width() && found.cut.is_empty());
        let both = open(&["{}", "this is a {}"]).encode(&all).unwrap();
        let bare = tower.encode(&["chair", "red chair"]).unwrap();
        for (row, (a, b)) in bare.chunks(found.dim).zip(found.values.chunks(found.dim)).enumerate()
        {
            let mean: Vec<f64> =
                a.iter().zip(b).map(|(a, b)| (f64::from(*a) + f64::from(*b)) / 2.0).collect();
            let norm = mean.iter().map(|v| v * v).sum::<f64>().sqrt();
            for (got, want) in both.values[row * found.dim..].iter().zip(&mean) {
                assert!((f64::from(*got) - want / norm).abs() < 1e-6);
            }
        }
        let long = names(&[&"chair ".repeat(80), "chair"]);
        assert_eq!(open(&[]).encode(&long).unwrap().cut, [0]);
        assert!(open(&[]).encode(&names(&[" "])).is_err());
        let (table, _) = open(&[]).table(all.clone()).unwrap();
        assert_eq!((table.names, table.dim), (all, found.dim));
    }
}

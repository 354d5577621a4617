//! The labels that a network learns from: what `collect-labels --teacher` saw, or a class for each row.

use super::error::AdaptError;
use crate::evaluation::classes_of_labels;
use crate::lifted::LiftedFiles;
use crate::taught::{TEXTS, TaughtError, classes_of_names, taught_labels};
use scenesplat_scene::formats::npy::NpyFile;
use scenesplat_scene::label_set::read_names;
use scenesplat_scene::{ClassMap, LoadedScene};
use std::path::{Path, PathBuf};

/// Labels in a folder.
const LABELS: &str = "labels.npy";
/// Beside labels: the names of their ids.
const NAMES: &str = "classes.json";
/// The id that stands for no label in files of bytes.
const NONE: i64 = 255;

/// Where labels are, and what their ids stand for.
#[derive(Debug, Clone, Copy)]
pub struct LabelFiles<'a> {
    /// A folder that `collect-labels --teacher` wrote, a folder with `labels.npy`, or such a file.
    pub path: &'a Path,
    /// Names of the ids of a file; without it those of `classes.json` beside it, else ids are the network's classes.
    pub names: Option<&'a [String]>,
    /// Which class each of these names means; without it the class of that name, or that a phrase surely means.
    pub map: Option<&'a ClassMap>,
}

/// Labels of a scene's Gaussians.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnLabels {
    /// The class of each, −1 for none. `[N]`
    pub labels: Vec<i32>,
    /// Names that are no class, with the number of rows that have them, most first.
    pub unused: Vec<(String, usize)>,
    /// The files that were read.
    pub files: Vec<PathBuf>,
}

/// The class of the built-in vocabulary's `classes` that each name means, −1 for none: by a map, or else the class of that name, or
/// that its phrase surely means.
///
/// # Errors
/// If the map names what there is not.
pub fn class_of_names(
    names: &[String],
    map: Option<&ClassMap>,
    classes: &[String],
) -> Result<Vec<i32>, AdaptError> {
    if let Some(map) = map {
        return Ok(classes_of_labels(names, Some(map), classes)?);
    }
    let found = classes_of_names(names, classes, true)?;
    Ok(found.into_iter().map(|class| class.map_or(-1, |class| class as i32)).collect())
}

impl LabelFiles<'_> {
    /// Whether these are labels that `collect-labels --teacher` wrote, which name their classes themselves.
    pub fn are_collected(&self) -> bool {
        self.path.join(TEXTS).is_file()
    }

    /// Reads the labels of a scene as some of the built-in vocabulary's `classes`.
    ///
    /// # Errors
    /// If a file is missing or damaged, is of another scene, or an id stands for nothing.
    pub fn read(&self, classes: &[String], scene: &LoadedScene) -> Result<OwnLabels, AdaptError> {
        let (rows, unused, files) = match (self.path.is_dir(), self.are_collected()) {
            (true, true) if self.names.is_some() || self.map.is_some() => {
                let problem = format!("has the names of its labels in {TEXTS}");
                return Err(self.bad(self.path, problem, "leave out other names and maps"));
            }
            (true, true) => {
                let found = taught_labels(self.path, classes, true)?;
                let mut files = LiftedFiles::of(self.path).map_err(TaughtError::from)?.paths();
                files.extend([TEXTS, "confidence.npy"].map(|f| self.path.join(f)));
                (found.labels, found.unused, files)
            }
            (true, false) if !self.path.join(LABELS).is_file() => {
                let problem = format!("holds neither {TEXTS} nor {LABELS}");
                let help =
                    "give the folder that collect-labels --teacher wrote, or a file of labels";
                return Err(self.bad(self.path, problem, help));
            }
            (true, false) => self.of_file(&self.path.join(LABELS), classes)?,
            (false, _) => self.of_file(self.path, classes)?,
        };
        let labels = self.of_gaussians(&rows, scene)?;
        Ok(OwnLabels { labels, unused, files })
    }

    fn bad(&self, path: &Path, problem: String, help: &str) -> AdaptError {
        AdaptError::Labels { path: path.to_owned(), problem, help: help.to_owned() }
    }

    /// Labels of the rows of the scene's file, from a label for each or for each that was kept.
    fn of_gaussians(&self, rows: &[i32], scene: &LoadedScene) -> Result<Vec<i32>, AdaptError> {
        let kept = scene.kept_rows.as_deref();
        match kept {
            _ if rows.len() == scene.scene.len() => Ok(rows.to_vec()),
            Some(kept) if rows.len() == scene.source_rows() => {
                Ok(kept.iter().map(|row| rows[*row as usize]).collect())
            }
            _ => {
                let problem = format!("has {} rows, the scene {}", rows.len(), scene.source_rows());
                Err(self.bad(self.path, problem, "give labels that were made of this scene"))
            }
        }
    }

    /// Classes by the ids of a file, with the names that are none.
    #[allow(clippy::type_complexity)]
    fn of_file(
        &self,
        path: &Path,
        classes: &[String],
    ) -> Result<(Vec<i32>, Vec<(String, usize)>, Vec<PathBuf>), AdaptError> {
        let file = NpyFile::open(path)?;
        if file.shape().len() != 1 {
            let problem = format!("has shape {:?}, not [Gaussians]", file.shape());
            return Err(self.bad(path, problem, "give one class id a Gaussian"));
        }
        let beside = path.with_file_name(NAMES);
        let mut files = vec![path.to_owned()];
        let names = match self.names {
            Some(names) => names.to_vec(),
            None if beside.is_file() => {
                files.push(beside.clone());
                read_names(&beside)?
            }
            None => classes.to_vec(),
        };
        let class_of = class_of_names(&names, self.map, classes)?;
        let (mut rows, mut counts) = (Vec::with_capacity(file.len()), vec![0; names.len()]);
        for (row, id) in file.read_i64()?.into_iter().enumerate() {
            let name = usize::try_from(id).ok().filter(|id| *id < names.len());
            if name.is_none() && id >= 0 && id != NONE {
                let problem = format!("row {row} has id {id}, and there are {} names", names.len());
                return Err(self.bad(path, problem, "give the names that the ids stand for"));
            }
            if let Some(name) = name {
                counts[name] += 1;
            }
            rows.push(name.map_or(-1, |name| class_of[name]));
        }
        let none = class_of.iter().zip(names).zip(counts);
        let mut unused: Vec<(String, usize)> = none
            .filter(|((class, _), count)| **class < 0 && *count > 0)
            .map(|((_, name), count)| (name, count))
            .collect();
        unused.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        Ok((rows, unused, files))
    }
}

//! The files of a folder and of the folders in it.

use super::names::without_ending;
use crate::SceneError;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Folders in folders that are looked into.
const DEPTH: usize = 4;

/// A file with one of the endings.
#[derive(Debug, Clone)]
pub(super) struct Listed {
    /// Folders from the searched one to it.
    pub(super) folders: Vec<String>,
    pub(super) name: String,
    /// Without the ending it was found by.
    pub(super) stem: String,
    /// Number of that ending.
    pub(super) ending: usize,
}

/// Files of some endings in a folder and the folders in it, by their names.
#[derive(Debug, Clone)]
pub struct FrameFiles {
    pub(super) folder: PathBuf,
    pub(super) files: Vec<Listed>,
    /// By name, by stem, and by the stem without a picture's ending.
    pub(super) by_name: [BTreeMap<String, Vec<usize>>; 3],
}

impl FrameFiles {
    /// Looks for files whose names end in one of `endings` (`.png`, `_s.npy`), small or capital letters; four folders
    /// deep.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn open(folder: &Path, endings: &[&str]) -> Result<Self, SceneError> {
        let mut files = Vec::new();
        list(folder, &[], endings, &mut files)?;
        files.sort_by(|a, b| (&a.folders, &a.name).cmp(&(&b.folders, &b.name)));
        let mut by_name: [BTreeMap<String, Vec<usize>>; 3] = Default::default();
        for (i, file) in files.iter().enumerate() {
            let keys = [&file.name, &file.stem, without_ending(&file.stem)];
            for (map, key) in by_name.iter_mut().zip(keys) {
                map.entry(key.to_owned()).or_default().push(i);
            }
        }
        Ok(Self { folder: folder.to_owned(), files, by_name })
    }

    /// Without the files in folders below, if there are others.
    #[must_use]
    pub fn at_top(mut self) -> Self {
        if self.files.iter().any(|file| file.folders.is_empty()) {
            // Sorted, so these are the first and keep their numbers.
            self.files.retain(|file| file.folders.is_empty());
            let count = self.files.len();
            let of_all = self.by_name.iter_mut().flat_map(BTreeMap::values_mut);
            of_all.for_each(|list| list.retain(|&i| i < count));
        }
        self
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Whether there is no file.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// Where a file is.
    pub fn path(&self, file: usize) -> PathBuf {
        let Listed { folders, name, .. } = &self.files[file];
        folders.iter().fold(self.folder.clone(), |path, part| path.join(part)).join(name)
    }

    /// Its folders below the searched one and its name without the ending it was found by, separated by `/`.
    pub fn stem(&self, file: usize) -> String {
        let Listed { folders, stem, .. } = &self.files[file];
        [folders.as_slice(), std::slice::from_ref(stem)].concat().join("/")
    }
}

/// Adds the files of a folder; what has a name that is no Unicode is no camera's.
fn list(
    folder: &Path,
    above: &[String],
    endings: &[&str],
    files: &mut Vec<Listed>,
) -> Result<(), SceneError> {
    let failed = || SceneError::io(folder, "cannot read the folder");
    for entry in std::fs::read_dir(folder).map_err(failed())? {
        let Ok(name) = entry.map_err(failed())?.file_name().into_string() else { continue };
        let path = folder.join(&name);
        if path.is_dir() {
            if above.len() < DEPTH && !name.starts_with('.') {
                list(&path, &[above, &[name]].concat(), endings, files)?;
            }
        } else if let Some((ending, stem)) = stem_of(&name, endings).filter(|_| path.is_file()) {
            files.push(Listed { folders: above.to_vec(), stem: stem.to_owned(), ending, name });
        }
    }
    Ok(())
}

/// Which ending a name has, and what is before it.
fn stem_of<'a>(name: &'a str, endings: &[&str]) -> Option<(usize, &'a str)> {
    endings.iter().enumerate().find_map(|(i, ending)| {
        let at = name.len().checked_sub(ending.len()).filter(|at| *at > 0)?;
        let end = name.get(at..)?;
        end.eq_ignore_ascii_case(ending).then(|| (i, &name[..at]))
    })
}

//! Models of real furniture, as Sweet Home 3D's libraries have them: names, sizes in centimeters, makers and
//! licenses in a properties file, shapes as OBJ with materials and textures.
//!
//! A model is decoded to points of its surface, once, see [`Catalogue`].

mod attribution;
mod cache;
mod entry;
mod mesh;
mod names;
mod package;
mod piece;
mod points;
mod properties;
mod seen;
mod split;
#[cfg(test)]
mod tests;
mod texture;

pub use entry::{Entry, Refused};
pub use names::Meaning;
pub(crate) use piece::Piece;
pub use split::FurnitureSplit;

pub use attribution::Attribution;
use attribution::License;
use cache::Cache;
use package::{PROPERTIES, Package, packages};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Why a catalogue cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}: {problem}; {mend}", path.display())]
pub struct CatalogueError {
    /// The file or folder.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: String,
    /// What to do.
    pub mend: String,
}

impl CatalogueError {
    fn new(path: &Path, problem: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { path: path.to_owned(), problem: problem.into(), mend: mend.into() }
    }
}

/// Libraries of furniture models.
///
/// Opening it reads the properties alone. Models are decoded when they are drawn, once each, and kept as
/// points (32 bytes each, up to 40,000 a model) within half a gigabyte; what is drawn again later is
/// decoded again, to the same bits.
#[derive(Debug)]
pub struct Catalogue {
    path: PathBuf,
    packages: Vec<Package>,
    licenses: BTreeMap<String, License>,
    entries: Vec<Entry>,
    held_out: Vec<bool>,
    refused: Vec<Refused>,
    cache: Cache,
}

impl Catalogue {
    /// Opens an archive, a folder of archives, or a folder of models.
    ///
    /// # Errors
    /// If there is none, or no model of it can be in a room.
    pub fn open(path: &Path) -> Result<Self, CatalogueError> {
        let packages = packages(path)?;
        let (mut entries, mut refused) = (Vec::new(), Vec::new());
        let mut licenses = BTreeMap::new();
        for package in &packages {
            let bytes = package.read(PROPERTIES).map_err(|problem| {
                let mend =
                    "a library needs this file: keys `id#1`, `name#1`, `model#1`, `width#1`, …";
                CatalogueError::new(&package.path, problem, mend)
            })?;
            let values = properties::parse(&bytes);
            let (found, bad) = entry::entries(&package.library, &values);
            entries.extend(found);
            refused.extend(bad);
            let text = package.read("LICENSE.TXT").ok();
            let text = text.map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
            licenses.insert(package.library.clone(), License::of(&values, text.as_deref()));
        }
        entries.sort_by(|a, b| (&a.library, &a.id).cmp(&(&b.library, &b.id)));
        if entries.is_empty() {
            let problem = format!("has no model of furniture ({} refused)", refused.len());
            return Err(CatalogueError::new(path, problem, "is it the right folder?"));
        }
        let held_out = split::held_out(&entries);
        let path = path.to_owned();
        let cache = Cache::default();
        Ok(Self { path, packages, licenses, entries, held_out, refused, cache })
    }

    /// As [`open`](Self::open), once per path: rooms share what is decoded.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn shared(path: &Path) -> Result<Arc<Self>, CatalogueError> {
        static OPENED: Mutex<BTreeMap<PathBuf, Arc<Catalogue>>> = Mutex::new(BTreeMap::new());
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = opened.get(path) {
            return Ok(Arc::clone(known));
        }
        let catalogue = Arc::new(Self::open(path)?);
        opened.insert(path.to_owned(), Arc::clone(&catalogue));
        Ok(catalogue)
    }

    /// The models that may be in rooms, by library and id.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Whether the model of this index is held out.
    pub fn is_held_out(&self, index: usize) -> bool {
        self.held_out[index]
    }

    /// Entries of the properties that make no sense.
    pub fn refused(&self) -> &[Refused] {
        &self.refused
    }

    /// Decodes every model once: those that cannot be used, with the reasons. Takes tens of seconds for
    /// hundreds of models.
    pub fn examine(&self) -> Vec<Refused> {
        let bad = self.entries.iter().enumerate().filter_map(|(index, entry)| {
            let problem = self.piece(index).err()?;
            let (library, id) = (entry.library.clone(), entry.id.clone());
            Some(Refused { library, id, problem })
        });
        let mut all = self.refused.clone();
        all.extend(bad);
        all
    }

    /// Who made the models of a part of it.
    pub fn attribution(&self, split: &FurnitureSplit) -> Attribution {
        Attribution::of(self, split)
    }

    /// That a part has models.
    ///
    /// # Errors
    /// If it names a library that is not there, or has no model.
    pub fn check(&self, split: &FurnitureSplit) -> Result<(), CatalogueError> {
        let libraries: Vec<&str> = self.licenses.keys().map(String::as_str).collect();
        if let Some(library) = split.library().filter(|library| !libraries.contains(library)) {
            let problem = format!("has no library {library:?}");
            let mend = format!("its libraries are {}", libraries.join(", "));
            return Err(CatalogueError::new(&self.path, problem, mend));
        }
        if self.drawn(split).next().is_none() {
            let problem = format!("has no model in {split}");
            return Err(CatalogueError::new(&self.path, problem, "choose another part"));
        }
        Ok(())
    }

    /// The models of a part that rooms may draw.
    pub(crate) fn drawn(&self, split: &FurnitureSplit) -> impl Iterator<Item = &Entry> {
        self.indices(split).map(|index| &self.entries[index])
    }

    /// As [`drawn`](Self::drawn), their indices.
    pub(crate) fn indices(&self, split: &FurnitureSplit) -> impl Iterator<Item = usize> {
        (0..self.entries.len()).filter(move |&index| {
            let entry = &self.entries[index];
            entry.meaning != Meaning::Outdoors && split.has(entry, self.held_out[index])
        })
    }

    /// The decoded model of an index, or why it cannot be used.
    pub(crate) fn piece(&self, index: usize) -> Result<Arc<Piece>, String> {
        let entry = &self.entries[index];
        self.cache.get(index, || {
            let package = self.packages.iter().find(|package| package.library == entry.library);
            Piece::read(entry, package.ok_or("its library is gone")?)
        })
    }

    fn license(&self, library: &str) -> License {
        self.licenses.get(library).cloned().unwrap_or_default()
    }
}

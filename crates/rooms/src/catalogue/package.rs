//! Where the files of a library are: a `.sh3f` archive, or a folder.

use super::CatalogueError;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use zip::ZipArchive;

/// The file that says what a library has.
pub(super) const PROPERTIES: &str = "PluginFurnitureCatalog.properties";

/// Most bytes of a file of a library.
const MAX_BYTES: u64 = 1 << 28;

#[derive(Debug)]
enum Files {
    /// One reader for all: an archive has one position.
    Archive(Mutex<ZipArchive<BufReader<File>>>),
    Folder,
}

/// The files of one library.
#[derive(Debug)]
pub(super) struct Package {
    /// File or folder name, without its ending.
    pub(super) library: String,
    pub(super) path: PathBuf,
    files: Files,
}

/// The libraries at a path: an archive, a folder with archives, or a folder of models; by name.
pub(super) fn packages(path: &Path) -> Result<Vec<Package>, CatalogueError> {
    let missing = |problem: String| CatalogueError::new(path, problem, MEND);
    let about = std::fs::metadata(path).map_err(|error| missing(error.to_string()))?;
    if about.is_file() {
        return Ok(vec![Package::archive(path)?]);
    }
    if path.join(PROPERTIES).is_file() {
        let files = Files::Folder;
        return Ok(vec![Package { library: stem(path), path: path.to_owned(), files }]);
    }
    let entries = std::fs::read_dir(path).map_err(|error| missing(error.to_string()))?;
    let mut archives = Vec::new();
    for entry in entries {
        let file = entry.map_err(|error| missing(error.to_string()))?.path();
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("sh3f")) {
            archives.push(file);
        }
    }
    archives.sort();
    if archives.is_empty() {
        let problem = format!("has no .sh3f archive and no {PROPERTIES}");
        return Err(missing(problem));
    }
    archives.iter().map(|file| Package::archive(file)).collect()
}

/// How to come by a catalogue.
const MEND: &str = "give a .sh3f archive, a folder of them or a folder of OBJ models with a properties file; \
    Debian's package sweethome3d-furniture has them: `apt-get download sweethome3d-furniture && dpkg-deb -x \
    sweethome3d-furniture_*.deb DIR`, then SCENESPLAT_FURNITURE=DIR/usr/share/sweethome3d/furniture";

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "models".to_owned(), |name| name.to_string_lossy().into_owned())
}

impl Package {
    fn archive(path: &Path) -> Result<Self, CatalogueError> {
        let bad = |error: String| CatalogueError::new(path, error, MEND);
        let file = File::open(path).map_err(|error| bad(error.to_string()))?;
        let archive = ZipArchive::new(BufReader::new(file))
            .map_err(|error| bad(format!("is no zip archive: {error}")))?;
        let files = Files::Archive(Mutex::new(archive));
        Ok(Self { library: stem(path), path: path.to_owned(), files })
    }

    /// The bytes of a file, named from the top of the library.
    pub(super) fn read(&self, name: &str) -> Result<Vec<u8>, String> {
        let name = normal(name).ok_or_else(|| format!("{name}: leads out of the library"))?;
        let fail = |error: &dyn std::fmt::Display| format!("{name}: {error}");
        let too_large = || format!("{name}: is larger than {MAX_BYTES} bytes");
        let mut bytes = Vec::new();
        match &self.files {
            Files::Archive(archive) => {
                let mut archive = archive.lock().unwrap_or_else(PoisonError::into_inner);
                let file = archive.by_name(&name).map_err(|error| fail(&error))?;
                // What the header says is not to be believed: the reader is bounded as well.
                let mut file = file.take(MAX_BYTES + 1);
                file.read_to_end(&mut bytes).map_err(|error| fail(&error))?;
            }
            Files::Folder => {
                let file = File::open(self.path.join(&name)).map_err(|error| fail(&error))?;
                let mut file = file.take(MAX_BYTES + 1);
                file.read_to_end(&mut bytes).map_err(|error| fail(&error))?;
            }
        }
        if bytes.len() as u64 > MAX_BYTES { Err(too_large()) } else { Ok(bytes) }
    }
}

/// A name with `/` between its parts, without `.`; `None` if `..` leads out of the library.
fn normal(name: &str) -> Option<String> {
    let mut parts: Vec<&str> = Vec::new();
    for part in name.split(['/', '\\']) {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop()?;
            }
            part => parts.push(part),
        }
    }
    (!parts.is_empty()).then(|| parts.join("/"))
}

/// The name of a file that another one mentions: in the same folder, whatever folder is said, since
/// materials name places on the computers of those who made them.
pub(super) fn beside(name: &str, mentioned: &str) -> String {
    let file = mentioned.rsplit(['/', '\\']).next().unwrap_or(mentioned).trim();
    match name.rfind('/') {
        Some(end) => format!("{}/{file}", &name[..end]),
        None => file.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_within_the_library() {
        assert_eq!(normal("/a/b/./c.obj").as_deref(), Some("a/b/c.obj"));
        assert_eq!(normal("a/../c.obj").as_deref(), Some("c.obj"));
        assert_eq!(normal("a/../../c.obj"), None);
        assert_eq!(normal("/"), None);
        assert_eq!(beside("/x/y/z.obj", "C:\\Users\\me\\wood 1.jpg"), "/x/y/wood 1.jpg");
        assert_eq!(beside("z.obj", "z.mtl"), "z.mtl");
    }
}

//! What a command reads and writes: nothing that it reads is replaced, and what it writes appears
//! together, when all of it is complete.

use crate::error::{WrongUse, refuse};
use anyhow::{Context, Result, bail};
use scenesplat::scene::atomic_file::check_replaceable;
use scenesplat::scene::{AtomicFile, FolderLock, StagedFolder};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The name of the receipt in an output folder.
const RECEIPT: &str = "receipt.json";

/// The files of one command.
///
/// Paths that users give are looked at before the work ([`claim`](Self::claim), [`reads`](Self::reads));
/// files of the output folder wait in it, other files beside their places, until
/// [`commit`](Self::commit). Dropped without that, nothing was written.
#[derive(Debug)]
pub struct Outputs {
    folder: PathBuf,
    inputs: RefCell<Vec<Input>>,
    claims: RefCell<Vec<Claim>>,
    staged: RefCell<Option<Staged>>,
    files: RefCell<Vec<AtomicFile>>,
}

#[derive(Debug)]
struct Input {
    path: PathBuf,
    place: Place,
}

#[derive(Debug)]
struct Claim {
    /// The flag, or what the file is.
    what: String,
    path: PathBuf,
    place: Place,
    /// Whether the user named the path; other names are those of the command.
    named: bool,
}

/// The output folder while the command runs.
#[derive(Debug)]
struct Staged {
    /// Folders in it; dropped first, as a folder goes only when it is empty.
    inner: BTreeMap<String, StagedFolder>,
    main: StagedFolder,
    _lock: FolderLock,
}

/// A file, however it is called.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Place {
    /// One that exists: links and hard links to it are the same.
    #[cfg(unix)]
    File { device: u64, inode: u64 },
    /// One that does not, or on a system that does not tell.
    Path(PathBuf),
}

impl Place {
    fn of(path: &Path) -> Self {
        #[cfg(unix)]
        if let Ok(about) = std::fs::metadata(path) {
            use std::os::unix::fs::MetadataExt;
            return Self::File { device: about.dev(), inode: about.ino() };
        }
        if let Ok(full) = path.canonicalize() {
            return Self::Path(full);
        }
        let folder = parent(path).canonicalize();
        match (folder, path.file_name()) {
            (Ok(folder), Some(name)) => Self::Path(folder.join(name)),
            _ => Self::Path(std::path::absolute(path).unwrap_or_else(|_| path.to_owned())),
        }
    }
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

impl Input {
    /// Whether that output is this file, or a file of this folder.
    fn has(&self, claim: &Claim) -> bool {
        if self.place == claim.place {
            return true;
        }
        // What a command calls its files is nothing that it reads from a folder; what a user names
        // may be.
        if !claim.named || !self.path.is_dir() || !claim.path.exists() {
            return false;
        }
        let inside = match (self.path.canonicalize(), claim.path.canonicalize()) {
            (Ok(folder), Ok(file)) => file.starts_with(folder),
            _ => false,
        };
        // A hard link is in no folder that its path tells.
        inside
            || std::fs::read_dir(&self.path)
                .is_ok_and(|list| list.flatten().any(|e| Place::of(&e.path()) == claim.place))
    }
}

impl Outputs {
    /// Of a command with that output folder.
    pub fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            inputs: RefCell::default(),
            claims: RefCell::default(),
            staged: RefCell::default(),
            files: RefCell::default(),
        }
    }

    /// Notes a file or folder that the command reads.
    ///
    /// # Errors
    /// If the command would also write it.
    pub fn reads(&self, path: &Path) -> Result<()> {
        let inputs = std::iter::once(path.to_owned()).chain(read_beside(path));
        for path in inputs {
            let input = Input { place: Place::of(&path), path };
            for claim in self.claims.borrow().iter() {
                check_apart(&input, claim)?;
            }
            self.inputs.borrow_mut().push(input);
        }
        Ok(())
    }

    /// As [`reads`](Self::reads), if there is such an input.
    ///
    /// # Errors
    /// As [`reads`](Self::reads).
    pub fn reads_any<'a>(&self, paths: impl IntoIterator<Item = Option<&'a Path>>) -> Result<()> {
        paths.into_iter().flatten().try_for_each(|path| self.reads(path))
    }

    /// Looks at a path that the user gave for an output: before the work, not after it.
    ///
    /// # Errors
    /// If it is something that must not be replaced: an input, another output, or no regular file
    /// ([`WrongUse`]); or if its folder is missing or takes no new files.
    pub fn claim(&self, what: &str, path: &Path) -> Result<()> {
        self.note(what, path, true)?;
        if parent(path).exists() || !self.will_hold(path) {
            AtomicFile::create(path).with_context(|| what.to_owned())?;
        }
        Ok(())
    }

    /// As [`claim`](Self::claim), if there is such an output.
    ///
    /// # Errors
    /// As [`claim`](Self::claim).
    pub fn claim_any(&self, what: &str, path: Option<&PathBuf>) -> Result<()> {
        path.map_or(Ok(()), |path| self.claim(what, path))
    }

    /// Whether it is in the output folder, which may be made later.
    fn will_hold(&self, path: &Path) -> bool {
        match (std::path::absolute(&self.folder), std::path::absolute(path)) {
            (Ok(folder), Ok(path)) => path.starts_with(folder),
            // Of a command without an output folder.
            _ => false,
        }
    }

    fn note(&self, what: &str, path: &Path, named: bool) -> Result<()> {
        check_replaceable(path).map_err(|e| WrongUse(format!("{what}: {e}")))?;
        let claim =
            Claim { what: what.to_owned(), path: path.to_owned(), place: Place::of(path), named };
        for input in self.inputs.borrow().iter() {
            check_apart(input, &claim)?;
        }
        let mut claims = self.claims.borrow_mut();
        let same = |c: &&Claim| c.place == claim.place && (c.named || claim.named);
        if let Some(other) = claims.iter().find(same) {
            if other.what == claim.what && other.path == claim.path {
                return Ok(());
            }
            refuse!("{what} {}: is also {}", path.display(), other.what);
        }
        claims.push(claim);
        Ok(())
    }

    /// Makes the output folder and keeps other runs out of it, for files of these names and a
    /// receipt.
    ///
    /// # Errors
    /// If another run is writing to it, it cannot be made, or a name is taken by an input or by what
    /// is no regular file.
    pub fn open_folder(&self, names: &[&str]) -> Result<()> {
        if self.staged.borrow().is_none() {
            let mut main = StagedFolder::create(&self.folder)?;
            let lock = FolderLock::acquire(&self.folder)?;
            main.remove_left_over();
            // Withdrawn first and put in place last.
            main.add(RECEIPT);
            let staged = Staged { main, inner: BTreeMap::new(), _lock: lock };
            *self.staged.borrow_mut() = Some(staged);
        }
        for name in names.iter().copied().chain([RECEIPT]) {
            let path = self.folder.join(name);
            let claimed = |c: &Claim| c.named && c.place == Place::of(&path);
            if name == RECEIPT && self.claims.borrow().iter().any(claimed) {
                // Asked for by its name too.
                continue;
            }
            self.note(&format!("{name} of --out {}", self.folder.display()), &path, false)?;
        }
        Ok(())
    }

    /// Where to write a file of the output folder; `name` may have one folder in it.
    ///
    /// # Errors
    /// As [`open_folder`](Self::open_folder).
    pub fn path(&self, name: &str) -> Result<PathBuf> {
        match name.rsplit_once('/') {
            None => {
                self.open_folder(&[name])?;
                self.with_staged(|staged| Ok(staged.main.add(name)))
            }
            Some((inner, file)) => {
                self.note(name, &self.folder.join(name), false)?;
                let folder = self.inner_folder(inner)?;
                Ok(folder.join(file))
            }
        }
    }

    /// Where to write files of a folder inside the output folder.
    ///
    /// # Errors
    /// As [`open_folder`](Self::open_folder).
    pub fn inner_folder(&self, name: &str) -> Result<PathBuf> {
        self.open_folder(&[])?;
        let folder = self.folder.join(name);
        self.with_staged(|staged| {
            if !staged.inner.contains_key(name) {
                staged.inner.insert(name.to_owned(), StagedFolder::create(&folder)?);
            }
            Ok(staged.inner.get(name).map_or(folder, |f| f.waiting().to_owned()))
        })
    }

    /// Where to write files of the output folder itself.
    ///
    /// # Errors
    /// As [`open_folder`](Self::open_folder).
    pub fn main_folder(&self) -> Result<PathBuf> {
        self.open_folder(&[])?;
        self.with_staged(|staged| Ok(staged.main.waiting().to_owned()))
    }

    fn with_staged<T>(&self, work: impl FnOnce(&mut Staged) -> Result<T>) -> Result<T> {
        match self.staged.borrow_mut().as_mut() {
            Some(staged) => work(staged),
            None => bail!("{}: the output folder is not open", self.folder.display()),
        }
    }

    /// Takes a file outside of the output folder, which was claimed.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn file(&self, path: &Path, bytes: &[u8]) -> Result<()> {
        let mut file = AtomicFile::create(path)?;
        file.write_all(bytes).with_context(|| format!("{}: cannot write", path.display()))?;
        file.sync()?;
        self.files.borrow_mut().push(file);
        Ok(())
    }

    /// As [`file`](Self::file), for writers that take a path: gives where to write.
    ///
    /// # Errors
    /// If its folder takes no new files.
    pub fn file_path(&self, path: &Path) -> Result<PathBuf> {
        let file = AtomicFile::create(path)?;
        let waiting = file.temporary().to_owned();
        self.files.borrow_mut().push(file);
        Ok(waiting)
    }

    /// The final name of a path that was given to write to.
    pub fn shown(&self, path: &Path) -> PathBuf {
        if let Some(file) = self.files.borrow().iter().find(|f| f.temporary() == path) {
            return file.target().to_owned();
        }
        let staged = self.staged.borrow();
        let folders = staged.iter().flat_map(|s| s.inner.values().chain([&s.main]));
        for folder in folders {
            if let Ok(name) = path.strip_prefix(folder.waiting()) {
                return folder.folder().join(name);
            }
        }
        path.to_owned()
    }

    /// Puts everything in place, the receipt last.
    ///
    /// `receipt`: what it says, and where else it goes.
    ///
    /// # Errors
    /// If something cannot be put in place; what was done then, the error says.
    pub fn commit(&self, receipt: Option<(&str, Option<&Path>)>) -> Result<()> {
        let staged = self.staged.borrow_mut().take();
        let files = std::mem::take(&mut *self.files.borrow_mut());
        let folders = staged.iter().map(|s| 1 + s.inner.len()).sum::<usize>();
        if folders + files.len() > 1 && staged.is_some() {
            // Whatever happens between the first and the last of them, no receipt says that what
            // lies there belongs together.
            withdraw(&self.folder.join(RECEIPT))?;
        }
        let mut beside = None;
        if let Some(mut staged) = staged {
            if let Some((text, elsewhere)) = receipt {
                staged.main.write(RECEIPT, text.as_bytes())?;
                let here = Place::of(&self.folder.join(RECEIPT));
                beside = elsewhere.filter(|path| Place::of(path) != here);
            }
            for (_, mut folder) in std::mem::take(&mut staged.inner) {
                folder.add_waiting()?;
                folder.commit::<&str>(&[])?;
            }
            for file in files {
                file.commit()?;
            }
            staged.main.add_waiting()?;
            staged.main.commit::<&str>(&[])?;
        } else {
            for file in files {
                file.commit()?;
            }
            beside = receipt.and_then(|(_, elsewhere)| elsewhere);
        }
        if let (Some(path), Some((text, _))) = (beside, receipt) {
            AtomicFile::write(path, text.as_bytes())?;
        }
        Ok(())
    }
}

/// What is read beside a file, if it is there: the parts of scenes of several files, the configuration of
/// weights, labels of a scene.
pub fn read_beside(path: &Path) -> Vec<PathBuf> {
    let mut inputs = Vec::new();
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if name.ends_with("meta.json") || name.ends_with(".gltf") {
        inputs.push(parent(path).to_owned());
    }
    if [".safetensors", ".pth", ".pt"].iter().any(|ending| name.ends_with(ending)) {
        inputs.push(parent(path).join("config.json"));
    }
    let mut labels = path.as_os_str().to_owned();
    labels.push(".labels.safetensors");
    inputs.push(labels.into());
    inputs
}

/// Removes a receipt that may be there.
pub fn withdraw(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(e).with_context(|| format!("{}: cannot withdraw the receipt", path.display()))
        }
        _ => Ok(()),
    }
}

fn check_apart(input: &Input, claim: &Claim) -> Result<()> {
    if !input.has(claim) {
        return Ok(());
    }
    let (read, write) = (input.path.display(), claim.path.display());
    let text = if claim.named {
        format!("{} {write}: would replace {read}, which this command reads", claim.what)
    } else {
        format!(
            "{}: would replace {read}, which this command reads; give another --out",
            claim.what
        )
    };
    Err(WrongUse(text).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn inputs_are_found_under_every_name() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("scene.ply"), "ply").unwrap();
        std::fs::hard_link(at("scene.ply"), at("hard.json")).unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink("scene.ply", at("soft.json")).unwrap();
        std::fs::create_dir(at("model")).unwrap();
        std::fs::write(at("model/config.json"), "{}").unwrap();
        let names =
            ["scene.ply", "hard.json", "soft.json", "model/config.json", "model/../hard.json"];
        for name in names {
            let outputs = Outputs::new(&at("out"));
            outputs.reads(&at("scene.ply")).unwrap();
            outputs.reads(&at("model")).unwrap();
            let error = outputs.claim("--json", &at(name)).unwrap_err();
            assert!(error.downcast_ref::<WrongUse>().is_some(), "{error}");
            assert!(error.to_string().contains("which this command reads"), "{error}");
            // In the other order too.
            let outputs = Outputs::new(&at("out"));
            outputs.claim("--json", &at(name)).unwrap();
            let later = outputs.reads(&at("scene.ply")).and_then(|()| outputs.reads(&at("model")));
            assert!(later.is_err(), "{name}");
        }
        let outputs = Outputs::new(&at("out"));
        outputs.reads(&at("model/model.safetensors")).unwrap();
        assert!(outputs.claim("--json", &at("model/config.json")).is_err(), "it is read too");
        outputs.reads(&at("scene.ply")).unwrap();
        outputs.claim("--json", &at("new.json")).unwrap();
        assert!(outputs.claim("--receipt", &at("new.json")).is_err(), "the same file twice");
        assert!(outputs.claim("--sheet", &at("none/a.png")).is_err(), "a missing folder");
    }

    #[test]
    fn everything_appears_together_or_not_at_all() {
        let dir = tempfile::tempdir().unwrap();
        let (out, json) = (dir.path().join("out"), dir.path().join("a.json"));
        let write = |outputs: &Outputs| {
            outputs.claim("--json", &json).unwrap();
            outputs.open_folder(&["labels.npy"]).unwrap();
            std::fs::write(outputs.path("labels.npy").unwrap(), "labels").unwrap();
            std::fs::write(outputs.path("depth/a.png").unwrap(), "depth").unwrap();
            outputs.file(&json, b"json").unwrap();
        };
        let outputs = Outputs::new(&out);
        write(&outputs);
        let shown = outputs.shown(&outputs.path("labels.npy").unwrap());
        assert_eq!(shown, out.join("labels.npy"));
        assert!(Outputs::new(&out).open_folder(&[]).is_err(), "it is locked");
        drop(outputs);
        assert!(names(dir.path()).is_empty(), "{:?}", names(dir.path()));

        let outputs = Outputs::new(&out);
        write(&outputs);
        outputs.commit(Some(("receipt", None))).unwrap();
        assert_eq!(names(dir.path()), ["a.json", "out"]);
        assert_eq!(names(&out), ["depth", "labels.npy", "receipt.json"]);
        assert_eq!(names(&out.join("depth")), ["a.png"]);
        assert_eq!(std::fs::read_to_string(out.join("receipt.json")).unwrap(), "receipt");
    }

    #[test]
    fn a_receipt_may_be_asked_for_where_it_is_anyway() {
        let dir = tempfile::tempdir().unwrap();
        let outputs = Outputs::new(dir.path());
        let receipt = dir.path().join("receipt.json");
        outputs.claim("--receipt", &receipt).unwrap();
        outputs.open_folder(&[]).unwrap();
        outputs.commit(Some(("text", Some(&receipt)))).unwrap();
        assert_eq!(names(dir.path()), ["receipt.json"]);
    }
}

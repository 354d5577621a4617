//! The one way in which files are written: beside their place, then renamed.
//!
//! [`AtomicFile`] is one file, [`StagedFolder`](crate::StagedFolder) are several that appear
//! together, [`WholeFolder`](crate::WholeFolder) is a folder with all that is in it. Whoever looks at the place sees the old content or the new, never a part of it, and a
//! write that fails changes nothing.

use crate::disk::{self, File};
use std::ffi::OsString;
use std::hash::{BuildHasher, RandomState};
use std::io::{ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Why something could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The system refused.
    #[error("{}: {action}", path.display())]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        #[source]
        source: std::io::Error,
    },
    /// The place is taken by something that a file must not replace.
    #[error("{}: is {kind}; only regular files are replaced", path.display())]
    NotAFile {
        /// Which place.
        path: PathBuf,
        /// What is there: "a folder", "a character device", "a named pipe", …
        kind: &'static str,
    },
    /// The path cannot stand for a file, such as `..` or a link that leads in a circle.
    #[error("{}: {problem}", path.display())]
    NoPlace {
        /// Which path.
        path: PathBuf,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// Another process is writing to the folder.
    #[error("{}: another run is writing to this folder", path.display())]
    Busy {
        /// Which folder.
        path: PathBuf,
    },
    /// Something went wrong while files of a folder were moved, and again while they were put back.
    #[error("{}: {problem} (what was there before is in {})", path.display(), aside.display())]
    Stranded {
        /// Which file.
        path: PathBuf,
        /// What happened.
        problem: String,
        /// The folder with the files of before.
        aside: PathBuf,
    },
}

impl WriteError {
    /// Turns an I/O error into a [`WriteError::Io`] for `path`; made for `map_err`.
    pub(crate) fn io(
        path: &Path,
        action: &'static str,
    ) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}

/// A file that appears under its name only when it is complete.
///
/// It is written beside its place, under a name that cannot be foreseen and that did not exist, and
/// renamed by [`commit`](Self::commit); dropped without that, it is deleted.
///
/// Only regular files are replaced: a folder, a device, a named pipe or a socket is refused, also
/// behind a link. A place that is a link to a file, or to nothing, stays a link: what it leads to is
/// replaced. Permissions of a replaced file are kept.
///
/// ```
/// use scenesplat_scene::AtomicFile;
/// use std::io::Write;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("labels.txt");
/// let mut file = AtomicFile::create(&path)?;
/// writeln!(file, "chair")?;
/// assert!(!path.exists());
/// file.commit()?;
/// assert_eq!(std::fs::read_to_string(&path)?, "chair\n");
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct AtomicFile {
    file: File,
    temporary: PathBuf,
    /// The name that was asked for.
    target: PathBuf,
    /// The same without links.
    place: PathBuf,
}

impl AtomicFile {
    /// Starts the replacement of `target`, which need not exist; its folder must.
    ///
    /// # Errors
    /// If `target` is there and no regular file, or its folder takes no new file.
    pub fn create(target: &Path) -> Result<Self, WriteError> {
        check_replaceable(target)?;
        let place = follow_links(target)?;
        let (file, temporary) =
            make_beside(&place, "cannot create a file in this folder", disk::create_new)?;
        #[cfg(not(target_family = "wasm"))]
        if let Ok(old) = std::fs::metadata(&place) {
            // Not every file system has permissions, and whoever may replace may also read.
            let _ = file.set_permissions(old.permissions());
        }
        Ok(Self { file, temporary, target: target.to_owned(), place })
    }

    /// Replaces `target` by a file of these bytes.
    ///
    /// # Errors
    /// If it cannot be written; then everything is as it was.
    pub fn write(target: &Path, bytes: &[u8]) -> Result<(), WriteError> {
        let mut file = Self::create(target)?;
        file.write_all(bytes).map_err(WriteError::io(target, CANNOT_WRITE))?;
        file.commit()
    }

    /// The file being written.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// The name that it has until it is complete, for writers that take a path.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// The name that it will have.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Makes what was written durable, so that hardly anything is left that can go wrong.
    ///
    /// # Errors
    /// If the disk is full or fails.
    pub fn sync(&self) -> Result<(), WriteError> {
        self.file.sync_all().map_err(WriteError::io(&self.target, CANNOT_WRITE))
    }

    /// Makes the file durable and gives it its name.
    ///
    /// # Errors
    /// If the disk is full or fails, or the place has been taken by something else meanwhile; then
    /// everything is as it was.
    pub fn commit(mut self) -> Result<(), WriteError> {
        self.sync()?;
        self.put_in_place()
    }

    /// As [`commit`](Self::commit), and gives the open file, for a log that goes on: its end is where
    /// the next bytes go.
    ///
    /// # Errors
    /// As [`commit`](Self::commit).
    pub fn commit_open(mut self) -> Result<File, WriteError> {
        self.sync()?;
        let file = self.file.seek(SeekFrom::End(0)).and_then(|_| self.file.try_clone());
        let file = file.map_err(WriteError::io(&self.target, CANNOT_WRITE))?;
        self.put_in_place()?;
        Ok(file)
    }

    fn put_in_place(&mut self) -> Result<(), WriteError> {
        check_replaceable(&self.target)?;
        disk::rename(&self.temporary, &self.place)
            .map_err(WriteError::io(&self.target, "cannot put the finished file in place"))?;
        self.temporary = PathBuf::new();
        Ok(())
    }
}

const CANNOT_WRITE: &str = "cannot write the file";

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(to)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if !self.temporary.as_os_str().is_empty() {
            // Nothing better can be done here: the error that led here is already on its way.
            let _ = disk::remove(&self.temporary);
        }
    }
}

/// Refuses a place that is there, itself or behind links, and no regular file.
///
/// # Errors
/// [`WriteError::NotAFile`], with what is there.
pub fn check_replaceable(target: &Path) -> Result<(), WriteError> {
    match std::fs::metadata(target) {
        Ok(about) if !about.is_file() => {
            Err(WriteError::NotAFile { path: target.to_owned(), kind: kind_of(&about.file_type()) })
        }
        // What cannot be looked at is found out when a file is made beside it.
        _ => Ok(()),
    }
}

/// What is not a regular file, in words.
fn kind_of(kind: &std::fs::FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_char_device() {
            return "a character device";
        } else if kind.is_block_device() {
            return "a block device";
        } else if kind.is_fifo() {
            return "a named pipe";
        } else if kind.is_socket() {
            return "a socket";
        }
    }
    if kind.is_dir() { "a folder" } else { "no regular file" }
}

/// Makes something of a temporary name beside `place`: `.NAME.<16 digits>.part`.
///
/// The digits cannot be foreseen, so that nobody can lay a link in the way; `make` must fail with
/// [`ErrorKind::AlreadyExists`] where there is something all the same, and another name is tried.
/// Gives what `make` made, and its path.
pub(crate) fn make_beside<T>(
    place: &Path,
    action: &'static str,
    make: impl Fn(&Path) -> std::io::Result<T>,
) -> Result<(T, PathBuf), WriteError> {
    const MAX_TRIES: usize = 1000;
    let Some(name) = place.file_name() else {
        return Err(WriteError::NoPlace { path: place.to_owned(), problem: "is not a file name" });
    };
    let mut tries = 0;
    loop {
        // Keys of the standard hasher are random numbers of the system.
        let token = RandomState::new().hash_one(tries);
        let mut hidden = OsString::from(".");
        hidden.push(beginning(name));
        hidden.push(format!(".{token:016x}.part"));
        let temporary = place.with_file_name(hidden);
        tries += 1;
        match make(&temporary) {
            Ok(made) => return Ok((made, temporary)),
            Err(e) if e.kind() != ErrorKind::AlreadyExists => {
                return Err(WriteError::io(place, action)(e));
            }
            Err(e) if tries == MAX_TRIES => return Err(WriteError::io(&temporary, action)(e)),
            Err(_) => {}
        }
    }
}

/// Writes a new file of these bytes, and has the system put them on the disk.
pub(crate) fn write_new(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = disk::create_new(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// A name, cut where the temporary name would become longer than file systems allow.
fn beginning(name: &std::ffi::OsStr) -> OsString {
    // Of the 255 bytes, 23 are dots, digits and the ending.
    const MOST: usize = 200;
    match name.to_str() {
        Some(text) if text.len() > MOST => {
            let fits = |&(start, c): &(usize, char)| start + c.len_utf8() <= MOST;
            text.char_indices().take_while(fits).map(|(_, c)| c).collect::<String>().into()
        }
        None if name.len() > MOST => OsString::from("long"),
        _ => name.to_owned(),
    }
}

/// The place that a name stands for, where its links lead; there need not be a file.
pub(crate) fn follow_links(path: &Path) -> Result<PathBuf, WriteError> {
    const MAX_LINKS: usize = 40;
    let mut place = path.to_owned();
    for _ in 0..MAX_LINKS {
        if !std::fs::symlink_metadata(&place).is_ok_and(|about| about.is_symlink()) {
            return Ok(place);
        }
        let to = std::fs::read_link(&place).map_err(WriteError::io(path, "cannot follow the link"));
        // An absolute one replaces the whole path.
        place = place.with_file_name("").join(to?);
    }
    let problem = "is a link that leads in a circle (remove it)";
    Err(WriteError::NoPlace { path: path.to_owned(), problem })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::cell::Cell;

    /// What a folder holds, sorted.
    pub(crate) fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn an_abandoned_file_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.bin");
        std::fs::write(&target, b"old").unwrap();
        let mut part = AtomicFile::create(&target).unwrap();
        part.write_all(b"new").unwrap();
        assert_eq!(names(dir.path()).len(), 2);
        drop(part);
        assert_eq!(names(dir.path()), ["a.bin"]);
        assert_eq!(std::fs::read(&target).unwrap(), b"old");
    }

    #[test]
    fn commit_replaces_the_target() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.bin");
        AtomicFile::write(&target, b"first").unwrap();
        AtomicFile::write(&target, b"second").unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"second");
        assert_eq!(names(dir.path()), ["a.bin"]);
    }

    #[test]
    fn a_log_goes_on_in_the_file_that_was_put_in_place() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("log");
        std::fs::write(&target, b"old").unwrap();
        let mut part = AtomicFile::create(&target).unwrap();
        part.write_all(b"kept").unwrap();
        part.seek(SeekFrom::Start(0)).unwrap();
        let mut log = part.commit_open().unwrap();
        assert_eq!(names(dir.path()), ["log"]);
        log.write_all(b" and more").unwrap();
        drop(log);
        assert_eq!(std::fs::read(&target).unwrap(), b"kept and more");
    }

    #[test]
    fn names_as_long_as_the_system_allows() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["x".repeat(255), "ü".repeat(127)] {
            AtomicFile::write(&dir.path().join(&name), b"1").unwrap();
            assert!(dir.path().join(name).is_file());
        }
    }

    #[test]
    fn a_place_taken_meanwhile_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a");
        let part = AtomicFile::create(&target).unwrap();
        std::fs::create_dir(&target).unwrap();
        assert!(part.commit().unwrap_err().to_string().contains("a folder"));
        assert_eq!(names(dir.path()), ["a"]);
    }

    #[test]
    fn a_missing_folder_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let error = AtomicFile::create(&dir.path().join("none/a.bin")).unwrap_err().to_string();
        assert!(error.contains("a.bin: cannot create a file in this folder"), "{error}");
    }

    #[test]
    fn names_that_are_taken_are_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.bin");
        let (tries, seen) = (Cell::new(0), std::cell::RefCell::new(Vec::new()));
        let (nth, path) = make_beside(&target, "cannot create", |path| {
            tries.set(tries.get() + 1);
            seen.borrow_mut().push(path.to_owned());
            if tries.get() < 4 { Err(ErrorKind::AlreadyExists.into()) } else { Ok(tries.get()) }
        })
        .unwrap();
        assert_eq!(nth, 4);
        let mut seen = seen.into_inner();
        assert_eq!(seen.last(), Some(&path));
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), 4, "every try has a name of its own");
        let always = |_: &Path| Err::<(), _>(ErrorKind::AlreadyExists.into());
        let error = make_beside(&target, "cannot create", always).unwrap_err().to_string();
        assert!(error.contains(".a.bin.") && error.contains(".part"), "{error}");
        let full = |_: &Path| Err::<(), _>(ErrorKind::StorageFull.into());
        let error = make_beside(&target, "cannot create", full).unwrap_err().to_string();
        assert!(error.contains("a.bin: cannot create"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn only_regular_files_are_replaced() {
        use std::os::unix::fs::{FileTypeExt, symlink};
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir(at("folder")).unwrap();
        let _listener = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        let made = std::process::Command::new("mkfifo").arg(at("fifo")).status().unwrap();
        assert!(made.success());
        symlink("fifo", at("link")).unwrap();
        let cases = [
            (at("folder"), "a folder"),
            (at("socket"), "a socket"),
            (at("fifo"), "a named pipe"),
            (at("link"), "a named pipe"),
            (PathBuf::from("/dev/null"), "a character device"),
        ];
        for (path, kind) in cases {
            let error = AtomicFile::write(&path, b"new").unwrap_err().to_string();
            assert!(error.contains(kind) && error.contains("only regular files"), "{error}");
        }
        assert!(std::fs::metadata(at("fifo")).unwrap().file_type().is_fifo());
        assert_eq!(names(dir.path()), ["fifo", "folder", "link", "socket"]);
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_kept() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("secret");
        std::fs::write(&target, b"old").unwrap();
        std::fs::set_permissions(&target, PermissionsExt::from_mode(0o600)).unwrap();
        AtomicFile::write(&target, b"new").unwrap();
        assert_eq!(std::fs::metadata(&target).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_their_files_are_replaced() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let there = dir.path().join("there");
        std::fs::create_dir(&there).unwrap();
        let [link, further] = ["link", "further"].map(|name| dir.path().join(name));
        symlink("further", &link).unwrap();
        symlink(Path::new("there/a.bin"), &further).unwrap();
        for text in ["first", "second"] {
            let mut part = AtomicFile::create(&link).unwrap();
            part.write_all(text.as_bytes()).unwrap();
            assert!(!names(&there).is_empty(), "it is written where it goes");
            part.commit().unwrap();
            assert!(link.is_symlink() && further.is_symlink());
            assert_eq!(std::fs::read_to_string(there.join("a.bin")).unwrap(), text);
        }
        let circle = dir.path().join("circle");
        symlink("circle", &circle).unwrap();
        let error = AtomicFile::create(&circle).err().unwrap().to_string();
        assert!(error.contains("circle"), "{error}");
    }
}

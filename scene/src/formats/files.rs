//! Replacing a file in one step.

use crate::SceneError;
use crate::input_file::InputFile;
use std::fs::{File, OpenOptions};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts the temporary names of this process.
static SERIAL: AtomicU64 = AtomicU64::new(0);

/// Makes something of a temporary name beside `place`: `.NAME.<process>-<serial>.part`.
///
/// A name may be taken by what a killed program left, since the numbers of processes come again (in
/// containers soon): then the next serial is tried. Gives what `make` made, and its path.
pub(crate) fn make_beside<T>(
    place: &Path,
    action: &'static str,
    make: impl Fn(&Path) -> std::io::Result<T>,
) -> Result<(T, PathBuf), SceneError> {
    const MAX_TRIES: usize = 1000;
    let Some(name) = place.file_name() else {
        return Err(SceneError::format(place, "is not a file name", ""));
    };
    let mut tries = 0;
    loop {
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
        let mut hidden = std::ffi::OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}-{serial}.part", std::process::id()));
        let temporary = place.with_file_name(hidden);
        tries += 1;
        match make(&temporary) {
            Ok(made) => return Ok((made, temporary)),
            Err(e) if e.kind() != ErrorKind::AlreadyExists => {
                return Err(SceneError::io(place, action)(e));
            }
            Err(e) if tries == MAX_TRIES => return Err(SceneError::io(&temporary, action)(e)),
            Err(_) => {}
        }
    }
}

/// The place that a name stands for, where its links lead; there need not be a file.
fn follow_links(path: &Path) -> Result<PathBuf, SceneError> {
    const MAX_LINKS: usize = 40;
    let mut place = path.to_owned();
    for _ in 0..MAX_LINKS {
        if !std::fs::symlink_metadata(&place).is_ok_and(|about| about.is_symlink()) {
            return Ok(place);
        }
        let to = std::fs::read_link(&place).map_err(SceneError::io(path, "cannot follow the link"));
        // An absolute one replaces the whole path.
        place = place.with_file_name("").join(to?);
    }
    Err(SceneError::format(path, "is a link that leads in a circle", "remove it"))
}

/// A file that appears under its name only when it is complete.
///
/// It is written beside the target and renamed by [`commit`](Self::commit); dropped without that,
/// it is deleted, so a failure leaves neither a half-written file nor a changed target. A target
/// that is a link stays one: the file it leads to is replaced.
pub(crate) struct AtomicFile {
    file: Option<File>,
    temporary: PathBuf,
    /// The name that was asked for.
    target: PathBuf,
    /// The same without links.
    place: PathBuf,
}

impl AtomicFile {
    /// Starts the replacement of `target`, which need not exist.
    pub(crate) fn create(target: &Path) -> Result<Self, SceneError> {
        let place = follow_links(target)?;
        let (file, temporary) =
            make_beside(&place, "cannot create a file in this folder", |path| {
                OpenOptions::new().read(true).write(true).create_new(true).open(path)
            })?;
        Ok(Self { file: Some(file), temporary, target: target.to_owned(), place })
    }

    /// What was written so far, as memory; to be dropped before [`commit`](Self::commit).
    pub(crate) fn map(&self) -> Result<InputFile, SceneError> {
        let file = self.file()?.try_clone();
        let file = file.map_err(SceneError::io(&self.target, "cannot read the file"))?;
        InputFile::map(file, &self.target)
    }

    /// Makes what was written durable, so that hardly anything is left that can go wrong.
    pub(crate) fn sync(&self) -> Result<(), SceneError> {
        self.file()?.sync_all().map_err(SceneError::io(&self.target, "cannot write the file"))
    }

    /// The file being written.
    pub(crate) fn file(&self) -> Result<&File, SceneError> {
        // `None` only while `commit` runs, which owns `self`.
        self.file.as_ref().ok_or_else(|| SceneError::format(&self.target, "is already closed", ""))
    }

    /// The name it will have.
    pub(crate) fn target(&self) -> &Path {
        &self.target
    }

    /// Makes the file durable and gives it its name.
    pub(crate) fn commit(mut self) -> Result<(), SceneError> {
        self.sync()?;
        drop(self.file.take());
        std::fs::rename(&self.temporary, &self.place)
            .map_err(SceneError::io(&self.target, "cannot put the finished file in place"))?;
        self.temporary = PathBuf::new();
        Ok(())
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        drop(self.file.take());
        if !self.temporary.as_os_str().is_empty() {
            // Nothing better can be done here: the error that led here is already on its way.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}

/// Writes `bytes` at `offset` without moving a cursor, so threads may share the file.
pub(crate) fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
    }
    #[cfg(windows)]
    {
        let (mut bytes, mut offset) = (bytes, offset);
        while !bytes.is_empty() {
            let written = std::os::windows::fs::FileExt::seek_write(file, bytes, offset)?;
            if written == 0 {
                return Err(std::io::ErrorKind::WriteZero.into());
            }
            bytes = &bytes[written..];
            offset += written as u64;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn an_abandoned_file_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.bin");
        std::fs::write(&target, b"old").unwrap();
        let part = AtomicFile::create(&target).unwrap();
        part.file().unwrap().write_all(b"new").unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
        drop(part);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        assert_eq!(std::fs::read(&target).unwrap(), b"old");
    }

    #[test]
    fn commit_replaces_the_target_and_cleans_up_when_it_cannot() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.bin");
        std::fs::write(&target, b"old").unwrap();
        let part = AtomicFile::create(&target).unwrap();
        part.file().unwrap().write_all(b"new").unwrap();
        part.commit().unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"new");

        let folder = dir.path().join("folder");
        std::fs::create_dir(&folder).unwrap();
        assert!(AtomicFile::create(&folder).unwrap().commit().is_err());
        let names: Vec<_> =
            std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(names.len(), 2, "{names:?}");
    }

    #[test]
    fn leftovers_of_killed_programs_are_passed_over() {
        let dir = tempfile::tempdir().unwrap();
        let target = dir.path().join("a.bin");
        let next = SERIAL.load(Ordering::Relaxed);
        // More than other tests take meanwhile.
        for serial in next..next + 200 {
            let left = format!(".a.bin.{}-{serial}.part", std::process::id());
            std::fs::write(dir.path().join(left), b"left").unwrap();
        }
        let part = AtomicFile::create(&target).unwrap();
        part.file().unwrap().write_all(b"new").unwrap();
        part.commit().unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"new");
        let always = |_: &Path| Err::<(), _>(ErrorKind::AlreadyExists.into());
        let error = make_beside(&target, "cannot create", always).unwrap_err().to_string();
        assert!(error.contains(".a.bin.") && error.contains(".part"), "{error}");
        let full = |_: &Path| Err::<(), _>(ErrorKind::StorageFull.into());
        let error = make_beside(&target, "cannot create", full).unwrap_err().to_string();
        assert!(error.contains("a.bin: cannot create"), "{error}");
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
            let part = AtomicFile::create(&link).unwrap();
            part.file().unwrap().write_all(text.as_bytes()).unwrap();
            assert!(std::fs::read_dir(&there).unwrap().count() > 0, "it is written where it goes");
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

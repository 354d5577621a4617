//! Opening files that somebody else wrote.
//!
//! Every file that the library or the program reads is opened here: only regular files (a pipe
//! would be waited for, a device never ends), texts only up to a stated size, and a pointer that
//! git-lfs left in place of the file is named as such.

use crate::printable::printable;
use crate::{AtomicFile, SceneError};
use memmap2::Mmap;
use std::fs::{File, Metadata, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};

/// The most bytes of a text file that people write: names of classes, settings, manifests.
pub const MAX_TEXT_BYTES: u64 = 16 << 20;

/// Files below this many bytes are copied into memory; larger ones are mapped.
///
/// A mapped file that another process cuts short stops this one at the first access beyond the new
/// end, which no library can turn into an error; a copy cannot be cut. Copying this much takes some
/// hundredths of a second.
pub const COPIED_BELOW: u64 = 64 << 20;

/// Opens a regular file for reading; links are followed.
///
/// # Errors
/// If there is no such file, it may not be read, or it is a folder, pipe, socket or device: those
/// are refused without waiting for them.
pub fn open_regular_file(path: &Path) -> Result<File, SceneError> {
    let mut options = OpenOptions::new();
    options.read(true);
    // To open a pipe would wait for someone to write into it.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK);
    let about = std::fs::metadata(path).map_err(SceneError::io(path, "cannot open the file"))?;
    refuse_others(&about, path)?;
    let file = options.open(path).map_err(SceneError::io(path, "cannot open the file"))?;
    // Another may have taken the name meanwhile.
    let about = file.metadata().map_err(SceneError::io(path, "cannot read the file's size"))?;
    refuse_others(&about, path)?;
    Ok(file)
}

fn refuse_others(about: &Metadata, path: &Path) -> Result<(), SceneError> {
    let kind = about.file_type();
    if kind.is_file() {
        return Ok(());
    }
    let what = if kind.is_dir() { "a folder" } else { "a pipe, socket or device" };
    let problem = format!("is {what}, not a regular file");
    Err(SceneError::format(path, problem, "give a file that is on disk"))
}

/// All bytes of a regular file of at most `limit` bytes.
///
/// # Errors
/// As [`open_regular_file`]; if the file is larger, or memory for it is not to be had.
pub fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
    let file = open_regular_file(path)?;
    let about = file.metadata().map_err(SceneError::io(path, "cannot read the file's size"))?;
    let bytes = read_whole(&file, about.len(), limit, path)?;
    refuse_lfs_pointer(&bytes, path)?;
    Ok(bytes)
}

/// The text of a regular file of at most [`MAX_TEXT_BYTES`] bytes.
///
/// # Errors
/// As [`read_file`]; if the bytes are no UTF-8.
pub fn read_text_file(path: &Path) -> Result<String, SceneError> {
    String::from_utf8(read_file(path, MAX_TEXT_BYTES)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        SceneError::format(path, format!("is no text: byte {at} is not UTF-8"), "")
    })
}

/// Whether these bytes are the text that git-lfs leaves in place of a file it has not fetched.
pub fn is_lfs_pointer(bytes: &[u8]) -> bool {
    bytes.starts_with(b"version https://git-lfs.github.com/spec/")
}

fn refuse_lfs_pointer(bytes: &[u8], path: &Path) -> Result<(), SceneError> {
    if is_lfs_pointer(bytes) {
        let problem = "is a git-lfs pointer, not the file itself";
        return Err(SceneError::format(path, problem, "fetch it with `git lfs pull`"));
    }
    Ok(())
}

/// Reads `length` bytes, which the system says there are.
fn read_whole(file: &File, length: u64, limit: u64, path: &Path) -> Result<Vec<u8>, SceneError> {
    let too_large = |length: u64| {
        let problem = format!("has {length} bytes, at most {limit} are read of such a file");
        SceneError::format(path, problem, "is it the right file?")
    };
    if length > limit {
        return Err(too_large(length));
    }
    let mut bytes = Vec::new();
    reserve(&mut bytes, usize::try_from(length).unwrap_or(usize::MAX), path)?;
    // One more than expected shows whether it has grown.
    let mut rest = file.take(length + 1);
    rest.read_to_end(&mut bytes).map_err(SceneError::io(path, "cannot read the file"))?;
    if bytes.len() as u64 != length {
        let problem = format!("had {length} bytes when it was opened and then had others");
        return Err(SceneError::format(path, problem, "another program is writing it: wait"));
    }
    Ok(bytes)
}

/// Room for `count` more values in a buffer that a file sizes.
///
/// # Errors
/// If the memory is not to be had; the process lives on.
pub fn reserve<T>(buffer: &mut Vec<T>, count: usize, path: &Path) -> Result<(), SceneError> {
    buffer.try_reserve_exact(count).map_err(|_| SceneError::OutOfMemory {
        path: path.to_owned(),
        bytes: count.saturating_mul(size_of::<T>()),
    })
}

/// `count` copies of a value, where a file says how many.
pub(crate) fn filled<T: Clone>(count: usize, value: T, path: &Path) -> Result<Vec<T>, SceneError> {
    let mut out = Vec::new();
    reserve(&mut out, count, path)?;
    out.resize(count, value);
    Ok(out)
}

/// The bytes of a file, read only: a copy of a small one, a large one mapped into memory.
///
/// A mapped file ([`COPIED_BELOW`] says which) must not be shortened by another process while it is
/// open: the operating system then stops the program at the first access beyond the new end.
pub(crate) struct InputFile {
    path: PathBuf,
    content: Content,
}

enum Content {
    Mapped(Mmap, File),
    Owned(Vec<u8>),
}

impl InputFile {
    /// Opens `path`; an empty file is legal and has no bytes.
    pub(crate) fn open(path: &Path) -> Result<Self, SceneError> {
        let file = open_regular_file(path)?;
        let about = file.metadata().map_err(SceneError::io(path, "cannot read the file's size"))?;
        let input = if about.len() < COPIED_BELOW {
            let bytes = read_whole(&file, about.len(), COPIED_BELOW, path)?;
            Self { path: path.to_owned(), content: Content::Owned(bytes) }
        } else {
            Self::map(file, path)?
        };
        refuse_lfs_pointer(input.bytes(), path)?;
        Ok(input)
    }

    /// The bytes of an open file, mapped whatever its size.
    pub(crate) fn map(file: File, path: &Path) -> Result<Self, SceneError> {
        let about = file.metadata().map_err(SceneError::io(path, "cannot read the file's size"))?;
        let content = if about.len() == 0 {
            // Nothing can be mapped of it.
            Content::Owned(Vec::new())
        } else {
            // SAFETY: the mapping is private to this process and only read. Truncation by others
            // while it lives is excluded by the contract in the type's documentation.
            let map = unsafe { Mmap::map(&file) };
            let map = map.map_err(SceneError::io(path, "cannot map the file into memory"))?;
            Content::Mapped(map, file)
        };
        Ok(Self { path: path.to_owned(), content })
    }

    /// What was written to an [`AtomicFile`] so far; to be dropped before it is committed.
    pub(crate) fn of_written(written: &AtomicFile) -> Result<Self, SceneError> {
        let target = written.target();
        #[cfg(target_family = "wasm")]
        return Ok(Self::owned(written.file().bytes(), target));
        #[cfg(not(target_family = "wasm"))]
        {
            let file = written.file().try_clone();
            Self::map(file.map_err(SceneError::io(target, "cannot read the file"))?, target)
        }
    }

    /// A copy of bytes that stand for a file.
    pub(crate) fn from_bytes(bytes: &[u8], path: &Path) -> Self {
        Self::owned(bytes.to_vec(), path)
    }

    /// Bytes that stand for a file.
    pub(crate) fn owned(bytes: Vec<u8>, path: &Path) -> Self {
        Self { path: path.to_owned(), content: Content::Owned(bytes) }
    }

    /// All bytes of the file.
    pub(crate) fn bytes(&self) -> &[u8] {
        match &self.content {
            Content::Mapped(map, _) => map,
            Content::Owned(bytes) => bytes,
        }
    }

    /// Checks, after reading, that a mapped file is as long as it was when it was opened: what was
    /// read of a page that was cut within is zeros, not the file's values.
    ///
    /// # Errors
    /// If its length has changed.
    pub(crate) fn check_length(&self) -> Result<(), SceneError> {
        let Content::Mapped(map, file) = &self.content else { return Ok(()) };
        let about = file.metadata();
        let about = about.map_err(SceneError::io(&self.path, "cannot read the file's size"))?;
        if about.len() == map.len() as u64 {
            return Ok(());
        }
        let problem = format!("had {} bytes when it was opened, now {}", map.len(), about.len());
        Err(SceneError::format(&self.path, problem, "another program is writing it: wait"))
    }

    /// Where the file is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }
}

impl std::fmt::Debug for InputFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "InputFile({}, {} bytes)", printable(&self.path), self.bytes().len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_refused_and_an_empty_file_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let error = InputFile::open(dir.path()).unwrap_err().to_string();
        assert!(error.contains("is a folder"), "{error}");
        let empty = dir.path().join("empty");
        std::fs::write(&empty, b"").unwrap();
        assert!(InputFile::open(&empty).unwrap().bytes().is_empty());
        assert!(InputFile::map(File::open(&empty).unwrap(), &empty).unwrap().bytes().is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn pipes_and_devices_are_refused_at_once() {
        use std::os::unix::ffi::OsStrExt;
        let dir = tempfile::tempdir().unwrap();
        let pipe = dir.path().join("pipe");
        let name = std::ffi::CString::new(pipe.as_os_str().as_bytes()).unwrap();
        // SAFETY: the name is a string with an end, and outlives the call.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        let link = dir.path().join("link");
        std::os::unix::fs::symlink(&pipe, &link).unwrap();
        for path in [pipe.as_path(), &link, Path::new("/dev/zero"), Path::new("/dev/null")] {
            let error = open_regular_file(path).unwrap_err().to_string();
            assert!(error.contains("pipe, socket or device"), "{error}");
            assert!(InputFile::open(path).is_err());
            assert!(read_text_file(path).is_err());
        }
    }

    #[test]
    fn limits_hold_and_texts_are_texts() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, b"abcd").unwrap();
        assert_eq!(read_file(&path, 4).unwrap(), b"abcd");
        let error = read_file(&path, 3).unwrap_err().to_string();
        assert!(error.contains("4 bytes") && error.contains("at most 3"), "{error}");
        std::fs::write(&path, b"ab\xff").unwrap();
        let error = read_text_file(&path).unwrap_err().to_string();
        assert!(error.contains("byte 2"), "{error}");
        // Sparse: takes no place on disk, and its memory is never reserved.
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(read_text_file(&path).unwrap_err().to_string().contains("1099511627776 bytes"));
    }

    #[test]
    fn pointers_of_git_lfs_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("room.ply");
        let text = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 5\n";
        std::fs::write(&path, text).unwrap();
        for error in [InputFile::open(&path).unwrap_err(), read_file(&path, 1000).unwrap_err()] {
            let error = error.to_string();
            assert!(error.contains("git-lfs pointer") && error.contains("git lfs pull"), "{error}");
        }
    }

    #[test]
    fn a_small_file_that_is_cut_short_later_does_no_harm() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, vec![7; 1 << 20]).unwrap();
        let input = InputFile::open(&path).unwrap();
        File::create(&path).unwrap();
        assert!(input.bytes().iter().all(|b| *b == 7));
        input.check_length().unwrap();
    }

    #[test]
    fn a_mapped_file_whose_length_changes_is_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let file = File::create(&path).unwrap();
        file.set_len(COPIED_BELOW).unwrap();
        let input = InputFile::open(&path).unwrap();
        assert!(matches!(input.content, Content::Mapped(..)));
        input.check_length().unwrap();
        file.set_len(COPIED_BELOW - 1).unwrap();
        let error = input.check_length().unwrap_err().to_string();
        assert!(error.contains("67108864") && error.contains("67108863"), "{error}");
    }

    #[test]
    fn memory_that_is_not_to_be_had_is_an_error() {
        let mut buffer: Vec<u64> = Vec::new();
        let error = reserve(&mut buffer, 1 << 59, Path::new("a.npy")).unwrap_err().to_string();
        assert!(error.contains("a.npy") && error.contains("memory"), "{error}");
    }
}

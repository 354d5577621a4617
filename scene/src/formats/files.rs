//! Opening a file as memory, and writing at a place of one.

use crate::{AtomicFile, SceneError};
use memmap2::Mmap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// A file mapped into memory, read only.
///
/// The file must not be shortened by another process while it is open: the operating system then
/// stops the program at the first access beyond the new end.
pub(crate) struct MappedFile {
    path: PathBuf,
    content: Content,
}

enum Content {
    Mapped(Mmap),
    /// Of an empty file, or of one that is in memory anyway.
    Owned(Vec<u8>),
}

impl MappedFile {
    /// Maps `path`; an empty file is legal and has no bytes.
    pub(crate) fn open(path: &Path) -> Result<Self, SceneError> {
        let file = File::open(path).map_err(SceneError::io(path, "cannot open the file"))?;
        let about = file.metadata().map_err(SceneError::io(path, "cannot read the file's size"))?;
        if !about.is_file() {
            return Err(SceneError::format(path, "is not a regular file", ""));
        }
        Self::map(&file, about.len(), path)
    }

    /// Maps a file that is open; `path` is its name in errors.
    fn map(file: &File, length: u64, path: &Path) -> Result<Self, SceneError> {
        let content = if length == 0 {
            Content::Owned(Vec::new())
        } else {
            // SAFETY: the mapping is private to this process and only read. Truncation by others
            // while it lives is excluded by the contract in the type's documentation.
            let map = unsafe { Mmap::map(file) };
            let map = map.map_err(SceneError::io(path, "cannot map the file into memory"))?;
            Content::Mapped(map)
        };
        Ok(Self { path: path.to_owned(), content })
    }

    /// What was written to an [`AtomicFile`] so far; to be dropped before it is committed.
    pub(crate) fn of_written(file: &AtomicFile) -> Result<Self, SceneError> {
        let target = file.target();
        let about = file.file()?.metadata();
        let about = about.map_err(SceneError::io(target, "cannot read the file's size"))?;
        Self::map(file.file()?, about.len(), target)
    }

    /// A copy of bytes that stand for a file.
    pub(crate) fn from_bytes(bytes: &[u8], path: &Path) -> Self {
        Self { path: path.to_owned(), content: Content::Owned(bytes.to_vec()) }
    }

    /// All bytes of the file.
    pub(crate) fn bytes(&self) -> &[u8] {
        match &self.content {
            Content::Mapped(map) => map,
            Content::Owned(bytes) => bytes,
        }
    }

    /// Where the file is.
    pub(crate) fn path(&self) -> &Path {
        &self.path
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

    #[test]
    fn a_folder_is_not_mapped_and_an_empty_file_is() {
        let dir = tempfile::tempdir().unwrap();
        assert!(MappedFile::open(dir.path()).is_err());
        let empty = dir.path().join("empty");
        std::fs::write(&empty, b"").unwrap();
        assert!(MappedFile::open(&empty).unwrap().bytes().is_empty());
    }
}
